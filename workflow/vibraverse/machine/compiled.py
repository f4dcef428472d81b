"""Numba's compiled loops from a read-only cache, such as an image's.

Numba reads its cache only from a writable folder. Otherwise it compiles anew, which takes half a minute per geometry
job. So a process in an image works on its own copy of the image's cache (1 MB), which is removed when it ends.
"""

from __future__ import annotations

import os
import sys


def use_compiled_loops() -> None:
    """Copy a read-only ``NUMBA_CACHE_DIR`` to a writable folder; call before Numba is imported."""
    kept = os.environ.get("NUMBA_CACHE_DIR", "")
    if "numba" in sys.modules:  # a fork of a warm process has the loops in memory
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
