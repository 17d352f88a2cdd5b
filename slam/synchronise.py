"""From streams with their own clocks to steps: the motion between scans, settled here once and for all.

Distances are integrated from wheel counts, never from velocities: the real robot's encoder intervals run from 3 to
68 ms at a constant speed, so a count divided by its interval spikes to ten times the truth (docs/formats.md).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.kinematics import arc_increment, euler_increment, wheel_motion
from moteslam.robot.platform import Wheels
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, Recording
from moteslam.slam.config import SyncConfig

Array = NDArray[np.float64]
FASTEST, FASTEST_TURN = 4.0, 4.0
"""Robots drive slower [m/s] and turn slower [rad/s] than this, or always as fast."""
UNUSUAL = 10.0
"""Times the way or turn that nine steps in ten stay below."""
SHORTEST_JUMP, LEAST_JUMP = 0.2, 0.2
"""Shorter steps [m], [rad] are not worth calling a jump: the scan mends them."""


def has_odometry(recording: Recording) -> bool:
    """Whether anything in a recording tells how the robot moved: encoders, odometry, or poses logged with scans."""
    streams = (recording.encoders, recording.odometry)
    if any(stream is not None and len(stream) for stream in streams):
        return True
    return recording.lidar is not None and recording.lidar.odometry is not None


def tells_motion(recording: Recording) -> bool:
    """Whether a recording has odometry to go by; logged poses that are all the same are none, as in logs of zeros."""
    if not has_odometry(recording) or (recording.encoders is not None and len(recording.encoders)):
        return has_odometry(recording)
    lidar, odometry = recording.lidar, recording.odometry
    poses = lidar.odometry if lidar is not None else None
    if poses is None and odometry is not None:
        poses = odometry.poses
    return poses is None or len(poses) < 3 or bool((poses != poses[0]).any())


def odometry_path(recording: Recording, config: SyncConfig) -> tuple[Array, Array]:
    """The robot's path by its own odometry alone, at the stamps the odometry has.

    Wheel encoders with the gyro's yaw rate where there are encoders (wheels alone before the gyro starts, after it
    ends, or without one), else the odometry poses of the log.

    Returns:
        stamps [n] [s] and poses [n, 3]; the first encoder path starts at the identity.

    Raises:
        InputError: the recording has neither.
    """
    if recording.encoders is not None and len(recording.encoders):
        wheels = recording.platform.wheels
        if wheels is None:
            raise InputError("encoders without wheels, expected a platform with [wheels]", file=recording.name)
        return _drive(recording.encoders, recording.imu, wheels, config)
    if recording.odometry is not None and len(recording.odometry):
        return recording.odometry.stamps, recording.odometry.poses
    if recording.lidar is not None and recording.lidar.odometry is not None:
        return recording.lidar.stamps, recording.lidar.odometry
    raise InputError("neither encoders nor odometry, expected one of them", file=recording.name)


def odometry_at_scans(recording: Recording, config: SyncConfig) -> Array:
    """The odometry's pose at every scan, [n, 3]; the pose logged with a scan where the log has one."""
    lidar = require_lidar(recording)
    if lidar.odometry is not None:
        return lidar.odometry
    stamps, poses = odometry_path(recording, config)
    if lidar.stamps[-1] < stamps[0] - 1.0 or lidar.stamps[0] > stamps[-1] + 1.0:
        raise InputError(
            f"scans from {lidar.stamps[0]:.3f} to {lidar.stamps[-1]:.3f} s, odometry from {stamps[0]:.3f} to "
            f"{stamps[-1]:.3f} s, expected streams that overlap in time",
            file=recording.name,
            field="time_stamps",
        )
    if config.method == "interpolate":
        return se2.interpolate(stamps, poses, lidar.stamps)
    return poses[nearest(stamps, lidar.stamps)]


def jumps(stamps: Array, odometry: Array) -> NDArray[np.bool_]:
    """At which scans the odometry has jumped since the scan before: faster than robots move, and this one usually.

    Args:
        stamps: [n] of the scans [s]; scans that share one say nothing of a speed.
        odometry: [n, 3] there.

    Returns:
        [n]; the first is False.
    """
    dt = np.diff(stamps)
    motion = se2.between(odometry[:-1], odometry[1:])
    jump = np.zeros(len(dt), np.bool_)
    for size, fastest, least in (
        (np.hypot(motion[:, 0], motion[:, 1]), FASTEST, SHORTEST_JUMP),
        (np.abs(motion[:, 2]), FASTEST_TURN, LEAST_JUMP),
    ):
        usual = UNUSUAL * float(np.percentile(size, 90)) if len(size) else 0.0
        jump |= (dt > 0) & (size > np.maximum(fastest * dt, max(least, usual)))
    return np.concatenate(([False], jump))


