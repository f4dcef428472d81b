"""Build the container images that are missing or out of date: ``make containers``.

An image is out of date if a file that goes into it changed: its family's lock file, the project's code, a definition.
An image appears under its name only after its own test has passed; an interrupted build leaves the old image in place.

Debian comes from ``--base``: an image that Apptainer can fetch (``docker://debian:12-slim``, the default), a file or
folder that holds one, or ``debian``, which builds it with this machine's own apt. Python packages come from pip's
configured index. Both cache their downloads, so a second image fetches little.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from vibraverse.contract.texts import unknown
from vibraverse.machine import containers

#: Compression that packs three times as fast as the default and unpacks faster; every kernel since 4.14 reads it.
_COMPRESSION = ["--mksquashfs-args", "-comp zstd -Xcompression-level 6"]
_BASE_PARTS = ("containers/base.def", "envs/system.sh", "envs/system.txt")
_PIP_KEYS = ("index-url", "extra-index-url", "find-links", "trusted-host", "proxy", "timeout")
_CERTIFICATES = "/etc/ssl/certs/ca-certificates.crt"


class Failed(Exception):
    """A failed build; the message says what to do."""


def run(command: list[str], what: str) -> None:
    """Run a command silently; show its last words if it fails."""
    done = subprocess.run(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    if done.returncode != 0:
        raise Failed(
            "\n".join([*done.stdout.splitlines()[-30:], f"{what} failed: its last words are above."])
        )


def apptainer_build(target: Path, definition: str, *options: str) -> None:
    """Build one image beside its final path and rename it."""
    target.parent.mkdir(parents=True, exist_ok=True)
    partial = target.with_name(f".{os.getpid()}.partial.{target.name}")
    try:
        command = ["apptainer", "build", *_COMPRESSION, *options, str(partial)]
        run([*command, str(containers.PROJECT / "containers" / definition)], f"Building {target.name}")
        os.replace(partial, target)
    finally:
        partial.unlink(missing_ok=True)


def arguments(**values: str) -> list[str]:
    """Return build arguments for Apptainer."""
    return [word for name, value in values.items() for word in ("--build-arg", f"{name}={value}")]


def stage(family: str, folder: Path) -> Path:
    """Copy the files of an image to a folder of their own, so that nothing else gets into it."""
    for path in containers.contents(family):
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(containers.PROJECT / path, folder / path)
    (folder / "README.md").touch()  # pyproject.toml asks for one
    made = Path(
        sys.prefix, "share/vibraverse"
    )  # what pages consist of, which a build may not be able to make
    if made.is_dir():
        shutil.copytree(made, folder / "share/vibraverse")
    return folder


def pip_settings(folder: Path) -> list[str]:
    """Return the binds that let a build use this machine's pip settings, certificates and download cache."""
    command = [sys.executable, "-m", "pip", "config", "list"]
    said = subprocess.run(command, capture_output=True, text=True).stdout
    found = {}
    for line in sorted(said.splitlines(), key=lambda line: line.startswith(":env:")):  # the environment wins
        name, _, value = line.partition("=")
        found[name.rpartition(".")[2]] = ast.literal_eval(value).split()
    # A folder of this machine is not there in a build.
    found["find-links"] = [place for place in found.get("find-links", ()) if re.match("https?://", place)]
    certificates = " ".join(found.get("cert", [_CERTIFICATES]))
    lines = [f"{key} = {' '.join(found[key])}" for key in _PIP_KEYS if found.get(key)]
    settings = folder / "pip.conf"
    settings.write_text("\n".join(["[global]", *lines, f"cert = {_CERTIFICATES}", ""]))
    cache = Path(os.environ.get("UV_CACHE_DIR") or "~/.cache/uv").expanduser()
    cache.mkdir(parents=True, exist_ok=True)
    binds = [f"{settings}:/etc/pip.conf", f"{cache}:/root/.cache/uv"]
    if Path(certificates).is_file():
        binds.append(f"{certificates}:{_CERTIFICATES}")
    return [word for bind in binds for word in ("--bind", bind)]


