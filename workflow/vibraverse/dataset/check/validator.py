"""The check of a shard against the schema, field by field: presence, types, shapes, units, ranges, checksums, index.

The equations that its numbers must satisfy are in :mod:`vibraverse.dataset.check.invariants`, the recomputation in
:mod:`vibraverse.dataset.check.recompute`. A shard with a wrong byte may be broken in any way, so an error from HDF5 is
a finding about the object that raised it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator

from vibraverse.contract.refusal import said
from vibraverse.contract.texts import and_more
from vibraverse.dataset import schema
from vibraverse.dataset.check.invariants import violated
from vibraverse.dataset.schema import stored
from vibraverse.dataset.schema.checksums import differences
from vibraverse.dataset.schema.fields import FIELDS
from vibraverse.dataset.schema.ranges import outside
from vibraverse.dataset.schema.tables import Columns, from_tsv, to_tsv
from vibraverse.dataset.write.making import VARIES
from vibraverse.dataset.write.pack import index_row
from vibraverse.flow.paths import SOLIDITIES

#: Changed fields that a finding names.
_SHOWN_FIELDS = 3
#: Fields that refused objects also have.
_ALWAYS = (schema.CHECKSUMS,)
#: Fields for mode shapes; every material has one of them.
_SHAPES = ("mode_coefficients", "mode_shapes")
#: Types of the errors that HDF5 and NumPy raise for damaged bytes, and for values that do not fit.
DAMAGE = (ArithmeticError, LookupError, MemoryError, OSError, RuntimeError, ValueError)
_PNG = b"\x89PNG\r\n\x1a\n"


def problems(h5, repeats=None) -> list[tuple[str, str]]:
    """Return the findings about an open shard: object ("" for the shard itself) and sentence; [] if it is valid.

    ``repeats(object_id, group, making)`` yields more findings about an object that is otherwise sound.
    """
    try:
        strange = schema.strange(h5)
        if strange:
            return [("", strange)]
        rows = _by_object(stored.text(h5, schema.INDEX), schema.SHARD_COLUMNS)
        refusals = _by_object(stored.text(h5, schema.REFUSALS), schema.REFUSAL_COLUMNS)
        making = _making(stored.text(h5, schema.MAKING))
        names = list(stored.group(h5, "objects"))
        looks = making.get("images", {}).get("options", {}).get("looks")
        optional = [schema.BY_NAME["views"].path] if looks in ([], VARIES) else []
    except DAMAGE as error:
        return [("", f"its own tables cannot be read ({_said(error)})")]
    found = []
    for object_id in names:
        sentences: list[str] = []
        try:
            group = stored.group(h5["objects"], object_id)
            told = rows.get(object_id, []), refusals.get(object_id, [])
            sentences.extend(_of_object(object_id, group, *told, optional))
            if not sentences and repeats is not None:
                sentences.extend(repeats(object_id, group, making))
        except DAMAGE as error:
            sentences.append(f"it cannot be read ({_said(error)})")
        found += [(object_id, sentence) for sentence in sentences]
    for object_id in sorted({**rows, **refusals}.keys() - set(names)):
        found.append((object_id, "the shard's index names it, but there is no such group"))
    return found


def _making(text: str) -> dict:
    """Return how a shard was made: versions and options by stage."""
    making = json.loads(text)
    stages = list(making.values()) if isinstance(making, dict) else [None]
    if not all(isinstance(stage, dict) and isinstance(stage.get("options", {}), dict) for stage in stages):
        raise ValueError(f"{schema.MAKING} is no record of stages")
    return making


def _by_object(table: str, columns: Columns) -> dict[str, list[dict]]:
    """Return the rows of a table by object."""
    found: dict[str, list[dict]] = {}
    for row in from_tsv(table, columns):
        found.setdefault(row["object"], []).append(row)
    return found


def _of_object(
    object_id: str, group, rows: list[dict], refusals: list[dict], optional: list[str]
) -> Iterator[str]:
    """Yield the findings about one object, checksums first, because they say most. It may lack ``optional`` fields."""
    if schema.CHECKSUMS not in group:
        yield f"it has no {schema.CHECKSUMS!r}"
        return
    wrong = differences(group)
    sound = not wrong
    if wrong:
        named = " ".join([", ".join(wrong[:_SHOWN_FIELDS]), *and_more(len(wrong), _SHOWN_FIELDS)])
        yield f"not as it was written: {named}"
    contents = _contents(group)
    unknown = [path for path in contents if not schema.knows(path) or _misplaced(path, contents[path])]
    for path in unknown:
        del contents[path]
    strange = [f"the dataset has no field at {path!r}" for path in unknown]
    missing = [
        f"{path} is missing" for path in _expected(group) if path not in contents and path not in optional
    ]
    for sentence in (*strange, *_fields(contents), *missing, *_shapes(contents)):
        sound = False
        yield sentence
    if sound:
        yield from violated(group)
        yield from _index(object_id, group, rows, refusals)


def _contents(group) -> dict[str, object]:
    """Return path -> value of every attribute, and path -> HDF5 dataset of every other field."""
    import h5py

    found: dict[str, object] = {}

    def visit(name, item):
        is_dataset = isinstance(item, h5py.Dataset)
        for key in item.attrs:
            if not (is_dataset and key == "unit"):
                found[f"{name}@{key}"] = stored.attribute(item, key, f"{name}@{key}")
        if is_dataset:
            found[name] = stored.shaped(item, name)

    visit("", group)
    group.visititems(visit)
    return found


def _misplaced(path: str, item) -> bool:
    """Return whether an attribute takes the place of a dataset, or the other way round."""
    import h5py

    return schema.field_at(path).is_attribute == isinstance(item, h5py.Dataset)


def _fields(contents: dict) -> Iterator[str]:
    """Yield every wrong type, unit or range."""
    import h5py

    for path, item in contents.items():
        field = schema.field_at(path)
        if field.is_text:
            text = item if field.is_attribute else stored.text_of(item, path)
            if not isinstance(text, str):
                yield f"{path} is no text"
            elif field.dtype == "json" and not _is_record(text):
                yield f"{path} holds no record (JSON)"
            continue
        dtype = getattr(item, "dtype", type(item).__name__)
        if field.dtype == "png":
            if h5py.check_vlen_dtype(dtype) != "uint8":
                yield f"{path} holds no pictures"
            elif not all(picture[:8].tobytes() == _PNG for picture in item[()]):
                yield f"{path} holds something that is no PNG file"
        elif dtype != field.dtype:
            yield f"{path} is {dtype}, not {field.dtype}"
        elif wrong := outside(field.name, item if field.is_attribute else item[()]):
            yield f"{path} {wrong}"
        if not field.is_attribute and item.attrs.get("unit") != field.unit:
            yield f"{path} has the unit {item.attrs.get('unit')!r}, not {field.unit!r}"


def _is_record(text: str) -> bool:
    try:
        return isinstance(json.loads(text), dict)
    except ValueError:
        return False


def _expected(group) -> Iterator[str]:
    """Yield the path of every field that an object with these bodies, materials, looks and sounds must have.

    If it has none of them, the path keeps the wildcard.
    """
    refused = "refusal_reason" in group.attrs
    bodies = {
        name: "refusal_reason" in stored.group(group, name).attrs for name in SOLIDITIES if name in group
    }
    for field in FIELDS:
        if field.name == "spectrum":
            if not bodies.get("solid", True):
                yield field.path
        elif field.path.startswith("{solidity}"):
            for solidity, gone in bodies.items():
                if field.path.startswith("{solidity}/sampled/") and "sampled" not in group[solidity]:
                    continue
                if field.name in _SHAPES and not gone:
                    yield from _shapes_of(field.name, f"{solidity}/materials", group)
                elif field.is_refusal == gone:
                    yield from _filled(field.path.replace("{solidity}", solidity), group)
        elif field.path.startswith("hollow/"):
            if not bodies.get("hollow", True):
                yield field.path
        elif field.is_refusal == refused or field.name in _ALWAYS:
            yield from _filled(field.path, group)


def _shapes_of(name: str, place: str, group) -> Iterator[str]:
    """Yield the paths of the materials' mode shapes: coefficients in the basis, or shapes solved on the mesh."""
    for material, values in stored.members(group, place).items():
        if bool(values.attrs.get("solved_directly")) == (name == "mode_shapes"):
            yield f"{place}/{material}/{name}"


