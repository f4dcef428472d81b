"""Reference of the configuration: every key with its default and meaning, generated from the sections."""

from __future__ import annotations

import json

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from vibraverse.config import Config, section_in


def markdown() -> str:
    """Return the tables of ``docs/configuration.md``: one for the top level, one for each section."""
    plain = {name: field for name, field in Config.model_fields.items() if not _is_section(field)}
    parts = ["## Top level\n", _table(_rows(plain, ""))]
    for name, field in Config.model_fields.items():
        section = section_in(field.annotation)
        if section is not None:
            title = name if _is_section(field) else f"{name}.NAME"
            parts += [
                f"## `{title}`\n",
                f"{_text(section.__doc__)}\n",
                _table(_rows(section.model_fields, title)),
            ]
    return "\n".join(parts)


def _rows(fields: dict[str, FieldInfo], prefix: str):
    """Yield key, default and meaning of every field, including those of nested sections."""
    for name, field in fields.items():
        key = f"{prefix}.{name}" if prefix else name
        inner = section_in(field.annotation) if prefix else None
        if inner is not None and _is_section(field):
            yield from _rows(inner.model_fields, key)
            continue
        yield key, _default(field), _text(field.description)
        if inner is not None:
            yield from _rows(inner.model_fields, f"{key}[]")


def _table(rows) -> str:
    lines = ["| key | default | meaning |", "| --- | --- | --- |"]
    lines += [f"| `{key}` | {default} | {meaning} |" for key, default, meaning in rows]
    return "\n".join(lines) + "\n"


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "must be given"
    value = field.get_default(call_default_factory=True)
    if value is None:
        return "none"
    if isinstance(value, dict) and value and all(one is None for one in value.values()):
        value = list(value)
    return f"`{json.dumps(value, ensure_ascii=False)}`"


def _text(docstring: str | None) -> str:
    """Return a docstring as one line of Markdown."""
    return " ".join((docstring or "").split()).replace("``", "`").replace("|", "\\|")


def _is_section(field: FieldInfo) -> bool:
    return isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel)
