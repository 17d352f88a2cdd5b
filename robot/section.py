"""What every table of a configuration, a scenario and a platform is made of: strict types in a frozen model.

A text is no number and a truth value no integer, in TOML as in Python; a list is taken where a tuple is asked for.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import AllowInfNan, BaseModel, ConfigDict, Field, Strict

Truth = Annotated[bool, Strict()]
Whole = Annotated[int, Strict()]

SMALLEST, LARGEST = 1e-9, 1e9
"""Of every number in a table, in its unit: squares and quotients of what lies between stay far from overflow."""

Number = Annotated[float, Strict(), AllowInfNan(False), Field(ge=-LARGEST, le=LARGEST)]
NotNegative = Annotated[float, Strict(), AllowInfNan(False), Field(ge=0, le=LARGEST)]
Positive = Annotated[float, Strict(), AllowInfNan(False), Field(ge=SMALLEST, le=LARGEST)]
Share = Annotated[float, Strict(), AllowInfNan(False), Field(ge=0, le=1)]


class Section(BaseModel):
    """A table; unknown keys are refused. What a key means stands in the docstring below it, for the reference."""

    model_config = ConfigDict(frozen=True, extra="forbid")
