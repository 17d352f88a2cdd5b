"""What values and tables share: issues, summaries, arrays that nobody can change; TOML and the models of its tables.

Tables become frozen pydantic models of strict types: a text is no number and a truth value no integer, in TOML as in
Python; a list is taken where a tuple is asked for.
"""

import os
import tomllib
from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass, fields
from os import PathLike
from typing import Annotated, Any, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray
from pydantic import AllowInfNan, BaseModel, ConfigDict, Field, Strict, ValidationError

from moteslam.errors import ConfigError, InputError, explained
from moteslam.files import read_text

Table = dict[str, Any]

_LONGEST = 40  # Characters of a value that are shown
_SPANS = 3  # As many times are given, others counted


@dataclass(frozen=True)
class Issue:
    """Something that was dropped, repaired or missing; printed, it is its message.

    Attributes:
        code: its kind, such as ``stamps-go-back``; stable, to filter and count by (``docs/reference/formats.md``).
        message: one line for people, with the file and the numbers.
        count: how many readings, frames, scans, lines or images it concerns; 1 for a whole stream or run.
    """

    code: str
    message: str
    count: int = 1

    def __str__(self) -> str:
        return self.message

    def as_dict(self) -> Table:
        """The same as plain values, fit for JSON."""
        return asdict(self)


class Summarised:
    """Base of a dataclass (made with ``repr=False``) whose ``repr`` is its name and one line about what it holds."""

    def _summary(self) -> str:
        """Every field, arrays but poses as their type and shape; fields that are None are left out."""
        named = [(field.name, getattr(self, field.name)) for field in fields(self)]  # type: ignore[arg-type]
        return ", ".join(f"{name}={_brief(value)}" for name, value in named if value is not None)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._summary()})"


