"""Running SLAM over a recording."""

from __future__ import annotations

from collections.abc import Callable

from moteslam.robot.recording import Recording
from moteslam.slam.config import SlamConfig
from moteslam.slam.core import MakeFilter
from moteslam.slam.estimate import Estimate, with_texture
from moteslam.slam.online import OnlineSlam
from moteslam.slam.scan_records import Update


def run_slam(
    recording: Recording,
    config: SlamConfig | None = None,
    seed: int = 0,
    watch: Callable[[Update], None] | None = None,
    method: MakeFilter | None = None,
) -> Estimate:
    """Run SLAM over a recording, and colour the floor along the final trajectory where there are images.

    Args:
        recording: with a lidar; with some odometry, too, unless the method does without.
        config: the preset ``default`` if None.
        seed: of all randomness.
        watch: called after every scan.
        method: makes the filter in place of the configuration's method: a class of your own, for one.
    """
    slam = OnlineSlam.over(recording, config, seed, method=method)
    for update in slam:
        if watch is not None:
            watch(update)
    return with_texture(slam.estimate(), recording)
