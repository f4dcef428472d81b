"""The configuration: typed sections, a sentence for every mistake, and a JSON schema made from the types."""

from __future__ import annotations

import importlib
import json
import os
from pathlib import Path

from pydantic import BaseModel, Field, ValidationError, field_validator, model_validator

from vibraverse.config.base import Section
from vibraverse.config.dataset import Dataset, Report
from vibraverse.config.geometry import Clean, Grids, Hollow, Tets
from vibraverse.config.learn import Learn
from vibraverse.config.media import Audio, Images
from vibraverse.config.physics import Basis, Material, Modes, Sampled
from vibraverse.config.sources import Sources
from vibraverse.contract.errors import UsageError
from vibraverse.contract.readable import unreadable
from vibraverse.contract.slices import JOIN, slice_numbers
from vibraverse.contract.texts import listed, unknown
from vibraverse.media.looks import LOOKS
from vibraverse.physics.materials import MATERIALS, sampled_number


class ConfigError(UsageError):
    """Mistakes in the configuration: one is a sentence, several are a list with a line each under ``subject``."""

    def __init__(self, *mistakes: str, subject: str = "the configuration"):
        super().__init__(mistakes[0] if len(mistakes) == 1 else listed(subject, mistakes))
        self.mistakes = mistakes


class Config(Section):
    """The whole of ``config.yaml``."""

    results: str = "results"
    """Folder of all products."""

    slice: str | None = None
    """``i/n``: only the i-th of n parts of the objects, up to their shards of the dataset; ``join``: only the products
    made from the shards. Default: everything (see docs/cluster.md)."""

    sources: Sources = Sources()
    """Sources of the objects."""

    materials: dict[str, Material | None] = Field(
        default_factory=lambda: dict.fromkeys(["ceramic", "glass", "wood", "steel"]),
        min_length=1,
        validate_default=True,
    )
    """Materials by name: one of the table (with an empty value) or your own with all five numbers."""

    sampled: Sampled = Sampled()
    """Materials drawn at random."""

    solidities: list[str] = Field(default_factory=lambda: ["solid", "hollow"], min_length=1)
    """Bodies made of every object: ``solid``, ``hollow`` or both."""

    clean: Clean = Clean()
    """Mesh cleaning."""

    grids: Grids = Grids()
    """Voxels and signed distance."""

    hollow: Hollow = Hollow()
    """Hollow bodies."""

    tets: Tets = Tets()
    """Tetrahedra."""

    basis: Basis = Basis()
    """The modal basis."""

    modes: Modes = Modes()
    """Frequencies of every material."""

    audio: Audio = Audio()
    """Impact sounds."""

    images: Images = Images()
    """Pictures."""

    dataset: Dataset = Dataset()
    """Shards, index and splits."""

    report: Report = Report()
    """The report: a web page."""

    learn: Learn = Learn()
    """Training on the dataset, with ``snakemake learn``."""

    @field_validator("results")
    @classmethod
    def _expand_home(cls, path):
        return os.path.expanduser(path)

    @field_validator("slice")
    @classmethod
    def _known_slice(cls, text):
        if text not in (None, JOIN):
            slice_numbers(text)
        return text

    @model_validator(mode="after")
    def _slices_own_whole_shards(self):
        if self.slice not in (None, JOIN):
            _, slices = slice_numbers(self.slice)
            if slices > self.dataset.shards:
                raise ValueError(
                    f"slice: a slice makes whole shards of the dataset, and dataset.shards is {self.dataset.shards}; "
                    f"raise it to {slices} or more, or cut at most {self.dataset.shards} slices"
                )
        return self

    @field_validator("materials")
    @classmethod
    def _known_materials(cls, materials):
        for name, values in materials.items():
            if values is None and name not in MATERIALS:
                own = ", ".join(Material.model_fields)
                raise ValueError(f"{unknown('material', name, MATERIALS)}; one of your own needs {own}")
            if not name.replace("-", "").replace("_", "").isalnum():
                raise ValueError(f"the material name {name!r} may hold only letters, digits, '-' and '_'")
            if sampled_number(name) is not None:
                raise ValueError(
                    f"the material name {name!r} is reserved for sampled materials; choose another"
                )
        return {name: values or Material(**MATERIALS[name]) for name, values in materials.items()}

    @field_validator("solidities")
    @classmethod
    def _known_solidities(cls, solidities):
        for name in solidities:
            if name not in ("solid", "hollow"):
                raise ValueError(unknown("solidity", name, ("solid", "hollow")))
        return list(dict.fromkeys(solidities))

    @model_validator(mode="after")
    def _sounds_differ(self):
        for material in self.materials:
            struck = self.audio.names([material])[1:]
            for name in filter(self.materials.__contains__, struck):
                raise ValueError(
                    f"materials: the sound of {name!r} has the name of that of {material!r} struck at a point of "
                    f"audio.points, {name}.wav; rename one of them"
                )
        return self

    @model_validator(mode="after")
    def _known_looks(self):
        for look in self.images.looks:
            if look not in LOOKS and look not in self.materials:
                raise ValueError(
                    f"images.looks: {unknown('look', look, LOOKS)}; or a material of your own, in clay"
                )
        return self

    @model_validator(mode="after")
    def _features_exist(self):
        features, (lowest, highest) = self.learn.features, self.basis.poisson_range
        low, high = features.poisson_range
        if "learn" in self.model_fields_set and not lowest <= low <= high <= highest:
            raise ValueError(
                f"learn.features.poisson_range ({low:g} to {high:g}) must lie in basis.poisson_range ({lowest:g} to "
                f"{highest:g}); narrow the one, or widen the other"
            )
        if "learn" in self.model_fields_set and features.look not in self.images.looks:
            raise ValueError(f"learn.features.look: {unknown('look', features.look, self.images.looks)}")
        return self

    @model_validator(mode="after")
    def _sampled_fits(self):
        (low, high), (lowest, highest) = self.sampled.poisson, self.basis.poisson_range
        if self.sampled.count and not lowest <= low <= high <= highest:
            raise ValueError(
                f"sampled.poisson ({low:g} to {high:g}) must lie in basis.poisson_range ({lowest:g} to {highest:g}): "
                "sampled materials are never solved on the mesh; narrow the one, or widen the other"
            )
        if self.audio.sampled > self.sampled.count:
            raise ValueError(
                f"audio.sampled must be at most sampled.count, {self.sampled.count}, not {self.audio.sampled}"
            )
        return self


