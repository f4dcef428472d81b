"""Compiled loops from storage that cannot be written, as an image's is.

Numba takes a compiled loop from a folder only if it could also write there; otherwise it compiles anew, half a minute
for each job of geometry. So a process in an image gets a copy of the image's loops (1 MB), which lives as long as it.
"""

from __future__ import annotations

import os
import sys


def use_compiled_loops() -> None:
    """Let Numba find the loops of ``NUMBA_CACHE_DIR`` where that is read-only; call before Numba is imported."""
    kept = os.environ.get("NUMBA_CACHE_DIR", "")
    if "numba" in sys.modules:  # a fork of a warm process has them
        return
    if not os.path.isdir(kept) or os.access(kept, os.W_OK):
        return
    import atexit
    import shutil
    import tempfile

    own = tempfile.mkdtemp(prefix="vibraverse-loops-")
    atexit.register(shutil.rmtree, own, ignore_errors=True)
    shutil.copytree(kept, own, dirs_exist_ok=True)
    os.environ["NUMBA_CACHE_DIR"] = own
