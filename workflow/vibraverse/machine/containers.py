"""The container images, one per family of stages: their names and their contents.

An image carries its family's locked packages and this project's code, so a job in it needs nothing installed on its
machine. The labels state the version, and checksums of the lock file and of every file that went in. A run with images
compares them with the checkout before its first job; ``containers/build.py`` builds those that differ.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
from pathlib import Path

from vibraverse import __version__

PROJECT = Path(__file__).resolve().parents[3]

#: The families that rules run in. `workstation` joins them with Snakemake, for executors with a single image.
FAMILIES = ("geometry", "fem", "render", "dataset", "report")
#: The same and `learn`, which is several times as large as the others. It is for a user's own rules, built on request.
ALL = (*FAMILIES, "learn")

#: Files that go into every image, besides the lock file of its family.
SOURCES = (
    "containers/base.def",
    "containers/check.py",
    "containers/by_hand.py",
    "containers/environment.sh",
    "containers/family.def",
    "envs/bootstrap.txt",
    "envs/env.sh",
    "envs/front.py",
    "envs/node.txt",
    "envs/system.sh",
    "envs/system.txt",
    "LICENSE",
    "pyproject.toml",
    "workflow/vibraverse",
)


def binary() -> str | None:
    """Return the command that runs images, as Snakemake chooses it; None if neither is on the PATH."""
    return next(filter(shutil.which, ("apptainer", "singularity")), None)


def folder() -> str:
    """Return the location of images: ``VIBRAVERSE_IMAGES``, a folder or a registry's address, else the project's."""
    return os.environ.get("VIBRAVERSE_IMAGES") or str(PROJECT / "containers/images")


def file_name(family: str) -> str:
    """Return the name of a family's image file."""
    return f"vibraverse-{family}-{__version__}.sif"


def image(family: str) -> str | None:
    """Return the image of a family as the rules name it; None if Snakemake cannot take the name."""
    where = folder()
    if "://" in where:
        return f"{where.rstrip('/')}/vibraverse-{family}:{__version__}"
    path = str(Path(where).absolute() / file_name(family))
    return None if " " in path else path


def contents(family: str) -> list[Path]:
    """Return the files that the image of a family is made of, relative to the project."""
    files = []
    for name in (*SOURCES, f"envs/{family}.txt"):
        found = [PROJECT / name] if (PROJECT / name).is_file() else sorted((PROJECT / name).rglob("*"))
        files += [p.relative_to(PROJECT) for p in found if p.is_file() and "__pycache__" not in p.parts]
    return files


def labels(family: str) -> dict[str, str]:
    """Return the labels of a family's image when built from this checkout."""
    checksum = hashlib.sha256()
    for path in contents(family):
        checksum.update(f"{path} {hashlib.sha256((PROJECT / path).read_bytes()).hexdigest()}\n".encode())
    lock = hashlib.sha256((PROJECT / f"envs/{family}.txt").read_bytes())
    return {
        "vibraverse.family": family,
        "vibraverse.version": __version__,
        "vibraverse.lock": lock.hexdigest(),
        "vibraverse.contents": checksum.hexdigest(),
    }


def built(path: str | Path) -> dict[str, str] | None:
    """Return the labels of an image file; None if it does not exist."""
    if not Path(path).is_file():
        return None
    command = [binary(), "inspect", "--json", "--labels", str(path)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        return {}
    return json.loads(done.stdout)["data"]["attributes"]["labels"] or {}


def differences(family: str, path: str | Path) -> str:
    """Return in words how an image differs from this checkout; "" if it does not."""
    there, wanted = built(path), labels(family)
    if there is None:
        return "does not exist"
    if not there.get("vibraverse.contents"):
        return "is not an image of this project"
    for label, words in (
        ("vibraverse.family", "is of the family {there}"),
        ("vibraverse.version", "is of version {there}, not {wanted}"),
        ("vibraverse.lock", "was built from other packages than envs/{family}.txt pins"),
        ("vibraverse.contents", "was built from another state of the code"),
    ):
        if there.get(label) != wanted[label]:
            return words.format(there=there.get(label), wanted=wanted[label], family=family)
    return ""