def _brief(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return str(value.round(4).tolist()) if value.shape == (3,) else f"{value.dtype}{list(value.shape)}"
    if isinstance(value, tuple | list | dict | float):
        return f"{value:.14g}" if isinstance(value, float) else counted(len(value), "item")
    return repr(value) if isinstance(value, str | int | Summarised) else type(value).__name__


def span(stamps: NDArray[np.float64]) -> str:
    """The time from the first stamp to the last, ``60.0 s``."""
    return f"{stamps[-1] - stamps[0] if len(stamps) else 0.0:.1f} s"


def unpadded(head: str, stamps: NDArray[np.float64], words: Sequence[str] = ()) -> tuple[Issue, ...]:
    """An issue of ``{sec}.{nsec}`` without leading zeros: stamps [n] [s] all over the second, but for its first tenth.

    They pass from tenth to tenth 100 times; or 40 are there, and their ``words``, as in the file, show it: one of fewer
    digits and decimals than others that ends in 0, of a writer that neither trims zeros nor fills up with them.
    """
    part = (stamps + 1e-6) % 1.0  # 0.1 may be stored as less
    if len(stamps) < 40 or (part[part > 2e-6] < 0.1).any() or (part < 0.1).sum() > 0.05 * len(stamps):
        return ()
    steps, parts = np.diff(np.sort(stamps)), 10 if np.ptp(stamps) < 0.102 * len(stamps) else 20  # a slow one has gaps
    missing = 9 * parts // 10 - len(np.unique(np.floor(parts * part[part >= 0.1])))
    passed = (np.abs(steps - np.rint(steps)) > 0.1).sum() + 10 * steps[steps < 0.1].sum()  # by 1.01 s seldom
    sizes = [(len(word.lstrip("-0.")), len(word.partition(".")[2]), word[-1] == "0") for word in words]
    digits, decimals, zero = np.array(sizes, np.int64).reshape(-1, 3).T
    few = (decimals > zero) & (decimals < decimals.max(initial=0)) & (digits < digits.max(initial=0))
    shown = bool(zero[few].any())
    if missing > 3 * shown or not (shown or passed >= 100):
        return ()
    text = "no stamp has a fraction below 0.1 s: nano- or microseconds seem to be written without their leading zeros, "
    text += "and about a tenth of the stamps are late by up to 0.9 s: write %d.%09d"
    return (Issue("stamps-jitter", f"{head}: {text}"),)


def counted(count: int, what: str) -> str:
    """A number of things, ``1 frame`` and ``2 frames``."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def interval(first: str, last: str) -> str:
    """``2 to 3``; one of them where they are the same."""
    return first if first == last else f"{first} to {last}"


def when(spans: list[tuple[float, float]]) -> str:
    """Times [s], ``from 2.00 to 3.00 s``; spans less than a second apart are one."""
    joined = spans[:1]
    for begin, end in spans[1:]:
        if begin - joined[-1][1] < 1.0:
            joined[-1] = joined[-1][0], end
        else:
            joined.append((begin, end))
    first = ", ".join(f"{begin:.2f} to {end:.2f} s" for begin, end in joined[:_SPANS])
    return f"from {first}" + (f" and {len(joined) - _SPANS} times more" if len(joined) > _SPANS else "")


def shortened(value: object) -> str:
    """A value as Python writes it, cut where it is long."""
    text = repr(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


def expect_type(value: object, kind: type, field: str, hint: str = "") -> None:
    """Refuse an argument ``field`` of another type; the hint says how to come by one: ``open_recording(path)``."""
    if not isinstance(value, kind):
        found = type(value).__name__ + (f" {shortened(value)}" if isinstance(value, str | int | float) else "")
        raise InputError(f"{found}, expected {kind.__name__}{f': {hint}' if hint else ''}", field=field)


def frozen(values: ArrayLike, dtype: DTypeLike | None = None) -> NDArray[Any]:
    """The values as a contiguous read-only array; an array that can still be written to is copied."""
    try:
        array: NDArray[Any] = np.ascontiguousarray(values, dtype)
    except (TypeError, ValueError) as error:
        raise InputError(f"{type(values).__name__} {shortened(values)}, expected an array of numbers") from error
    if array.flags.writeable and isinstance(values, np.ndarray) and np.may_share_memory(array, values):
        array = array.copy()
    return given_up(array)


def given_up(array: NDArray[Any]) -> NDArray[Any]:
    """An array that its only owner writes to no more, so that the value it goes into need not copy it."""
    array.setflags(write=False)
    return array


def processor_count() -> int:
    """The processors that this process may run on, which may be fewer than the machine has."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


MAX_BYTES = 4_000_000  # No configuration, platform or scenario is larger

Truth = Annotated[bool, Strict()]
Whole = Annotated[int, Strict()]

SMALLEST, LARGEST = 1e-9, 1e9
"""Of every number in a table, in its unit: squares and quotients of what lies between stay far from overflow."""

_Finite = Annotated[float, Strict(), AllowInfNan(False)]
Number = Annotated[_Finite, Field(ge=-LARGEST, le=LARGEST)]
NotNegative = Annotated[_Finite, Field(ge=0, le=LARGEST)]
Positive = Annotated[_Finite, Field(ge=SMALLEST, le=LARGEST)]
Share = Annotated[_Finite, Field(ge=0, le=1)]
Angle = Annotated[_Finite, Field(ge=-2 * np.pi, le=2 * np.pi)]


class Section(BaseModel):
    """A table; unknown keys are refused. What a key means stands in the docstring, for the reference."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            field, problem = first_complaint(error, model=type(self))
            raise ConfigError(problem, field=field or None) from error

    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]  # tables in tables are not made by it

    def __setattr__(self, name: str, value: Any) -> None:
        raise ConfigError("it never changes, expected a changed copy: with_()", field=name)

    def with_(self, **changes: Any) -> Self:
        """A checked copy with some values changed, those of tables one by one: ``with_(lidar={"x": 0.2})``."""
        return validated(type(self), merged(self.model_dump(), changes))


Model = TypeVar("Model", bound=BaseModel)


def validated(
    model: type[Model],
    table: object,
    *,
    file: str | PathLike[str] | None = None,
    above: str = "",
    kinds: Collection[str] = (),
) -> Model:
    """The model of a table; a `ConfigError` in pydantic's words names the file and the field.

    The table stands under the key ``above`` there. ``kinds`` of items of its lists, where these are one of several
    models, are no part of the field.
    """
    try:
        return model.model_validate(table)
    except ValidationError as error:
        field, problem = first_complaint(error, kinds, model)
        raise ConfigError(problem, file=file, field=".".join(filter(None, (above, field))) or None) from error
    except ConfigError as error:  # of a validator that knows the field
        raise ConfigError(error.problem, file=error.file or file, field=error.field) from error


def first_complaint(error: ValidationError, kinds: Collection[str] = (), model: Any = None) -> tuple[str, str]:
    """The field, with dots, and the problem of the first thing that is wrong.

    A key that is missing where another is unknown is most likely misspelt: the unknown one is named first.
    """
    errors = error.errors(include_url=False)
    first = next((one for one in errors if one["type"] == "extra_forbidden"), errors[0])
    loc = first["loc"]
    field = ".".join(str(one) for k, one in enumerate(loc) if not (k and one in kinds and isinstance(loc[k - 1], int)))
    silent = first["type"] in ("extra_forbidden", "missing", "value_error")
    return field, explained(first, model) + ("" if silent else f", found {shortened(first['input'])}")


def read_toml(path: str | PathLike[str], what: str) -> Table:
    """The table of a TOML file of at most ``MAX_BYTES``; ``what`` was expected there: ``a TOML file``."""
    text = read_text(path, what, limit=MAX_BYTES, error=ConfigError)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"not TOML: {error}", file=path) from error


def merged(base: Table, over: Table) -> Table:
    """``base`` overridden by the single values of ``over``, tables within tables."""
    result = dict(base)
    for key, value in over.items():
        below = result.get(key)
        result[key] = merged(below, value) if isinstance(below, dict) and isinstance(value, dict) else value
    return result


def assigned(settings: Sequence[str]) -> Table:
    """The table of settings ``key=value`` with dotted keys; a value is TOML, a bare word a string, the last counts."""
    if isinstance(settings, str):
        raise ConfigError(f"{settings!r}, expected a list of key=value", field="settings")
    table: Table = {}
    for setting in settings:
        key, equals, value = setting.partition("=")
        if not equals or not key.strip():
            raise ConfigError(f"expected key=value, found {setting!r}", field="settings")
        try:
            tree = tomllib.loads(f"value = {value.strip()}")["value"]
        except (ValueError, RecursionError):  # no value, too many digits, or nested too deep
            tree = value.strip()
        for part in reversed(key.strip().split(".")):
            tree = {part: tree}
        table = merged(table, tree)
    return table