def _filled(path: str, group) -> Iterator[str]:
    """Yield the paths in a group that match a pattern, with each name that the group has at the wildcard."""
    found = re.match(r"(.*)/({\w+})", path)
    if found is None:
        yield path
        return
    for name in stored.members(group, found[1]) or [found[2]]:
        yield path.replace(found[2], name)


def _shapes(contents: dict) -> Iterator[str]:
    """Yield every shape that contradicts the table; a letter is the same number wherever it means the same thing."""
    known: dict[tuple[str, str], int] = {}
    waiting = []
    for path, item in contents.items():
        field = schema.field_at(path)
        shape = getattr(item, "shape", ())
        sizes = [size.strip() for size in field.shape.strip("()").split(",") if size.strip()]
        if len(shape) != len(sizes):
            yield f"{path} has shape {shape}, not {field.shape}"
            continue
        for size, length in zip(sizes, shape, strict=True):
            if size.isalpha() and known.setdefault(_meant(path, size), length) == length:
                continue
            waiting.append((path, shape, field.shape, size, length))
    for path, shape, expected, size, length in waiting:
        terms = re.findall(r"(\d*)([A-Za-z]*)", size)
        total = sum(
            int(factor or 1) * (known.get(_meant(path, letter), 0) if letter else 1)
            for factor, letter in terms
            if factor or letter
        )
        if total != length:
            yield f"{path} has shape {shape}, not {expected} with {size} = {total}"


