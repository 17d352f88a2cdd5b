"""Where the odometry jumps: steps that no robot drives, and this one never does."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.slam.inputs.config import SyncConfig

Array = NDArray[np.float64]
USUAL = 90
"""The percentile of the steps that is compared with."""


def jumps(stamps: Array, odometry: Array, config: SyncConfig | None = None) -> NDArray[np.bool_]:
    """At which scans the odometry has jumped since the scan before.

    Args:
        stamps: [n] of the scans [s]; where two are equal there is no speed, and no jump.
        odometry: [n, 3] poses there.
        config: the bounds; the defaults if None.

    Returns:
        [n]; the first is False.
    """
    c = config or SyncConfig()
    dt = np.diff(stamps)
    motion = se2.between(odometry[:-1], odometry[1:])
    jump = np.zeros(len(dt), np.bool_)
    for size, fastest, least in (
        (np.hypot(motion[:, 0], motion[:, 1]), c.max_speed, c.min_jump_distance),
        (np.abs(motion[:, 2]), c.max_turn_rate, c.min_jump_rotation),
    ):
        usual = c.jump_factor * float(np.percentile(size, USUAL)) if len(size) else 0.0
        jump |= (dt > 0) & (size > np.maximum(fastest * dt, max(least, usual)))
    return np.concatenate(([False], jump))
