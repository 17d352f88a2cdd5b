"""When messages were: whole nanoseconds in a bag, float64 seconds in memory; and which of them are used."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.formats.bags.bag import Topic
from moteslam.robot.formats.stamps import stamp_order
from moteslam.robot.issues import Issue
from moteslam.robot.wording import counted

SECOND = 1_000_000_000
"""Nanoseconds."""

MAX_BROKEN = 3
"""Up to this many broken messages are always dropped; more of them only up to a tenth of the topic."""


def seconds(nanoseconds: NDArray[np.int64]) -> NDArray[np.float64]:
    """Stamps [s], each the float64 nearest to it but for one rounding more."""
    return nanoseconds // SECOND + (nanoseconds % SECOND) / SECOND


def nanoseconds(stamps: NDArray[np.float64]) -> NDArray[np.int64]:
    """Stamps [s] as whole nanoseconds, rounded half to even.

    From 2^23 s on (97 days: all of Unix time) float64 is coarser than a nanosecond, and ``seconds`` gives the same
    stamps back, bit for bit; below it they come back to within half a nanosecond.
    """
    whole = np.floor(stamps)
    return whole.astype(np.int64) * SECOND + np.rint((stamps - whole) * SECOND).astype(np.int64)


def used_messages(
    path: Path, topic: Topic, stamps: NDArray[np.int64], broken: NDArray[np.bool_], issues: list[Issue]
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Which messages of a topic are used, in the order of their stamps, and these.

    Where no header has a stamp, the times of reception are taken.

    Args:
        path: of the bag.
        topic: of the messages.
        stamps: [n] of their headers [ns].
        broken: [n] which are not what their type says; they are dropped.
        issues: what was dropped or repaired is added.

    Returns:
        indices [m] of messages, and their stamps [m] [s], rising.

    Raises:
        InputError: more than 3 broken ones that are more than a tenth, or none that is whole; or absurd stamps.
    """
    bad = int(broken.sum())
    if bad == len(broken) or bad > max(MAX_BROKEN, len(broken) // 10):
        problem = f"{bad} of {counted(len(broken), 'message')} broken, expected those of a {topic.kind}"
        raise InputError(problem, file=path, field=topic.name)
    if bad:
        text = f"{path.name}: {topic.name}: {counted(bad, 'broken message')} dropped"
        issues.append(Issue("broken-messages", text, bad))
    kept = np.flatnonzero(~broken)
    if not stamps[kept].any():
        text = f"{path.name}: {topic.name}: no stamps in the headers, the times of reception are taken"
        issues.append(Issue("no-header-stamps", text, len(kept)))
        stamps = topic.received
    times = seconds(stamps[kept])
    order, found = stamp_order(times, file=path, field=topic.name)
    issues.extend(found)
    return (kept, times) if order is None else (kept[order], times[order])
