"""The floor in colours along an estimated trajectory, where the recording has camera images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from moteslam.errors import InputError
from moteslam.robot.recording import Recording
from moteslam.robot.values import Issue
from moteslam.slam.config import SlamConfig
from moteslam.slam.estimate import Estimate
from moteslam.slam.texture.floor_map import TextureMapper, can_map, map_texture


def wants_colours(config: SlamConfig, recording: Recording) -> bool:
    """Whether the floor is to be coloured: it is asked for, and there are images of it."""
    return config.texture.enabled and can_map(recording)


def with_texture(
    estimate: Estimate, recording: Recording, *, watch: Callable[[float, TextureMapper], None] | None = None
) -> Estimate:
    """The estimate with the floor coloured along its final trajectory (section III.E of the paper).

    Args:
        estimate: of ``recording``.
        recording: what the sensors saw.
        watch: as in ``map_texture``.

    Returns:
        the same with ``texture`` and its warnings; unchanged where the floor is not to be coloured; with a warning
        alone where it cannot be: the estimate is not lost for it.
    """
    if not wants_colours(estimate.config, recording):
        return estimate
    try:
        texture = map_texture(recording, estimate.trajectory_final, estimate.config.texture, watch=watch)
    except InputError as error:
        issue = Issue("floor-not-coloured", f"the floor is not coloured: {error}")
        return replace(estimate, warnings=(*estimate.warnings, issue))
    return replace(estimate, texture=texture, warnings=(*estimate.warnings, *texture.warnings))
