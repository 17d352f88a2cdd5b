"""What becomes of the stamps of a stream: sorted if some go back, refused if they are absurd."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.issues import Issue

MAX_SPAN = 10 * 365.25 * 86400.0
"""A recording longer than this [s] is none: ten years."""

MAX_JUMP = 86400.0
"""A longer silence [s] within a stream is a broken stamp: one day."""

MAX_STAMP = 1e11
"""Seconds beyond this (the year 5138) are milliseconds or garbage."""


def stamp_order(
    stamps: NDArray[np.float64], *, file: Path, field: str
) -> tuple[NDArray[np.intp] | None, tuple[Issue, ...]]:
    """The order that makes the stamps rise, and an issue if it is not the one they came in.

    Readings that share a stamp are distinct and stay in the order they came in.

    Args:
        stamps: [n] [s].
        file: where they come from, for messages.
        field: the array or kind of line, for messages.

    Returns:
        indices [n] of a stable sort, or None where the stamps rise already; and an issue, or none.

    Raises:
        InputError: a stamp that is not finite, beyond 1e11 s, more than a day from the next, or more than ten years
            from the first.
    """
    finite = np.isfinite(stamps)
    if not finite.all():
        first = int(np.argmin(finite))
        raise InputError(f"{stamps[first]} at reading {first}, expected finite seconds", file=file, field=field)
    far = np.abs(stamps) > MAX_STAMP
    if far.any():
        raise InputError(f"{stamps[int(np.argmax(far))]:.6g}, expected seconds below 1e11", file=file, field=field)
    back = int((np.diff(stamps) < 0).sum())
    order = np.argsort(stamps, kind="stable") if back else None
    rising = stamps if order is None else stamps[order]
    steps = np.diff(rising)
    if len(steps) and steps.max() > MAX_JUMP:
        at = int(np.argmax(steps))
        raise InputError(
            f"jump of {steps[at]:.6g} s after {float(rising[at])!r}, expected steps of less than a day",
            file=file,
            field=field,
        )
    if len(steps) and rising[-1] - rising[0] > MAX_SPAN:
        raise InputError(f"span {rising[-1] - rising[0]:.6g} s, expected less than 10 years", file=file, field=field)
    if order is None:
        return None, ()
    text = f"{file.name}: {field}: {back} stamps go back; the readings were sorted by stamp"
    return order, (Issue("stamps-go-back", text, back),)
