"""What the values of a recording and a run share: arrays that nobody can change, one line of summary, issues."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from moteslam.errors import InputError

_LONGEST = 40
"""Characters of a value that are shown."""
_SPANS = 3
"""As many times are given, others counted."""


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

    def as_dict(self) -> dict[str, Any]:
        """The same as plain values, fit for JSON."""
        return asdict(self)


class Summarised:
    """Base of a dataclass (made with ``repr=False``) whose ``repr`` is its name and one line about what it holds."""

    def _summary(self) -> str:
        """What is in it: every field, arrays as their type and shape; fields that are None are left out."""
        named = [(field.name, getattr(self, field.name)) for field in fields(self)]  # type: ignore[arg-type]
        return ", ".join(f"{name}={_brief(value)}" for name, value in named if value is not None)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._summary()})"


def _brief(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{list(value.shape)}"
    if isinstance(value, tuple | list | dict):
        return counted(len(value), "item")
    return repr(value) if isinstance(value, str | int | float | Summarised) else type(value).__name__


def span(stamps: NDArray[np.float64]) -> str:
    """The time from the first stamp to the last, ``60.0 s``."""
    return f"{stamps[-1] - stamps[0] if len(stamps) else 0.0:.1f} s"


def counted(count: int, what: str) -> str:
    """A number of things, ``1 frame`` and ``2 frames``."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def interval(first: str, last: str) -> str:
    """From the first to the last, ``2 to 3``; once where they are the same."""
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
    """Refuse an argument of another type, where it would end deep in NumPy.

    Args:
        value: the argument.
        kind: what it must be an instance of.
        field: name of the parameter.
        hint: how to come by one: ``open_recording(path) reads one``.
    """
    if not isinstance(value, kind):
        found = type(value).__name__ + (f" {shortened(value)}" if isinstance(value, str | int | float) else "")
        raise InputError(f"{found}, expected {kind.__name__}{f': {hint}' if hint else ''}", field=field)


def frozen(values: ArrayLike, dtype: DTypeLike | None = None) -> NDArray[Any]:
    """The values as a contiguous array that cannot be written to.

    An array that can still be written to is copied, another one is taken as it is; so readers hand over what is large
    ``given_up``.
    """
    try:
        array: NDArray[Any] = np.ascontiguousarray(values, dtype)
    except (TypeError, ValueError) as error:
        raise InputError(f"{type(values).__name__} {shortened(values)}, expected an array of numbers") from error
    if array.flags.writeable and isinstance(values, np.ndarray) and np.may_share_memory(array, values):
        array = array.copy()
    array.setflags(write=False)
    return array


def given_up(array: NDArray[Any]) -> NDArray[Any]:
    """An array that its only owner writes to no more, so that the value it goes into need not copy it."""
    array.setflags(write=False)
    return array


def processor_count() -> int:
    """The processors that this process may run on, which may be fewer than the machine has."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
