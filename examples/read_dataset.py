"""Read a dataset, plot a mode and write the sound beside it: python examples/read_dataset.py [results/dataset]"""

import sys

import matplotlib.pyplot as plt
import numpy as np
import soundfile

import vibraverse.dataset

with vibraverse.dataset.open(*sys.argv[1:2] or ["results/dataset"]) as data:
    item = data.where(solidity="solid").items[0]
    place = {name: item[name] for name in ("object", "solidity", "material")}
    names = ("vertices", "faces", "mode_shapes", "frequencies_hz", "sound", "sample_rate_hz")
    vertices, faces, shapes, hz, sound, rate = (data.read(name, **place) for name in names)

size = np.linalg.norm(shapes[0], axis=1)  # of the lowest mode, at every vertex
axes = plt.figure().add_subplot(projection="3d")
bent = vertices + 0.2 * shapes[0] / size.max()
drawn = axes.plot_trisurf(*bent.T, triangles=faces, cmap="viridis")
drawn.set(array=size[faces].mean(axis=1), clim=(0, size.max()))
axes.set(title=f"{item['title']}, {item['material']}: {hz[0]:.0f} Hz", aspect="equal")
plt.savefig("mode.png", dpi=150)
soundfile.write("sound.wav", sound, rate)
