"""Read a dataset, plot a mode and write the sound beside it: python examples/read_dataset.py [results/dataset]"""

import os
import sys

import matplotlib.pyplot as plt
import numpy as np
import soundfile

import vibraverse.dataset

folder = sys.argv[1] if len(sys.argv) > 1 else "results/dataset"
if not os.path.exists(folder):
    sys.exit(f"there is no {folder}; name the dataset: python {sys.argv[0]} PATH/TO/results/dataset")
fields = ("vertices", "faces", "mode_shapes", "frequencies_hz", "sound", "sample_rate_hz")
with vibraverse.dataset.open(folder, fields) as data:
    item = data.where(solidity="solid").items[0]
    *_, vertices, faces, shapes, hz, sound, rate = data.sample(item).values()

size = np.linalg.norm(shapes[0], axis=1)  # of the lowest mode, at every vertex
axes = plt.figure().add_subplot(projection="3d")
drawn = axes.plot_trisurf(*(vertices + 0.2 * shapes[0] / size.max()).T, triangles=faces, cmap="viridis")
drawn.set(array=size[faces].mean(axis=1), clim=(0, size.max()))
axes.set(title=f"{item['title']}, {item['material']}: {hz[0]:.0f} Hz", aspect="equal")
plt.savefig("mode.png", dpi=150)
soundfile.write("sound.wav", sound, rate)
