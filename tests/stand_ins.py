"""Stand-ins for a machine's commands, and the sentences of checks that call them."""

from __future__ import annotations

import pytest

from vibraverse.machine import preflight


def stub(folder, name: str, text: str) -> None:
    """Put a command into a folder of the PATH."""
    (folder / name).write_text(f"#!/bin/sh\n{text}\n")
    (folder / name).chmod(0o755)


def said(check, *arguments) -> str:
    """Return a check's sentence, which must be one."""
    with pytest.raises(preflight.NotThere) as found:
        check(*arguments)
    assert "\n" not in str(found.value)
    return str(found.value)
