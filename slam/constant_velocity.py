"""The motion of a step that nothing measured: the last one goes on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

MOST = 10.0
"""Times as long as the step before; a longer gap is likelier a wrong stamp, or a robot that has long stopped."""


def carried_on(motion: NDArray[np.float64], seconds: float, dt: float) -> NDArray[np.float64]:
    """The motion of a step at the velocity of the step before.

    Args:
        motion: [3] of the step before, as filtered.
        seconds: that it took.
        dt: of this step [s].

    Returns:
        [3], scaled by the times where both say something: the same motion where one is 0, as in logs whose scans
        share stamps; at most ``MOST`` times as far.
    """
    if seconds <= 0 or dt <= 0:
        return motion
    return motion * min(dt / seconds, MOST)
