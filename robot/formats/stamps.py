"""What becomes of the stamps of a stream: sorted if some go back, refused if they are absurd or of several clocks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.values import Issue, counted

MAX_SPAN = 10 * 365.25 * 86400.0
"""A recording longer than this [s] is none: ten years."""

MAX_JUMP = 86400.0
"""A longer silence [s] within a stream is a broken stamp: one day."""

MAX_STAMP = 1e11
"""Seconds beyond this (the year 5138) are milliseconds or garbage."""


SET_BACK = 2.0
"""Readings that are late by less [s] are those of a busy logger; loggers of several processes are up to 1 s apart."""

STRAGGLERS = 10
"""At most this many readings in a row are late messages; more of them are of a clock that was set back."""

MAX_DROPPED = 3
"""Up to this many readings without a stamp are always dropped; more of them only up to a tenth of the stream."""


def set_back(stamps: NDArray[np.float64]) -> int | None:
    """The first reading after a clock was set back, where the stamps [n] [s] go on from there; None if it never was.

    So it is in a log of two runs, of a simulator that was reset, or of a recording that was played in a loop. A few
    messages that come late, after which the stamps return to where they were, are no such thing.
    """
    behind = np.maximum.accumulate(stamps) - stamps
    edges = np.flatnonzero(np.diff(np.concatenate(([False], behind > SET_BACK, [False])).astype(np.int8)))
    for first, last in edges.reshape(-1, 2).tolist():
        returns = last < len(stamps) and stamps[last] - stamps[last - 1] > 0.5 * behind[first]
        if last - first > (STRAGGLERS if returns else MAX_DROPPED):
            return int(first)
    return None


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
        indices [k] of a stable sort, or None where the stamps rise already, and what was done. Readings with the stamp
        0 among others of Unix time, of a driver that was up before its clock, are left out.

    Raises:
        InputError: a stamp that is not finite, beyond 1e11 s, more than a day from the next, or more than ten years
            from the first; or a clock that was set back.
    """
    finite = np.isfinite(stamps)
    if not finite.all():
        first = int(np.argmin(finite))
        raise InputError(f"{stamps[first]} at reading {first}, expected finite seconds", file=file, field=field)
    far = np.abs(stamps) > MAX_STAMP
    if far.any():
        raise InputError(f"{stamps[int(np.argmax(far))]:.6g}, expected seconds below 1e11", file=file, field=field)
    issues = []
    kept = np.arange(len(stamps))
    without = (stamps == 0) & stamps.any() & (np.min(stamps[stamps != 0], initial=np.inf) > MAX_JUMP)
    if 0 < (count := int(without.sum())) <= max(MAX_DROPPED, len(stamps) // 10):
        text = f"{file.name}: {field}: {counted(count, 'reading')} with the stamp 0 left out, before the clock was set"
        issues.append(Issue("unset-stamps", text, count))
        kept = np.flatnonzero(~without)
    used = stamps[kept]
    if (again := set_back(used)) is not None:
        seconds = used[:again].max() - used[again]
        raise InputError(
            f"the clock goes back by {seconds:.6g} s at reading {kept[again]} and goes on from there: several "
            "recordings in one, expected one; cut the file there",
            file=file,
            field=field,
        )
    back = int((np.diff(used) < 0).sum())
    order = kept[np.argsort(used, kind="stable")] if back else kept
    rising = stamps[order]
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
    if back:
        text = f"{file.name}: {field}: {back} stamps go back; the readings were sorted by stamp"
        issues.append(Issue("stamps-go-back", text, back))
    return (order if issues else None), tuple(issues)
