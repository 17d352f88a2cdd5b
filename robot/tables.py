"""TOML tables and the models that they become: strict types in frozen sections, merged key by key.

A text is no number and a truth value no integer, in TOML as in Python; a list is taken where a tuple is asked for.
"""

from __future__ import annotations

import tomllib
from collections.abc import Collection, Iterator, Sequence
from os import PathLike
from typing import Annotated, Any, TypeVar

from pydantic import AllowInfNan, BaseModel, ConfigDict, Field, Strict, ValidationError

from moteslam.errors import ConfigError
from moteslam.robot.files import read_text
from moteslam.robot.values import shortened

Table = dict[str, Any]

MAX_BYTES = 4_000_000
"""No configuration, platform or scenario is larger."""

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


Model = TypeVar("Model", bound=BaseModel)


def validated(
    model: type[Model],
    table: object,
    *,
    file: str | PathLike[str] | None = None,
    above: str = "",
    kinds: Collection[str] = (),
) -> Model:
    """The model of a table.

    Args:
        model: of the table.
        table: as read.
        file: that it is from.
        above: the key that the table stands under there.
        kinds: of the items of its lists that are one of several models; no part of the field that an error names.

    Raises:
        ConfigError: a key or value that the model refuses, in pydantic's words.
    """
    try:
        return model.model_validate(table)
    except ValidationError as error:
        field, problem = first_complaint(error, kinds)
        raise ConfigError(problem, file=file, field=".".join(filter(None, (above, field))) or None) from error


def first_complaint(error: ValidationError, kinds: Collection[str] = ()) -> tuple[str, str]:
    """The field, with dots, and the problem of the first thing that is wrong.

    A key that is missing where another is unknown is most likely misspelt: the unknown one is named first.
    """
    errors = error.errors(include_url=False)
    first = next((one for one in errors if one["type"] == "extra_forbidden"), errors[0])
    place = first["loc"]
    field = ".".join(
        str(part) for k, part in enumerate(place) if not (k and part in kinds and isinstance(place[k - 1], int))
    )
    if first["type"] == "extra_forbidden":
        return field, "unknown key"
    problem = first["msg"].removeprefix("Value error, ")
    found = "" if first["type"] in ("missing", "value_error") else f", found {shortened(first['input'])}"
    return field, problem + found


def read_toml(path: str | PathLike[str], what: str) -> Table:
    """The table of a TOML file of at most ``MAX_BYTES``; ``what`` was expected there: ``a TOML file``."""
    text = read_text(path, what, limit=MAX_BYTES, error=ConfigError)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"not TOML: {error}", file=path) from error


def merged(base: Table, over: Table) -> Table:
    """``base`` with the single values of ``over`` in place of its own, tables within tables."""
    result = dict(base)
    for key, value in over.items():
        below = result.get(key)
        result[key] = merged(below, value) if isinstance(below, dict) and isinstance(value, dict) else value
    return result


def leaves(table: Table, prefix: str = "") -> Iterator[str]:
    """The dotted keys of a table's values."""
    for key, value in table.items():
        if isinstance(value, dict):
            yield from leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}"


def assigned(settings: Sequence[str]) -> Table:
    """The table of settings ``key=value`` with dotted keys; a value is TOML, a bare word a string, the last counts."""
    if isinstance(settings, str):
        raise ConfigError(f"{settings!r}, expected a list of key=value", field="settings")
    table: Table = {}
    for setting in settings:
        key, equals, value = setting.partition("=")
        if not equals or not key.strip():
            raise ConfigError(f"expected key=value, found {setting!r}", field="settings")
        tree: Any = toml_value(value.strip())
        for part in reversed(key.strip().split(".")):
            tree = {part: tree}
        table = merged(table, tree)
    return table


def toml_value(text: str) -> Any:
    """A value as TOML writes it; anything else is a string."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):  # no value, too many digits, or nested too deep
        return text
