"""Why a file cannot be read, in words: it does not exist, is a folder, is a device, or permission is denied."""

from __future__ import annotations

import os
import stat
from pathlib import Path


def unreadable(path: str | Path, missing: str = "", folder: str = "name a file in it") -> str:
    """Return why ``path`` cannot be read as a file, to follow its name in a sentence; "" if it can.

    ``missing`` and ``folder`` are the remedies for a path that does not exist and for a folder.
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
