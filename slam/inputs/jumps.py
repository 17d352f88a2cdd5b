"""Where the odometry jumps: steps that no robot drives, and that this one has not driven before."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.slam.inputs.config import SyncConfig

Array = NDArray[np.float64]
USUAL = 90
"""The percentile of the latest steps that a step is compared with."""
LATEST = 1000
"""How many steps are compared with."""


def jumps(stamps: Array, odometry: Array, config: SyncConfig | None = None) -> NDArray[np.bool_]:
    """At which readings the odometry has jumped since the reading before.

    A step has jumped if it is faster than a robot drives and ``jump_factor`` times as long as the 90th percentile of
    the latest 1000 steps. These end with the step itself, so that the result is causal. With a factor of ten none of
    the first nine steps is a jump: a single long step does not stand out among nine. Log writers stamp readings in
    bursts: a step counts as having taken at least the median time of the latest steps.

    Args:
        stamps: [n] of the readings [s]; where two are equal there is no speed, and no jump.
        odometry: [n, 3] poses there.
        config: the bounds; the defaults if None.

    Returns:
        [n]; the first is False.
    """
    c = config or SyncConfig()
    dt = np.diff(stamps)
    motion = se2.between(odometry[:-1], odometry[1:])
    jump = np.zeros(len(stamps), np.bool_)
    for size, fastest, least in (
        (np.hypot(motion[:, 0], motion[:, 1]), c.max_speed, c.min_jump_distance),
        (np.abs(motion[:, 2]), c.max_turn_rate, c.min_jump_rotation),
    ):
        for step in np.flatnonzero((dt > 0) & (size > np.maximum(fastest * dt, least))).tolist():
            latest = slice(max(0, step + 1 - LATEST), step + 1)
            farthest = max(fastest * np.median(dt[latest]), c.jump_factor * np.percentile(size[latest], USUAL))
            jump[step + 1] |= size[step] > farthest
    return jump
