"""One of several processes that train together: ``python -m vibraverse.learn.rank FOLDER PARENT``.

``learn/launch.py`` starts them. They say how the training ended in files of the folder.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import torch

from vibraverse.contract import products
from vibraverse.contract.errors import NotStored, NotThere, UsageError
from vibraverse.contract.limits import die_with
from vibraverse.learn.assignment import Assignment
from vibraverse.learn.interruption import Interrupted

#: Names of the files: what is trained, the result, and the error of a process.
ASSIGNMENT, TRAINED, ERROR = "assignment.json", "trained.pt", "error-{rank}.json"


def main(folder: Path, parent: int) -> int:
    """Train as the assignment in the folder says; return the exit status."""
    die_with(parent)
    rank = int(os.environ["RANK"])
    sys.stdout.reconfigure(line_buffering=True)  # all processes write into one log
    try:
        trained, about = Assignment(**products.read_json(folder / ASSIGNMENT)).train()
        if rank == 0:
            _write(folder / TRAINED, {"trained": vars(trained), "about": about})
    except (NotStored, NotThere, UsageError) as error:
        said = {"kind": type(error).__name__, "message": str(error), "step": getattr(error, "step", None)}
        products.write_json(folder / ERROR.format(rank=rank), said)
        # All processes are interrupted together. Other errors may be one process's alone, and end the others.
        return 0 if isinstance(error, Interrupted) else 1
    return 0


def _write(path: Path, content: dict) -> None:
    # Through a Python file: torch's own writer hides the system's error.
    with products.storing(path), products.whole(path) as partial, open(partial, "wb") as file:
        torch.save(content, file)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), int(sys.argv[2])))
