"""Run the check of an image here, with its family's packages alone: ``family_only.py FAMILY FOLDER``.

Prints the stages that ran, one a line.
"""

from __future__ import annotations

import importlib.abc
import importlib.metadata
import importlib.util
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


class Without(importlib.abc.MetaPathFinder):
    """A finder that blocks imports of packages that an environment's lock file does not name."""

    def __init__(self, lock: Path):
        locked = set(re.findall(r"^([a-z0-9-]+)==", lock.read_text(), flags=re.MULTILINE))
        self.missing = {
            module
            for module, names in importlib.metadata.packages_distributions().items()
            if not locked & {re.sub(r"[-_.]+", "-", name).lower() for name in names}
        } - {"vibraverse", *sys.stdlib_module_names}

    def find_spec(self, name, path=None, target=None):
        """Refuse such a package, leave all others to the next finder."""
        if name.partition(".")[0] in self.missing:
            raise ModuleNotFoundError(f"the image does not hold {name}", name=name)


def main(family: str, folder: str) -> None:
    """Run the family's stages in a folder."""
    hidden = Without(ROOT / f"envs/{family}.txt")
    assert "pytest" in hidden.missing
    sys.meta_path.insert(0, hidden)
    find_spec = importlib.util.find_spec
    # PyTorch asks whether a package is there, and expects None if not.
    importlib.util.find_spec = lambda name, package=None: (
        None if name.partition(".")[0] in hidden.missing else find_spec(name, package)
    )
    sys.path[0] = str(ROOT / "containers")
    import check

    one = check.Check(Path(folder))
    check.stages(one, family)
    print(*dict.fromkeys(one.ran), sep="\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
