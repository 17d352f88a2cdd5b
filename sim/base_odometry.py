"""What the robot's own base would report: dead reckoning from the recorded encoders, at the readings and at the scans.

Apart from the sensors, since no sensor is simulated: it follows from a recording alone, whatever noise that has.
"""

from __future__ import annotations

from dataclasses import replace

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.recording import OdometryStream, Recording
from moteslam.robot.values import expect_type
from moteslam.robot.wheel_odometry import gyro_turn, wheel_path


def odometry_of(recording: Recording, *, gyro: bool = False) -> OdometryStream:
    """Dead reckoning at the encoders' stamps, from the identity; exact arcs between two readings.

    Args:
        recording: with encoders on a robot with wheels.
        gyro: take the turns from the gyro while it measures, not from the wheels.

    Raises:
        InputError: no encoder readings, a platform without wheels, or a gyro that is asked for where there is none.
    """
    expect_type(recording, Recording, "recording", "open_recording(path) reads one")
    if gyro and (recording.imu is None or len(recording.imu) < 2):
        raise InputError("no gyro, expected at least two readings", file=recording.name, field="imu")
    poses = wheel_path(recording, turn_of=gyro_turn if gyro else None)
    assert recording.encoders is not None  # else there is no path
    return OdometryStream(recording.encoders.stamps, poses)


def with_odometry(recording: Recording, *, gyro: bool = False) -> Recording:
    """The recording with the odometry of `odometry_of`, and with its pose at every scan (``lidar.odometry``).

    Without the gyro the IMU is left out: who integrates the streams, as SLAM does after a UCSD folder is read, comes
    to the poses that are logged here.

    Args:
        recording: with encoders on a robot with wheels.
        gyro: take the turns from the gyro while it measures, not from the wheels.

    Raises:
        InputError: as of `odometry_of`.
    """
    odometry = odometry_of(recording, gyro=gyro)
    lidar = recording.lidar
    if lidar is not None:
        lidar = replace(lidar, odometry=se2.interpolate(odometry.stamps, odometry.poses, lidar.stamps))
    return recording.replace(odometry=odometry, lidar=lidar, imu=recording.imu if gyro else None)
