"""A planar scanning lidar, its beams cast one after the other while the robot moves."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.platform import LidarMount
from moteslam.robot.recording import LidarStream
from moteslam.sim.drive import Drive
from moteslam.sim.noise import LidarNoise
from moteslam.sim.rates import BEAMS, LIDAR_RATE
from moteslam.sim.sensors.beams import beam_ranges
from moteslam.sim.sensors.clock import readings
from moteslam.sim.sensors.echoes import Scene
from moteslam.sim.world import World

ANGLE_MIN = float(np.radians(-135))
ANGLE_INCREMENT = float(np.radians(0.25))
RANGE_MAX = 30.0

_CHUNK = 512
"""Scans cast at a time: half a million rays."""


def simulate_lidar(
    drive: Drive,
    world: World,
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
        world: what the beams hit.
        mount: where the lidar is and the time between its beams.
        noise: of the ranges and the clock.
        span: of the first scan's and the last scan's first beam [s].
        rng: of noise and clock.
        effects: of what surfaces, edges and rain do; seed 0 where there is none.
        progress: told the share of the scans done.

    Returns:
        ranges float32 [n, 1081]: ``inf`` beyond 30 m, ``nan`` below the minimum and where a beam was lost.
    """
    times, stamps = readings(LIDAR_RATE, *span, noise.clock, rng)
    scene = Scene(world, drive.movers)
    chance = np.random.default_rng(0) if effects is None else effects
    offsets = mount.time_increment * np.arange(BEAMS)
    angles = ANGLE_MIN + ANGLE_INCREMENT * np.arange(BEAMS)
    ranges = np.empty((len(times), BEAMS), np.float32)
    for start in range(0, len(times), _CHUNK):
        rows = slice(start, start + _CHUNK)
        moments = times[rows, None] + offsets
        poses = _poses_at(drive, moments, mount)
        origins, directions = poses[..., :2].reshape(-1, 2), (poses[..., 2] + angles).reshape(-1)
        exact = beam_ranges(scene, origins, directions, moments.reshape(-1), noise, chance, max_range=RANGE_MAX)
        ranges[rows] = measured(exact.reshape(-1, BEAMS), noise, rng)
        if progress is not None:
            progress(min(1.0, (start + _CHUNK) / len(times)))
    return LidarStream(
        stamps=stamps,
        ranges=ranges,
        angle_min=ANGLE_MIN,
        angle_increment=ANGLE_INCREMENT,
        range_min=noise.range_min,
        range_max=RANGE_MAX,
        time_increment=mount.time_increment,
    )


def measured(exact: NDArray[np.float32], noise: LidarNoise, rng: np.random.Generator) -> NDArray[np.float32]:
    """Ranges as the sensor tells them: noise that grows with the range, dropouts, limits, resolution.

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