def _meant(path: str, letter: str) -> tuple[str, str]:
    """Return the scope of a letter in the shape of the field at ``path``, and the letter."""
    place = path.rpartition("/")[0]
    if letter == "samples":
        place = path
    elif letter == "views":
        place = ""
    elif letter in "rcV" and ("/materials/" in path or "/basis/" in path):
        place = f"{path.split('/')[0]}/basis"
    return place, letter


def _index(object_id: str, group, rows: list[dict], refusals: list[dict]) -> Iterator[str]:
    """Yield the differences between the shard's rows of the index and the object's group."""
    for row in rows:
        place = {name: row[name] for name in ("solidity", "material", "shard")}
        found = from_tsv(
            to_tsv([index_row(group, object_id, **place)], schema.SHARD_COLUMNS), schema.SHARD_COLUMNS
        )[0]
        wrong = [name for name in found if found[name] != row[name]]
        if wrong:
            yield (
                f"{row['solidity']}, {row['material']}: the index says {wrong[0]} = {row[wrong[0]]!r}, "
                f"the group {found[wrong[0]]!r}"
            )
    there = {(s, name) for s in SOLIDITIES if s in group for name in group[s].get("materials") or ()}
    for solidity, material in sorted(there ^ {(row["solidity"], row["material"]) for row in rows}):
        yield f"{solidity}, {material}: it stands either in the index or in the group, not in both"
    told = {row["solidity"] for row in refusals}
    gone = {s for s in SOLIDITIES if s in group and "refusal_reason" in group[s].attrs}
    if told != ({""} if "refusal_reason" in group.attrs else gone):
        yield "the shard's list of refusals does not agree with its groups"


def _said(error: Exception) -> str:
    return f"{type(error).__name__}: {said(error)}"
