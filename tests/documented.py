"""Code in the project's Markdown: blocks, the commands in them, and commands within sentences."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DOCS = (
    "README.md",
    *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md")),
    "benchmarks/README.md",
)
_FENCE = re.compile(r"^( *)```(\w*)\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)
_SPAN = re.compile(r"(?<!`)`((?:vibraverse|snakemake|make|python|apptainer|docker|conda|pip) [^`]+)`(?!`)")


@dataclass(frozen=True)
class Block:
    """A fenced block: the document and line it stands in, its language, its text."""

    doc: str
    line: int
    language: str
    text: str

    @property
    def place(self) -> str:
        """Document and line."""
        return f"{self.doc}:{self.line}"


def blocks(*languages: str) -> list[Block]:
    """Return all fenced blocks of these languages; "" is none."""
    found = []
    for doc in DOCS:
        text = (ROOT / doc).read_text(encoding="utf-8")
        for match in _FENCE.finditer(text):
            if match[2] in languages:
                found.append(Block(doc, text[: match.start()].count("\n") + 1, match[2], match[3]))
    return found


def spans() -> dict[str, str]:
    """Return the commands in backticks within sentences, each with the first document that has it."""
    found: dict[str, str] = {}
    for doc in DOCS:
        prose = _FENCE.sub("", (ROOT / doc).read_text(encoding="utf-8"))
        for match in _SPAN.finditer(prose):
            found.setdefault(" ".join(match[1].split()), doc)
    return found


def commands(text: str) -> list[str]:
    """Return the commands of a block, each as one line for the shell: continued ones joined, comments gone."""
    found, waiting = [], ""
    for line in text.splitlines():
        waiting += re.sub(r"(^|\s+)# .*$", "", line) + "\n"
        if waiting.rstrip().endswith("\\") or not _is_complete(waiting):
            continue
        if waiting.strip():
            found.append(waiting.strip().replace("\\\n", " "))
        waiting = ""
    assert not waiting.strip(), f"never ends: {waiting}"
    return found


def _is_complete(text: str) -> bool:
    try:
        shlex.split(text)
    except ValueError:  # a quotation goes on
        return False
    return True


def paths_of_code() -> dict[str, set[str]]:
    """Return the Python files that the documents name in backticks, each with the documents."""
    found: dict[str, set[str]] = {}
    for doc in DOCS:
        for name in re.findall(r"`([\w/.]+\.py)\b", (ROOT / doc).read_text(encoding="utf-8")):
            found.setdefault(name, set()).add(doc)
    return found
