"""Running SLAM over a recording, and colouring the floor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from moteslam.errors import InputError
from moteslam.robot.recording import Recording
from moteslam.robot.values import Issue
from moteslam.slam.config import SlamConfig
from moteslam.slam.core import MakeFilter
from moteslam.slam.estimate import Estimate
from moteslam.slam.online import OnlineSlam
from moteslam.slam.scan_records import Update
from moteslam.slam.texture.floor_map import TextureMapper, can_map, map_texture


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


def wants_colours(config: SlamConfig, recording: Recording) -> bool:
    """Whether the floor is to be coloured: it is asked for, and there are images of it."""
    return config.texture.enabled and can_map(recording)


def with_texture(
    estimate: Estimate, recording: Recording, *, watch: Callable[[float, TextureMapper], None] | None = None
) -> Estimate:
    """The estimate of a recording with the floor coloured along its final trajectory (section III.E of the paper).

    It is unchanged where the floor is not to be coloured, and has a warning alone where it cannot be: the estimate is
    not lost for it. ``watch``: see ``map_texture``.
    """
    if not wants_colours(estimate.config, recording):
        return estimate
    try:
        texture = map_texture(recording, estimate.trajectory_final, estimate.config.texture, watch=watch)
    except InputError as error:
        issue = Issue("floor-not-coloured", f"the floor is not coloured: {error}")
        return replace(estimate, warnings=(*estimate.warnings, issue))
    return replace(estimate, texture=texture, warnings=(*estimate.warnings, *texture.warnings))
