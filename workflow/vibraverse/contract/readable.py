"""Whether a file can be read, in words: missing, a folder, something else, or closed to the user."""

from __future__ import annotations

import os
import stat
from pathlib import Path


def unreadable(path: str | Path, missing: str = "", folder: str = "name a file in it") -> str:
    """Return what keeps ``path`` from being read as a file, to follow its name in a sentence; "" where nothing does.

    ``missing`` and ``folder`` say what to do where it does not exist and where it is a folder.
    """
    try:
        mode = os.stat(path).st_mode
        if stat.S_ISDIR(mode):
            return _with("is a folder", folder)
        if not stat.S_ISREG(mode):  # opening a pipe would wait for ever
            return "is not a file"
        with open(path, "rb"):
            return ""
    except (FileNotFoundError, NotADirectoryError):
        return _with("does not exist", missing)
    except PermissionError:
        return "cannot be read: Permission denied; ask its owner for the right to read it"
    except OSError as error:
        return f"cannot be read: {error.strerror}"


def _with(wrong: str, remedy: str) -> str:
    return f"{wrong}; {remedy}" if remedy else wrong