def parse(values: dict | None) -> Config:
    """Return the validated configuration; raises :class:`ConfigError` with every mistake."""
    return validate(Config, values or {})


def validate(model: type[BaseModel], values: dict, prefix: str = ""):
    """Return ``values`` validated as ``model``; raises :class:`ConfigError` with a sentence per mistake and key."""
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise ConfigError(*_sentences(model, error.errors(include_url=False), prefix)) from None


def section(named: str) -> type[BaseModel]:
    """Return the section class with the name ``module:Class`` in this package."""
    module, _, name = named.partition(":")
    return getattr(importlib.import_module(f"vibraverse.config.{module}"), name)


def load(path: str | Path) -> Config:
    """Read and validate a YAML configuration file; raises :class:`ConfigError` with every mistake."""
    values = read(path)
    try:
        return parse(values)
    except ConfigError as error:
        if len(error.mistakes) > 1:
            raise ConfigError(*error.mistakes, subject=str(path)) from None
        raise ConfigError(f"{path}: {error}") from None


def read(path: str | Path) -> dict:
    """Return the keys and values of a YAML file; raises :class:`ConfigError` with a sentence that names the file."""
    import yaml

    path = Path(path)
    if wrong := unreadable(path, missing="create it, or name another one"):
        raise ConfigError(f"the configuration file {path} {wrong}")
    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8"))
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f", line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        raise ConfigError(
            f"{path}{place} is not valid YAML: {error.problem or error.context}; correct that line"
        ) from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(
            f"{path} is not valid YAML: {' '.join(str(error).split())}; save it as UTF-8 text"
        ) from None
    if values is None:  # Snakemake does not accept an empty file either
        raise ConfigError(f"{path} holds no keys; write {{}} for a run with every default")
    if not isinstance(values, dict):
        raise ConfigError(f"{path} must hold keys and values, not {_shown(values)}")
    return values


def schema_text() -> str:
    """Return the JSON schema of the configuration, which is committed in ``workflow/schemas``."""
    return json.dumps(Config.model_json_schema(), indent=2, ensure_ascii=False) + "\n"