def debian(folder: Path) -> Path:
    """Make a minimal Debian 12 with this machine's own apt sources; needs root and ``mmdebstrap``."""
    if shutil.which("mmdebstrap") is None:
        raise Failed(
            "BASE=debian needs the command mmdebstrap: apt-get install mmdebstrap, or name another BASE."
        )
    sources = [str(p) for p in Path("/etc/apt").glob("sources.list.d/debian.sources")] or [
        "/etc/apt/sources.list"
    ]
    root = folder / "debian"
    command = ["mmdebstrap", "--quiet", "--variant=minbase", "--dpkgopt=force-unsafe-io"]
    run(
        [*command, "--include=ca-certificates,python3,python3-venv", "bookworm", str(root), *sources],
        "mmdebstrap",
    )
    for device in (root / "dev").iterdir():  # the definition's commands get the builder's
        shutil.rmtree(device) if device.is_dir() and not device.is_symlink() else device.unlink()
    return root


def make_base(image: Path, base: str) -> None:
    """Build the base image unless an up-to-date one exists."""
    checksum = hashlib.sha256(base.encode())
    for part in _BASE_PARTS:
        checksum.update((containers.PROJECT / part).read_bytes())
    if (containers.built(image) or {}).get("vibraverse.base") == checksum.hexdigest():
        return
    with tempfile.TemporaryDirectory(prefix="vibraverse-base-") as name:
        kind, _, where = base.rpartition("://")
        if base == "debian":
            kind, where = "localimage", str(debian(Path(name)))
        elif not kind:
            if not Path(base).exists():
                raise Failed(
                    f"BASE={base} does not exist; name an image or a folder of Debian 12, or BASE=debian."
                )
            kind, where = "localimage", str(Path(base).absolute())
        values = {"BOOTSTRAP": kind, "FROM": where, "STAGED": str(containers.PROJECT)}
        try:
            apptainer_build(image, "base.def", *arguments(**values, SYSTEM=checksum.hexdigest()))
        except Failed as failed:
            if kind != "docker":
                raise
            elsewhere = "Where no registry of images is reached, BASE=debian builds from this machine's apt."
            raise Failed(f"{failed}\n{elsewhere}") from None


def make_family(image: Path, base: Path, family: str) -> None:
    """Build the image of one family on the base, and test it from read-only storage."""
    labels = containers.labels(family)
    values = {name.rpartition(".")[2].upper(): value for name, value in labels.items()}
    with tempfile.TemporaryDirectory(prefix="vibraverse-image-") as name:
        staged = stage(family, Path(name) / "vibraverse")
        options = arguments(BASE=str(base), STAGED=str(staged), **values)
        apptainer_build(image, "family.def", *options, *pip_settings(Path(name)))


def report(name: str, image: Path, started: float) -> None:
    """Print the time of a build and the size of the image."""
    print(
        f"{name}: built in {time.perf_counter() - started:.0f} s, {image.stat().st_size / 1e6:.0f} MB",
        flush=True,
    )


def main(families: list[str], base: str) -> None:
    """Build the images that are out of date, in order."""
    for family in families:
        if family not in containers.ALL:
            raise Failed(unknown("family", family, containers.ALL))
    if "://" in containers.folder():
        raise Failed(
            f"VIBRAVERSE_IMAGES is {containers.folder()}: images are built into a folder, then pushed there."
        )
    if shutil.which("apptainer") is None:
        raise Failed(
            "The command apptainer is not there: install Apptainer, or see docs/containers.md for others."
        )
    folder = Path(containers.folder()).absolute()
    wanted = {family: folder / containers.file_name(family) for family in families}
    differing = {family: containers.differences(family, image) for family, image in wanted.items()}
    base_image = folder / containers.file_name("base")
    for family, image in wanted.items():
        if not differing[family]:
            print(f"{family}: up to date")
            continue
        print(f"{family}: {image.name} {differing[family]}", flush=True)
        started = time.perf_counter()
        make_base(base_image, base)
        if time.perf_counter() - started > 2:
            report("base", base_image, started)
        started = time.perf_counter()
        make_family(image, base_image, family)
        report(family, image, started)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("families", nargs="*", metavar="FAMILY", help=f"of {', '.join(containers.ALL)}")
    parser.add_argument(
        "--base", default="docker://debian:12-slim", metavar="IMAGE", help="where Debian comes from"
    )
    chosen = parser.parse_args()
    try:
        main(chosen.families or list(containers.FAMILIES), chosen.base)
    except Failed as failure:
        sys.exit(str(failure))
