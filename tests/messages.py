"""What a message must have: the parts that a test can check, and the words that docs and code avoid."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent.parent / "workflow" / "vibraverse"
#: Exceptions whose text a person reads; the last three become a :class:`UsageError`, or are a :class:`NotThere`.
SAID = ("Refused", "UsageError", "ConfigError", "NotThere", "NotStored", "NoMeshes", "CannotExport", "NoGPU")
#: Refusals that are joined to the sentence of another, which has the advice.
JOINED = ("geometry/meshing/fill.py", "geometry/meshing/tets.py", "geometry/meshing/wrapped.py")
#: Translated phrases and words that do not say what happened, and what is said instead.
AVOIDED = {
    r"\bthere (is|are) (not?|none)\b": "does not exist",
    r"\bthere is in\b|\bwhat there is\b|\bthan there is\b|\b(is|are) not there\b": "exists",
    r"\b(is|are|there is) none\b|\bfor what is none\b": "does not exist",
    r"(?<!there )\bis no [a-z]": "is not a",
    r"\bof which\b|\bsuch as there are\b": "a sentence of its own",
    r"\b(is|are|was|were) (gone|there twice)\b": "does not exist",
    r"\bmade (again|finer|otherwise)\b|\bremade\b|\bremaking\b": "retried, refined, remeshed",
    r"\bremembered\b|\bwhat it was\b": "cached, stale",
    r"\bwould run\b|\bhow often it is\b|\bwhat (lets|holds|makes)\b": "dry run, polling interval, patch, lock, mesher",
    r"\btakes away\b|\byou stand in\b|\bin doubt\b": "deletes, the working folder",
}
_VERB = re.compile(
    r"\b(is|are|was|were|has|have|had|holds?|must|cannot|could|would|does|do|did|lies|needs?|needed|takes?|took|means|"
    r"names?|asks?|asked|reached|changed|crashed|failed|found|lost|matches|keeps|forgets|refused|works|stands|lists|"
    r"appears|says|put|puts|hands|seems|use|uses|shows|finds|see|lacks|unknown)\b"
)
_IMPERATIVE = (
    "add|ask|change|check|choose|claim|close|connect|convert|copy|correct|create|cut|delete|do|empty|enter|export|"
    "finish|free|give|install|join|keep|leave|let|lower|make|mend|move|name|narrow|pass|put|raise|reconstruct|remove|"
    "rename|repair|repeat|run|save|set|simplify|take|wait|widen|write|build|lend|log|record"
)
_REMEDY = re.compile(
    r"`[^`]+`"  # a command
    r"|\bdid you mean\b|\(known: |\bmust (be|hold|lie|add up)\b|\bmay hold only\b|\btakes\b.*, not "
    rf"|(^|[.;:,]\s+|\b(or|and|then)\s+)({_IMPERATIVE})\b",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class Said:
    """A message in the source: where, the exception, a refusal's reason, its literal text and advice.

    Values are ``{}`` in a text. ``None`` stands for text that is not a literal.
    """

    place: str
    kind: str
    reason: str | None
    text: str | None
    advice: str | None


def said_in_the_source() -> Iterator[Said]:
    """Yield every call of an exception of :data:`SAID`."""
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call) or not node.args:
                continue
            kind = getattr(node.func, "id", getattr(node.func, "attr", ""))
            if kind not in SAID:
                continue
            place = f"{path.relative_to(PACKAGE).as_posix()}:{node.lineno}"
            texts = [_literal(argument) for argument in node.args]
            if kind == "Refused":
                # An advice that is a name is a constant of its module, and one of those the examples show.
                advice = (texts[2] or "{}") if len(texts) > 2 else None
                yield Said(place, kind, texts[0], texts[1], advice)
            else:
                yield Said(place, kind, None, texts[0], None)


def _literal(node: ast.expr) -> str | None:
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(_literal(part) or "{}" for part in node.values)
    if isinstance(node, ast.BinOp):
        return (_literal(node.left) or "{}") + (_literal(node.right) or "{}")
    if isinstance(node, ast.IfExp):
        return _literal(node.body)
    return None


def avoided_in(text: str) -> list[str]:
    """Return a sentence for every word or phrase of a text that is avoided."""
    return [
        f"{match[0]!r}: say {instead!r}"
        for pattern, instead in AVOIDED.items()
        if (match := re.search(pattern, text, re.IGNORECASE))
    ]


def remedied(text: str) -> bool:
    """Whether a text says what to do: a command, the value that is allowed, or an imperative."""
    return bool(_REMEDY.search(text))


def complaints(text: str, wrong: tuple[str, ...] = (), why: str = "") -> list[str]:
    """Return what a whole message lacks; it must hold the names and values ``wrong`` and the reason ``why``."""
    found = [f"does not name {name!r}" for name in wrong if name not in text]
    first = re.split(r"; (?!did you mean)", text, maxsplit=1)[0]
    if not _VERB.search(first):
        found.append("does not say why")
    if why not in text:
        found.append(f"does not say {why!r}")
    if not remedied(text):
        found.append("does not say what to do")
    return found + avoided_in(text)


def misformed(text: str, refusal: bool) -> list[str]:
    """Return how a message departs from the project's form.

    A refusal is a sentence with a stop. What a command says follows ``vibraverse: ``, so it begins small, unless with
    a name, and has no stop.
    """
    found = []
    if text != text.strip() or "  " in text.replace("\n  ", ""):
        found.append("has blanks at an end, or two")
    if refusal and not text.endswith((".", ".{}")):
        found.append("has no stop")
    if not refusal and text.endswith((".", "!", "?")) and not text.endswith("then repeat the command."):
        found.append("has a stop")
    first = text.split()[0]
    if (
        not refusal
        and first[0].isupper()
        and first.rstrip(":") not in ("Slurm", "Parquet", "Objaverse", "Snakemake")
    ):
        found.append("begins with a capital")
    if refusal and re.match(r"(the|a|an|this|no|all|only|every|it) ", text):
        found.append("begins small")
    return found