#: pydantic's type of a mistake -> the expectation in words; braces take values of its context.
_EXPECTED = {
    "greater_than": "must be greater than {gt:g}",
    "greater_than_equal": "must be at least {ge:g}",
    "less_than": "must be less than {lt:g}",
    "less_than_equal": "must be at most {le:g}",
    "finite_number": "must be a finite number",
    "literal_error": "must be {expected}",
    "too_short": "must hold {min_length} or more",
    "too_long": "must hold {max_length} or fewer",
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "must be a whole number"),
    **dict.fromkeys(("float_type", "float_parsing"), "must be a number"),
    "string_type": "must be text",
    **dict.fromkeys(("list_type", "tuple_type"), "must be a list"),
    **dict.fromkeys(("dict_type", "model_type", "model_attributes_type"), "must hold keys and values"),
}


def _sentences(model: type[BaseModel], errors: list[dict], prefix: str) -> list[str]:
    """Return one sentence for every mistake, unknown keys first."""
    sentences: dict[str, str] = {}
    branches: dict[tuple, str] = {}
    for error in sorted(errors, key=lambda one: one["type"] != "extra_forbidden"):
        *parent, name = error["loc"] or ("",)
        # A misspelt key is also a missing one; report only the misspelling.
        if error["type"] == "missing" and any(
            sentence.startswith(f"unknown key '{_key(parent, prefix)}")
            and f"did you mean {name!r}?" in sentence
            for sentence in sentences.values()
        ):
            continue
        # A value that fits no branch of a union is wrong in each; report only the first.
        at = next((place for place, part in enumerate(error["loc"]) if "[" in str(part)), None)
        if at is not None and branches.setdefault(error["loc"][:at], error["loc"][at]) != error["loc"][at]:
            continue
        sentences.setdefault(_key(error["loc"], prefix), _sentence(model, error, prefix))
    return list(sentences.values())


def _key(location, prefix: str) -> str:
    key = prefix
    for part in location:
        if isinstance(part, int) and key:
            key += f"[{part}]"
        elif "[" not in str(part):  # the other parts name a branch of a union, not a key
            key += f".{part}" if key else str(part)
    return key


def _sentence(model: type[BaseModel], error: dict, prefix: str) -> str:
    key = _key(error["loc"], prefix)
    if error["type"] == "extra_forbidden":
        known = _fields_at(model, error["loc"][:-1])
        return f"unknown key {key!r}; " + unknown("key", error["loc"][-1], known).split("; ", 1)[-1]
    if error["type"] == "value_error":
        return f"{key}: {error['ctx']['error']}" if key else str(error["ctx"]["error"])
    if error["type"] == "missing":
        return f"{key} is missing; add it"
    if error["type"] == "invalid_key":
        return f"the key {key!r} must be text"
    if error["type"] in _EXPECTED:
        expected = _EXPECTED[error["type"]].format(**error.get("ctx", {}))
    else:
        expected = f"is not valid ({error['msg'][0].lower()}{error['msg'][1:]})"
    form = _as_keys(error["input"]) if key == "materials" else ""
    return f"{key} {expected}, not {_shown(error['input'])}{form}"


def _as_keys(value) -> str:
    """Return the advice to write materials as keys, which may have values, instead of a list."""
    given = value if isinstance(value, list) else [value]
    names = [
        name
        for one in given
        for name in ([one] if isinstance(one, str) else one if isinstance(one, dict) else [])
    ]
    written = ", ".join(f"{name}: " for name in names[:3] or ["steel"])
    return f"; write materials: {{{written}}}, or each name with its colon on a line of its own below it, indented"


def _shown(value) -> str:
    """Return a wrong value as shown in a sentence."""
    if value is None or value == {} or value == []:
        return "nothing"
    if isinstance(value, dict):
        return f"keys and values ({', '.join(map(str, value))})"
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 60 else f"{text[:57]}…"


def _fields_at(model: type[BaseModel], location) -> list[str]:
    """Return the valid keys at the place of an unknown one."""
    current = model
    for part in location:
        inner = getattr(current, "model_fields", {}).get(part) if isinstance(part, str) else None
        current = section_in(inner.annotation) if inner else current
    return list(current.model_fields)


def section_in(annotation):
    """Return the section class in an annotation such as ``list[Files]`` or ``dict[str, Material]``, or None."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for argument in getattr(annotation, "__args__", ()):
        found = section_in(argument)
        if found is not None:
            return found
    return None


__all__ = [
    "Config",
    "ConfigError",
    "Material",
    "Modes",
    "load",
    "parse",
    "read",
    "schema_text",
    "section_in",
    "validate",
]
