"""The one search for the stamp nearest to a time."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray


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
