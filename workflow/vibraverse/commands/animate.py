"""``vibraverse animate``: a mode of a finished body as a moving picture."""

from __future__ import annotations

import argparse
from pathlib import Path

from vibraverse.commands import run_arguments, run_paths
from vibraverse.commands.one_mesh import check_writable, progress
from vibraverse.contract import products
from vibraverse.contract.errors import UsageError
from vibraverse.contract.refusal import read_refusal
from vibraverse.contract.texts import unknown
from vibraverse.flow.paths import SOLIDITIES, Paths


def main(argv: list[str]) -> int:
    """Write the picture; return 0."""
    parser = argparse.ArgumentParser(
        prog="vibraverse animate",
        parents=[run_arguments()],
        description="Draw one mode of a body, far slower and larger than it vibrates, as a GIF.",
    )
    parser.add_argument("object", metavar="OBJECT", help="the object's id")
    parser.add_argument("--mode", type=int, default=1, metavar="N", help="mode, counted from 1 (default 1)")
    parser.add_argument("--solidity", choices=SOLIDITIES, default="solid", help="which body (default solid)")
    parser.add_argument("--material", metavar="NAME", help="material (default: the first of the run)")
    parser.add_argument(
        "--size-px", type=int, default=320, metavar="N", help="width and height (default 320)"
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="GIF",
        help="the picture (default: OBJECT-SOLIDITY-MODE.gif here)",
    )
    chosen = parser.parse_args(argv)
    if not 32 <= chosen.size_px <= 2048:
        raise UsageError(f"--size-px must lie between 32 and 2048, not {chosen.size_px}")
    output = chosen.output or Path(f"{chosen.object}-{chosen.solidity}-{chosen.mode}.gif")
    if output.suffix.lower() != ".gif":
        raise UsageError(f"{output} does not end in .gif, the only format; give another name with -o")
    check_writable(output)
    hz, said, arguments = _mode(run_paths(chosen), chosen)
    from vibraverse.media.animation import gif

    with progress("drawing"):
        picture = gif(*arguments, chosen.size_px)
    with products.whole(output) as partial:
        partial.write_bytes(picture)
    print(f"{said}: mode {chosen.mode}, {hz:.1f} Hz\nwrote {output}")
    return 0


def _mode(paths: Paths, chosen: argparse.Namespace) -> tuple[float, str, tuple]:
    """Return the frequency of the mode, what it belongs to, and its surface, shape and look."""
    import h5py

    from vibraverse.files.modes import read_mode_shapes, read_surface
    from vibraverse.geometry.outside import outer

    files = {
        name: Path(paths.named(name, object=chosen.object, solidity=chosen.solidity))
        for name in ("basis", "modes")
    }
    for file in files.values():
        if refusal := read_refusal(file):
            raise UsageError(f"the {chosen.solidity} body of {chosen.object} is refused: {refusal.message}")
        if not file.is_file():
            raise UsageError(
                f"{file} does not exist; name an object of the run (`vibraverse objects` lists them) that is made"
            )
    with h5py.File(files["modes"]) as modes, h5py.File(files["basis"]) as basis:
        materials = list(modes["materials"])
        material = chosen.material or materials[0]
        if material not in materials:
            raise UsageError(unknown("material", material, materials))
        hz = modes[f"materials/{material}/frequencies_hz"][()]
        if not 1 <= chosen.mode <= len(hz):
            raise UsageError(f"--mode must lie between 1 and {len(hz)}, not {chosen.mode}")
        shape = read_mode_shapes(modes, read_surface(basis), material)[chosen.mode - 1]
        vertices = basis["surface/vertices"][()]
        faces = outer(vertices, basis["surface/faces"][()])
    return (
        float(hz[chosen.mode - 1]),
        f"{chosen.object}, {chosen.solidity} {material}",
        (vertices, faces, shape, material),
    )