def warnings(recording: Recording) -> list[str]:
    """What SLAM has to make do with in this recording, a line each: scans that no sensor of motion covers, or blind."""
    lines = []
    lidar, encoders, imu = recording.lidar, recording.encoders, recording.imu
    if lidar is not None and len(lidar):
        blind = int((~np.isfinite(lidar.ranges).any(axis=1)).sum())
        if blind:
            lines.append(f"{blind} of {len(lidar)} scans see nothing: the odometry is all that is known there")
        if len(lidar) > 2 and lidar.stamps[0] == lidar.stamps[-1] and lidar.odometry is None:
            lines.append(f"all {len(lidar)} scans have the same stamp: there is no motion between them")
    if encoders is not None and len(encoders):
        without = len(encoders)
        if imu is not None and len(imu) > 1:
            margin = 3.0  # the real robot's encoders run on for 1.5 s
            covered = (encoders.stamps > imu.stamps[0] - margin) & (encoders.stamps < imu.stamps[-1] + margin)
            without = int((~covered).sum())
        if without:
            lines.append(
                f"{without} of {len(encoders)} encoder readings without a gyro: there the wheels alone turn it"
            )
    if lidar is not None and encoders is not None and len(encoders) and lidar.odometry is None:
        for what, outside in (
            ("before the first", (lidar.stamps < encoders.stamps[0] - 0.1).sum()),
            ("after the last", (lidar.stamps > encoders.stamps[-1] + 0.1).sum()),
        ):
            if outside:
                lines.append(f"{outside} scans {what} encoder reading: the robot is taken to stand still")
    if lidar is not None and len(lidar) and not has_odometry(recording):
        lines.append(f"no odometry: constant velocity over {len(lidar)} scans; dead reckoning stands still")
    elif lidar is not None and len(lidar) and not tells_motion(recording):
        lines.append(f"odometry that never moves: constant velocity over {len(lidar)} scans")
    return lines


def nearest(stamps: Array, at: Array) -> NDArray[np.intp]:
    """The index of the stamp nearest to each time [m]; the earlier one of two equally near."""
    after = np.clip(np.searchsorted(stamps, at), 1, max(len(stamps) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(stamps) - 1)
    return np.where(at - stamps[before] <= stamps[after] - at, before, after)


def low_pass(values: Array, rate: float, cut_off: float) -> Array:
    """A causal first-order Butterworth low-pass, settled at the first value.

    Args:
        values: [n], evenly sampled.
        rate: of the samples [Hz].
        cut_off: [Hz]; at or above half the rate nothing is filtered.
    """
    if not 0 < cut_off < rate / 2 or not len(values):
        return values
    from scipy.signal import butter, sosfilt, sosfilt_zi

    sections = butter(1, cut_off, fs=rate, output="sos")
    filtered, _ = sosfilt(sections, values, zi=sosfilt_zi(sections) * values[0])
    return np.asarray(filtered, np.float64)


def require_lidar(recording: Recording) -> LidarStream:
    """The recording's lidar stream.

    Raises:
        InputError: it has none, or one without scans.
    """
    if recording.lidar is None or not len(recording.lidar):
        raise InputError("no lidar scans, expected at least one; --dead-reckoning needs none", file=recording.name)
    return recording.lidar


def _drive(encoders: EncoderStream, imu: ImuStream | None, wheels: Wheels, config: SyncConfig) -> tuple[Array, Array]:
    """The path at the encoder stamps from counts [n, 4] and yaw rates; the first count has no interval before it."""
    front_right, front_left, rear_right, rear_left = encoders.counts.T.astype(np.float64)
    left = (front_left + rear_left) / 2 * wheels.metres_per_count
    right = (front_right + rear_right) / 2 * wheels.metres_per_count
    distance, wheel_turn = wheel_motion(left, right, wheels.effective_track)
    turn = wheel_turn
    if imu is not None and len(imu) > 1:
        covered = (encoders.stamps >= imu.stamps[0]) & (encoders.stamps <= imu.stamps[-1])
        turn = np.where(covered, _gyro_turn(encoders.stamps, imu, config), wheel_turn)
    distance[0], turn[0] = 0.0, 0.0
    increment = euler_increment if config.kinematics == "euler" else arc_increment
    return encoders.stamps, se2.accumulate(increment(distance, turn))


def _gyro_turn(stamps: Array, imu: ImuStream, config: SyncConfig) -> Array:
    """The turn [rad] between consecutive stamps [n] by the gyro, [n]; the first is 0."""
    span = imu.stamps[-1] - imu.stamps[0]
    rate = (len(imu) - 1) / span if span > 0 else 0.0
    yaw_rate = low_pass(imu.angular_velocity[:, 2].astype(np.float64), rate, config.low_pass_hz)
    if config.method == "nearest":
        return np.asarray(yaw_rate[nearest(imu.stamps, stamps)] * np.diff(stamps, prepend=stamps[0]))
    steps_ = (yaw_rate[1:] + yaw_rate[:-1]) / 2 * np.diff(imu.stamps)
    heading = np.concatenate(([0.0], np.cumsum(steps_)))
    return np.diff(np.interp(stamps, imu.stamps, heading), prepend=0.0)
