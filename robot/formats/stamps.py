"""What becomes of the stamps of a stream: sorted if some go back, refused if they are absurd or of several clocks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.values import Issue, counted

Stamps = NDArray[np.float64]

MAX_STAMP = 1e11
"""Seconds beyond this (the year 5138) are milliseconds or garbage."""
MAX_JUMP = 86400.0
"""A longer silence [s] within a stream is a broken stamp: one day."""
MAX_SPAN = 10 * 365.25 * 86400.0
"""A recording longer than this [s] is none: ten years."""
SET_BACK = 2.0
"""Readings of a log that are late by less [s] are those of a busy logger, whose processes are up to 1 s apart."""
FOLLOWING, FEWEST = 10, 3
"""Readings that all stay behind after a clock was set back; near the end of the recording the second."""
MAX_DROPPED = 3
"""Up to this many readings that cannot be are always dropped; more of them only up to a tenth of the stream."""


def clock_cuts(stamps: Stamps, back: float) -> list[int]:
    """The readings before which a clock was set back by more than ``back`` [s] or, on and on, ahead by more than a day.

    So it is in a log of two runs, of a simulator that was reset, or of a recording that was played in a loop. A few
    messages that come late, after which the stamps return to where they were, are no such thing.
    """
    found, start, last = list[int](), 0, len(stamps) - FEWEST
    if last <= 0:
        return found
    highest = _window(stamps, -np.inf).max(axis=1)
    lowest = _window(stamps, np.inf).min(axis=1)
    while start < last and len(found) < 1000:
        peak = np.maximum.accumulate(stamps[start:last])
        after = slice(start + 1, last + 1)
        is_back = (stamps[after] < peak - back) & (highest[after] < peak)
        at = np.flatnonzero(is_back | (lowest[after] - peak > MAX_JUMP))
        if not len(at):
            break
        start += 1 + int(at[0])
        found.append(start)
    return found


def _window(stamps: Stamps, beyond: float) -> Stamps:
    """Each stamp with those that follow [n, FOLLOWING]."""
    return sliding_window_view(np.concatenate((stamps, np.full(FOLLOWING - 1, beyond))), FOLLOWING)


def stamp_order(stamps: Stamps, *, file: Path, field: str) -> tuple[NDArray[np.intp] | None, tuple[Issue, ...]]:
    """The order [k] that makes stamps [n] [s] rise, None where they do, and an issue of what was done.

    Readings that share a stamp stay in the order they came in. Those with the stamp 0 among others of Unix time, of a
    driver that was up before its clock, are left out.
    """
    bad = ~(np.abs(stamps) <= MAX_STAMP)
    if bad.any():
        first = int(np.argmax(bad))
        problem = f"{stamps[first]:.6g} at reading {first}, expected finite seconds below 1e11"
        raise InputError(problem, file=file, field=field)
    issues = []
    kept = np.arange(len(stamps))
    unset = (stamps == 0) & (np.min(stamps[stamps != 0], initial=np.inf) > MAX_JUMP) & stamps.any()
    if 0 < (count := int(unset.sum())) <= max(MAX_DROPPED, len(stamps) // 10):
        text = f"{file.name}: {field}: {counted(count, 'reading')} with the stamp 0 left out, before the clock was set"
        issues.append(Issue("unset-stamps", text, count))
        kept = np.flatnonzero(~unset)
    used = stamps[kept]
    if cuts := [at for at in clock_cuts(used, SET_BACK) if used[at] < used[at - 1]]:
        seconds = used[: cuts[0]].max() - used[cuts[0]]
        raise InputError(
            f"the clock goes back by {seconds:.6g} s at reading {kept[cuts[0]]} and goes on from there: several "
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
        problem = f"jump of {steps[at]:.6g} s after {float(rising[at])!r}, expected steps of less than a day"
        raise InputError(problem, file=file, field=field)
    if len(steps) and rising[-1] - rising[0] > MAX_SPAN:
        raise InputError(f"span {rising[-1] - rising[0]:.6g} s, expected less than 10 years", file=file, field=field)
    if back:
        text = f"{file.name}: {field}: {back} stamps go back; the readings were sorted by stamp"
        issues.append(Issue("stamps-go-back", text, back))
    return (order if issues else None), tuple(issues)
