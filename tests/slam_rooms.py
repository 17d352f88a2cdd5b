"""Recordings for tests of SLAM: rooms small enough to reason about, and recordings with a fault put in."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from moteslam.eval.metrics.ate import absolute_trajectory_error
from moteslam.robot import se2
from moteslam.robot.formats.map_server import FREE, OCCUPIED, UNKNOWN
from moteslam.robot.platforms import CARMEN
from moteslam.robot.raster import Raster
from moteslam.robot.recording import LidarStream, OdometryStream, Recording
from moteslam.robot.trajectory import Trajectory
from moteslam.sim.scenario import parse_scenario
from moteslam.sim.simulate import Simulation, simulate
from moteslam.slam.config import resolve_config
from moteslam.slam.estimate import Estimate
from moteslam.slam.inputs.synchronise import dead_reckon
from moteslam.slam.online import run_slam

STEP = np.radians(1.5)
ANGLES = np.radians(np.arange(-135, 135, 1.5))  # Of the beams [rad], and between them
REACH = 4.0  # Of the lidar in `bare_corridor` [m]


def run(recording: Recording, *settings: str, preset: str = "default", seed: int = 0) -> Estimate:
    return run_slam(recording, resolve_config(preset, settings), seed=seed)


def ate(path: Trajectory, reference: Trajectory) -> float:
    """The RMSE of a path laid on a reference [m]."""
    return absolute_trajectory_error(path, reference).rmse


def circled_room(*, scans: int = 120, drift: float = 0.03) -> tuple[Recording, np.ndarray]:
    """A robot that circles in a 6 x 4 m room with a box in it; its odometry drifts. Returns the true poses too."""
    turn = 2 * np.pi / 60
    true = se2.accumulate(np.vstack(([0, 0, 0], np.tile([0.08, 0, turn], (scans - 1, 1)))))
    odometry = se2.accumulate(np.vstack(([0, 0, 0], np.tile([0.08, 0, turn * (1 + drift)], (scans - 1, 1)))))
    walls = [((-3, -1.5), (3, -1.5)), ((3, -1.5), (3, 2.5)), ((3, 2.5), (-3, 2.5)), ((-3, 2.5), (-3, -1.5))]
    walls += [((1.5, -0.8), (2.2, -0.8)), ((1.5, -0.8), (1.5, -0.2))]
    return recorded(seen_from(true, walls), odometry), true


def bare_corridor(*, scans: int = 120) -> Recording:
    """A robot that drives 0.1 m a scan along a corridor 2 m wide, past a cupboard and then along bare walls."""
    true = np.column_stack((0.1 * np.arange(scans), np.zeros((scans, 2))))
    walls = [((-99, -1), (99, -1)), ((-99, 1), (99, 1))]
    walls += [((2, 1), (2, 0.5)), ((2, 0.5), (2.5, 0.5)), ((2.5, 0.5), (2.5, 1))]
    ranges = seen_from(true, walls)
    ranges += np.random.default_rng(0).normal(0, 0.001, ranges.shape)  # without noise all scans would be the same
    return recorded(np.where(ranges <= REACH, ranges, np.inf), true)


CORNERS = [(-4.0, -5.0), (1.5, -5.0), (1.5, -1.2), (3.0, -1.2), (3.0, 3.5), (0.5, 5.0), (-1.5, 3.2)]
OTHER_ROOM = [*pairwise(CORNERS), (CORNERS[-1], CORNERS[0])]


def carried_into_another_room(*, scans: int = 120, at: int = 60) -> Recording:
    """The robot of ``circled_room`` without drift, which from scan ``at`` on stands in another room."""
    recording, true = circled_room(scans=scans, drift=0.0)
    other = seen_from(true, OTHER_ROOM)
    ranges = np.where(np.arange(scans)[:, None] < at, recording.lidar.ranges, other)
    return recorded(ranges, true)


def tiled_table(**camera: float) -> dict[str, Any]:
    """Eight seconds in a curve through a room with a floor of tiles, with such a camera, as TOML gives it."""
    return {
        "duration": 8.0,
        "world": {
            "rooms": [{"corner": [0.0, 0.0], "size": [9.0, 7.0]}],
            "boxes": [{"centre": [6.0, 2.0], "size": [0.8, 0.6]}],
        },
        "commands": {"start": [2.0, 2.0, 0.3], "steps": [{"duration": 6.5, "speed": 0.6, "turn_rate": 0.3}]},
        "drive": {"rest_start": 0.5, "rest_end": 0.5},
        "floor": {"seed": 2},
        "camera": camera,
    }


def tiled_room(**camera: float) -> Simulation:
    return simulate(parse_scenario(tiled_table(**camera)), 1)


def seen_from(
    poses: np.ndarray, walls: list[tuple[tuple[float, float], tuple[float, float]]], angles: np.ndarray = ANGLES
) -> np.ndarray:
    """The ranges [n, beams] of walls, from point to point, seen from poses [n, 3]; infinite where there are none."""
    ranges = np.full((len(poses), len(angles)), np.inf)
    for a, b in np.array(walls, float):
        for scan, (x, y, theta) in enumerate(poses):
            direction = np.stack((np.cos(angles + theta), np.sin(angles + theta)))
            edge, offset = b - a, a - (x, y)
            cross = direction[0] * edge[1] - direction[1] * edge[0]
            with np.errstate(divide="ignore", invalid="ignore"):  # beams along a wall
                t = (offset[0] * edge[1] - offset[1] * edge[0]) / cross
                u = (offset[0] * direction[1] - offset[1] * direction[0]) / cross
            hit = (t > 0) & (u >= 0) & (u <= 1)
            ranges[scan] = np.where(hit, np.minimum(ranges[scan], t), ranges[scan])
    return ranges


def endpoints(pose: np.ndarray, walls: list) -> np.ndarray:
    """The endpoints [k, 2] that a robot at a pose sees."""
    ranges = seen_from(pose[None], walls)[0]
    return np.stack((ranges * np.cos(ANGLES), ranges * np.sin(ANGLES)), axis=1)[np.isfinite(ranges)].astype(np.float32)


def drawn(
    *rooms: list, low: tuple[float, float] = (-3.5, -2.0), high: tuple[float, float] = (3.5, 3.0), cell: float = 0.05
) -> Raster:
    """A map of the walls of rooms, free inside the box of each and unknown beyond."""
    columns, rows = np.round((np.array(high) - low) / cell).astype(int)
    values = np.full((rows, columns), UNKNOWN, np.int8)
    x, y = np.meshgrid(low[0] + (np.arange(columns) + 0.5) * cell, low[1] + (np.arange(rows) + 0.5) * cell)
    for ends in (np.array(walls, float).reshape(-1, 2) for walls in rooms):
        values[(x > ends[:, 0].min()) & (x < ends[:, 0].max()) & (y > ends[:, 1].min()) & (y < ends[:, 1].max())] = FREE
    for a, b in np.array([wall for walls in rooms for wall in walls], float):
        along = a + np.linspace(0, 1, 4000)[:, None] * (b - a)
        column, row = np.floor((along - low + 1e-6) / cell).astype(int).T
        values[row, column] = OCCUPIED
    return Raster(values, cell, (*low, 0.0))


def recorded(ranges: np.ndarray, odometry: np.ndarray) -> Recording:
    """The recording of ranges [n, beams] and of the odometry's poses [n, 3], ten scans a second."""
    stamps = np.arange(len(ranges)) * 0.1
    lidar = LidarStream(stamps, ranges.astype(np.float32), ANGLES[0], STEP, 0.1, 30.0, odometry=odometry)
    return Recording("room", CARMEN, lidar=lidar)


