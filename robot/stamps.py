"""The one search for the stamp nearest to a time; gaps between stamps."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

GAP, LEAST_GAP = 10.0, 0.5
"""Readings have a gap between them where they are this many times as far apart as the median of the latest 1000, and by
more than the second [s]."""
LATEST = 1000
"""How many intervals that is the median of."""


def nearest_stamp(
    stamps: NDArray[np.float64], times: NDArray[np.float64], *, side: Literal["left", "right"] = "left"
) -> NDArray[np.intp]:
    """The index of the stamp nearest to each time; the earlier of two equally near.

    Args:
        stamps: [n] rising, at least one [s].
        times: of any shape [s].
        side: of several stamps that equal a time the first (``left``) or the last (``right``) is taken.

    Returns:
        indices into ``stamps``, of the shape of ``times``.
    """
    after = np.clip(np.searchsorted(stamps, times, side=side), 1, max(len(stamps) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(stamps) - 1)
    return np.where(times - stamps[before] <= stamps[after] - times, before, after)


def gaps(stamps: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Before which stamps [n] there is a gap; causal.

    Args:
        stamps: [n] rising [s].
    """
    intervals = np.diff(stamps)
    gap = np.zeros(len(stamps), np.bool_)
    for k in np.flatnonzero(intervals > LEAST_GAP).tolist():
        gap[k + 1] = intervals[k] > GAP * np.median(intervals[max(0, k + 1 - LATEST) : k + 1])
    return gap
