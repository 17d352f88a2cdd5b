"""A planar scanning lidar, its beams cast one after the other while the robot moves."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from moteslam.robot.arrays import given_up
from moteslam.robot.platform import LidarMount
from moteslam.robot.recording import LidarStream
from moteslam.robot.section import NotNegative, Number, Positive, Section, Share
from moteslam.sim.robot.drive import Drive
from moteslam.sim.sensors.beams import add_false_returns, mix_at_edges
from moteslam.sim.sensors.clock import ClockNoise, readings
from moteslam.sim.sensors.echoes import Floats, Scene

LIDAR_RATE = 40.0
"""Scans a second [Hz]."""
BEAMS = 1081
"""Ranges in a scan."""
ANGLE_MIN = float(np.radians(-135))
ANGLE_INCREMENT = float(np.radians(0.25))
RANGE_MAX = 30.0

_CHUNK = 512
"""Scans cast at a time: half a million rays."""


class LidarNoise(Section):
    """The Hokuyo UTM-30LX: data sheet, repeated accuracy sigma < 10 mm to 10 m, < 30 mm to 30 m, resolution 1 mm.

    Attributes:
        range_noise: standard deviation of a range at the sensor [m].
        range_noise_per_metre: how it grows with the range [m/m]: 13 mm at 10 m, 23 mm at 30 m.
        dropout: probability that a beam gives no usable reading (``nan``).
        resolution: ranges are rounded to this [m]; 0 for not at all.
        range_min: below which a beam gives no usable reading [m] (data sheet: 0.1).
        divergence: the angle that a beam is wide, in the scan's plane [rad]; 0 for a line. About 0.013 for this
            sensor (a spot of 0.4 m at 30 m).
        mixed: share of the beams on an edge that measure a range in between.
        pulse: largest distance between near and far side of an edge at which they melt into one echo [m]; beyond it,
            one of the two is measured.
        false_return: share of the beams that meet rain, dust or snow.
        false_scale: mean distance of such an echo [m] (exponential, the short readings of table 6.1 of Probabilistic
            Robotics).
        clock: of the scans.
    """

    range_noise: NotNegative = 0.008
    range_noise_per_metre: NotNegative = 0.0005
    dropout: Share = 0.005
    resolution: NotNegative = 0.001
    range_min: Annotated[Number, Field(ge=0, le=5)] = 0.1
    divergence: Annotated[Number, Field(ge=0, le=0.1)] = 0.0
    mixed: Share = 0.5
    pulse: NotNegative = 1.0
    false_return: Share = 0.0
    false_scale: Positive = 3.0
    clock: ClockNoise = ClockNoise(jitter=0.0003, late=0.002, late_delay=0.005, burst_interval=0.001, rate_error=2e-4)


def simulate_lidar(
    drive: Drive,
    scene: Scene,
    mount: LidarMount,
    noise: LidarNoise,
    span: tuple[float, float],
    rng: np.random.Generator,
    *,
    effects: np.random.Generator | None = None,
    progress: Callable[[float], None] | None = None,
) -> LidarStream:
    """The scans of a Hokuyo UTM-30LX.

    Beam b of a scan at time t is cast from where the lidar truly is at t + b * time_increment.

    Args:
        drive: how the robot truly moved.
        scene: what the beams hit.
        mount: where the lidar is and the time between its beams.
        noise: of the ranges and the clock.
        span: of the first scan's and the last scan's first beam [s].
        rng: random generator of noise and clock.
        effects: random generator of surfaces, edges and rain; of seed 0 by default.
        progress: called with the share of the scans done.

    Returns:
        ranges float32 [n, 1081]: ``inf`` beyond 30 m, ``nan`` below the minimum and where a beam was lost.
    """
    times, stamps = readings(LIDAR_RATE, *span, noise.clock, rng)
    effects = np.random.default_rng(0) if effects is None else effects
    offsets = mount.time_increment * np.arange(BEAMS)
    angles = ANGLE_MIN + ANGLE_INCREMENT * np.arange(BEAMS)
    ranges = np.empty((len(times), BEAMS), np.float32)
    for start in range(0, len(times), _CHUNK):
        rows = slice(start, start + _CHUNK)
        moments = times[rows, None] + offsets
        poses = _poses_at(drive, moments, mount)
        origins, directions = poses[..., :2].reshape(-1, 2), (poses[..., 2] + angles).reshape(-1)
        exact = beam_ranges(scene, origins, directions, moments.reshape(-1), noise, effects)
        ranges[rows] = measured(exact.reshape(-1, BEAMS), noise, rng)
        if progress is not None:
            progress(min(1.0, (start + _CHUNK) / len(times)))
    return LidarStream(
        stamps=stamps,
        ranges=given_up(ranges),
        angle_min=ANGLE_MIN,
        angle_increment=ANGLE_INCREMENT,
        range_min=noise.range_min,
        range_max=RANGE_MAX,
        time_increment=mount.time_increment,
    )


def beam_ranges(
    scene: Scene, origins: Floats, angles: Floats, times: Floats, noise: LidarNoise, rng: np.random.Generator
) -> NDArray[np.float32]:
    """The ranges of beams before the sensor's own noise.

    A beam of some divergence is three rays, its middle and its two sides (see `mix_at_edges`).

    Args:
        scene: what the beams meet.
        origins: [n, 2] [m]; angles: [n] [rad]; times: [n] [s], of the beams.
        noise: of the lidar.
        rng: drawn from, only where something is random.

    Returns:
        float32 [n] [m]: ``inf`` for no echo, ``nan`` for one that is of no use.
    """
    ranges = scene.echoes(origins, angles, times, rng, max_range=RANGE_MAX)
    if noise.divergence > 0:
        half = noise.divergence / 2
        sides = [scene.exact(origins, angles + off, times, max_range=RANGE_MAX) for off in (-half, half)]
        middle = ranges if scene.is_plain else scene.exact(origins, angles, times, max_range=RANGE_MAX)
        ranges = mix_at_edges(ranges, middle, np.stack(sides), mixed=noise.mixed, pulse=noise.pulse, rng=rng)
    if noise.false_return > 0:
        ranges = add_false_returns(
            ranges, share=noise.false_return, nearest=noise.range_min, scale=noise.false_scale, rng=rng
        )
    return ranges


def measured(exact: NDArray[np.float32], noise: LidarNoise, rng: np.random.Generator) -> NDArray[np.float32]:
    """Ranges as the sensor reports them: noise that grows with the range, dropouts, limits, resolution.

    Args:
        exact: ranges [m], any shape; ``inf`` where nothing is within reach, ``nan`` where an echo is of no use.
        noise: what to add.
        rng: drawn from, two numbers a range.

    Returns:
        float32, the same shape.
    """
    hit = np.isfinite(exact)
    useless = np.isnan(exact)
    spread = noise.range_noise + noise.range_noise_per_metre * np.where(hit, exact, 0)
    ranges = np.where(hit, exact + spread * rng.standard_normal(exact.shape, np.float32), np.inf)
    if noise.resolution > 0:
        ranges = np.round(ranges / noise.resolution) * noise.resolution
    ranges[ranges > RANGE_MAX] = np.inf
    ranges[(ranges < noise.range_min) | (rng.random(exact.shape, np.float32) < noise.dropout)] = np.nan
    ranges[useless] = np.nan
    return ranges.astype(np.float32)


def _poses_at(drive: Drive, times: NDArray[np.float64], mount: LidarMount) -> NDArray[np.float64]:
    """The lidar's true poses [n, beams, 3], heading not wrapped; the drive's steps are evenly spaced."""
    step = drive.stamps[1] - drive.stamps[0]
    at = np.clip(times / step, 0, len(drive.stamps) - 1)
    i = np.minimum(at.astype(np.int64), len(drive.stamps) - 2)
    share = (at - i)[..., None]
    robot = drive.poses[i] * (1 - share) + drive.poses[i + 1] * share
    cos, sin = np.cos(robot[..., 2]), np.sin(robot[..., 2])
    robot[..., 0] += cos * mount.x - sin * mount.y
    robot[..., 1] += sin * mount.x + cos * mount.y
    robot[..., 2] += mount.yaw
    return np.asarray(robot, np.float64)