def between(recording: Recording, stamps: np.ndarray, begin: float, end: float) -> np.ndarray:
    """Which stamps lie so long after the first scan [s]."""
    since = stamps - recording.lidar.stamps[0]
    return (since >= begin) & (since < end)


def stopped_wheels(recording: Recording, begin: float, end: float) -> Recording:
    """The encoders count nothing from ``begin`` to ``end``, seconds after the first scan; the gyro goes on."""
    encoders = recording.encoders
    stopped = between(recording, encoders.stamps, begin, end)
    return recording.replace(encoders=replace(encoders, counts=np.where(stopped[:, None], 0, encoders.counts)))


def jumping_odometry(recording: Recording, at: float, jump: np.ndarray, *, back: float | None = None) -> Recording:
    """The odometry as logged poses that jump by [3], in the robot's frame, at a time; and back again at another."""
    path = dead_reckon(recording)
    increments = np.vstack((np.zeros(3), se2.between(path.poses[:-1], path.poses[1:])))
    since = path.stamps - path.stamps[0]
    for when, by in ((at, jump), (back, se2.inverse(jump))):
        if when is not None:
            first = int(np.searchsorted(since, when))
            increments[first] = se2.compose(increments[first], by)
    odometry = OdometryStream(path.stamps, se2.accumulate(increments))
    return recording.replace(encoders=None, imu=None, odometry=odometry)


def blind(recording: Recording, begin: float, end: float) -> Recording:
    """The lidar sees nothing from ``begin`` to ``end``, seconds after the first scan."""
    lidar = recording.lidar
    dark = between(recording, lidar.stamps, begin, end)
    return recording.replace(lidar=replace(lidar, ranges=np.where(dark[:, None], np.float32(np.inf), lidar.ranges)))


def without_odometry(recording: Recording) -> Recording:
    """Scans alone."""
    return recording.replace(encoders=None, imu=None, odometry=None)
