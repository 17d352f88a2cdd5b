"""Values that hold arrays, in one line: what is in them, not the numbers."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.wording import counted


class Summarised:
    """Base of a dataclass (made with ``repr=False``) whose ``repr`` is its name and one line about what it holds."""

    def _summary(self) -> str:
        """What is in it: every field, arrays as their type and shape; fields that are None are left out."""
        named = [(field.name, getattr(self, field.name)) for field in fields(self)]  # type: ignore[arg-type]
        return ", ".join(f"{name}={_brief(value)}" for name, value in named if value is not None)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._summary()})"


def span(stamps: NDArray[np.float64]) -> str:
    """The time from the first stamp to the last, ``60.0 s``."""
    return f"{stamps[-1] - stamps[0] if len(stamps) else 0.0:.1f} s"


def _brief(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{list(value.shape)}"
    if isinstance(value, tuple | list | dict):
        return counted(len(value), "item")
    if isinstance(value, str | int | float | Summarised):
        return repr(value)
    return type(value).__name__
