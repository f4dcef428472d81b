"""Base model of all configuration sections, and types with plausible values."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from vibraverse.physics.plausible import SIZE_M, size_mistake


class Section(BaseModel):
    """A block of ``config.yaml``: unknown keys are errors, values are checked, and instances are immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True)


def plausible(mistake: Callable[[float], str], bounds: tuple[float, float]):
    """Return the type of a positive number for which ``mistake`` returns no text; the schema gets its ``bounds``."""

    def check(value: float) -> float:
        if wrong := mistake(value):
            raise ValueError(wrong)
        return value

    schema = {"minimum": bounds[0], "maximum": bounds[1]}
    return Annotated[float, Field(gt=0, json_schema_extra=schema), AfterValidator(check)]


#: Longest side of an object in metres.
Size = plausible(size_mistake, SIZE_M)
