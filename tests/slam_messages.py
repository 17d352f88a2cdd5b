"""Recordings cut as they arrive."""

from dataclasses import fields, replace
from functools import cache
from typing import Any

import numpy as np
from slam_rooms import jumping_odometry

from moteslam.robot.platform import Platform
from moteslam.robot.recording import OdometryStream, Recording
from moteslam.sim.scenario import load_scenario
from moteslam.sim.simulate import Simulation, simulate
from moteslam.slam.inputs.synchronise import dead_reckon


def first(stream: Any, count: int) -> Any:
    arrays = {f.name: value for f in fields(stream) if isinstance(value := getattr(stream, f.name), np.ndarray)}
    return replace(stream, **{name: array[:count] for name, array in arrays.items()})


def cut(recording: Recording, scans: int) -> Recording:
    """What has arrived when the first ``scans`` scans are complete.

    Of wheels and logged odometry all readings up to the first at or after the end of the last scan's sweep; of the gyro
    all up to the first at or after that of the wheels.
    """
    lidar = recording.lidar
    now = lidar.stamps[scans - 1] + (lidar.ranges.shape[1] - 1) * lidar.time_increment
    left: dict[str, Any] = {"lidar": first(lidar, scans)}
    for name in ("odometry", "encoders", "imu"):
        stream = getattr(recording, name)
        if stream is not None:
            left[name] = first(stream, int(np.searchsorted(stream.stamps, now, side="left")) + 1)
            now = max(now, left[name].stamps[-1])
    return recording.replace(**left)


@cache
def corridor() -> Simulation:
    """Twenty seconds in the corridor."""
    return simulate(load_scenario("corridor").model_copy(update={"duration": 20.0}), seed=1)


@cache
def sparse_corridor() -> Recording:
    """The same with ten scans a second of 271 beams."""
    recording = corridor().recording
    lidar = recording.lidar
    sparse = replace(
        lidar,
        stamps=lidar.stamps[::4],
        ranges=lidar.ranges[::4, ::4],
        angle_increment=4 * lidar.angle_increment,
        time_increment=4 * lidar.time_increment,
    )
    return recording.replace(lidar=sparse)


def logged(recording: Recording) -> Recording:
    """The odometry as logged poses of wheels alone: while the robot stands at first they are all the same."""
    path = dead_reckon(recording.replace(imu=None, lidar=None))
    assert not path.poses[:50].any()
    return recording.replace(encoders=None, imu=None, odometry=OdometryStream(path.stamps, path.poses))


def jumping(recording: Recording) -> Recording:
    """The odometry jumps while the robot hardly moves, by less than ten times what it moves later; then twice more."""
    early = jumping_odometry(recording, 2.0, np.array([0.5, 0.0, 0.3]))
    return jumping_odometry(early, 9.0, np.array([1.0, 0.0, 0.0]), back=13.0)


def platform_of(recording: Recording) -> Platform:
    """The robot with the lidar that a recording has."""
    lidar = recording.lidar
    figures = {"angle_min": lidar.angle_min, "angle_increment": lidar.angle_increment, "beams": lidar.ranges.shape[1]}
    figures |= {"range_min": lidar.range_min, "range_max": lidar.range_max, "rate": 10.0}
    figures |= {"time_increment": lidar.time_increment or recording.platform.lidar.time_increment}
    mounted = recording.platform.lidar.model_copy(update=figures)
    return recording.platform.model_copy(update={"lidar": mounted})
