"""Noise added to the odometry of a recording, as a share of every step: how key-scan logs are made harder.

Apart from the noise of the encoders (`sim/sensors/encoders.py`), which is a model of a wheel over time: this is one
number a step, of whatever recording, dense or of key scans.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import ConfigError, InputError
from moteslam.robot import se2
from moteslam.robot.platform import Wheels
from moteslam.robot.recording import EncoderStream, OdometryStream, Recording
from moteslam.robot.values import expect_type
from moteslam.robot.wheel_odometry import gyro_covers, side_travel, wheel_motion

Array = NDArray[np.float64]


def with_odometry_noise(
    recording: Recording, *, distance: float, rotation: float, rng: np.random.Generator
) -> Recording:
    """Add independent Gaussian noise to every step between two odometry readings, in poses and counts alike.

    A step of length d and turn a becomes the arc of d (1 + distance e1) and a (1 + rotation e2), with e1 and e2 of
    N(0, 1). No turn comes with the distance: a straight step stays straight (slip that differs from side to side is
    ``noise.encoders.slip`` of a scenario). The wheels get the noise, not the gyro: a turn that the gyro measured stays
    as it is, and so does the IMU.

    A step is what lies between two readings. The same share averages out over more of them: over a path of n equal
    steps the error of its length is ``distance`` / sqrt(n) of it. At 40 readings a second 0.1 is mild, and at
    key scans it is what classic logs have; so thin a recording first where the share is to be one of key scans.

    Counts are whole numbers. What is rounded off a reading goes to the next, so that counts and poses differ by
    less than a count a wheel, however long the recording.

    Args:
        recording: with odometry, as `with_odometry` or `key_scans` gives it; its encoders, if it has some, are read
            at the same stamps.
        distance: standard deviation of a step's length, as a share of the length.
        rotation: of its turn, as a share of the turn.
        rng: two numbers are drawn a step, whatever the shares; with both of them 0 none, and nothing changes.

    Raises:
        ConfigError: a share that is negative or not finite.
        InputError: no odometry, encoders at other stamps, or encoders without wheels.
    """
    expect_type(recording, Recording, "recording", "open_recording(path) reads one")
    for field, value in (("distance", distance), ("rotation", rotation)):
        if not 0 <= value < np.inf:
            raise ConfigError(f"{value:g}, expected a share of 0 or more", field=field)
    odometry, encoders, lidar = recording.odometry, recording.encoders, recording.lidar
    if odometry is None or not len(odometry):
        raise InputError("no odometry, expected at least one pose", file=recording.name, field="odometry")
    if distance == rotation == 0:
        return recording
    if encoders is not None and not np.array_equal(encoders.stamps, odometry.stamps):
        raise InputError(
            "encoders and odometry at other stamps, expected the same", file=recording.name, field="stamps"
        )
    factors = 1 + rng.standard_normal((len(odometry) - 1, 2)) * (distance, rotation)
    if encoders is not None:
        if (wheels := recording.platform.wheels) is None:
            raise InputError("encoders without wheels, expected a platform with [wheels]", file=recording.name)
        encoders = EncoderStream(encoders.stamps, _with_whole_counts(encoders.counts, factors, wheels))
    by_gyro = gyro_covers(odometry.stamps, recording.imu)[1:]
    steps = se2.between(odometry.poses[:-1], odometry.poses[1:])
    noisy = _scaled(steps, factors[:, 0], np.where(by_gyro, 1.0, factors[:, 1]))
    poses = np.concatenate((odometry.poses[:1], se2.accumulate(noisy, odometry.poses[0])))
    if lidar is not None:
        lidar = replace(lidar, odometry=se2.interpolate(odometry.stamps, poses, lidar.stamps))
    return recording.replace(odometry=OdometryStream(odometry.stamps, poses), encoders=encoders, lidar=lidar)


def _scaled(steps: Array, length: Array, turn: Array) -> Array:
    """Steps [n, 3] whose length and turn are multiplied by [n] each: of an arc comes the longer, more bent arc."""
    turns = steps[:, 2] * turn
    bend = (turns - steps[:, 2]) / 2
    chord = length * np.sinc(turns / (2 * np.pi)) / np.sinc(steps[:, 2] / (2 * np.pi))
    cos, sin = chord * np.cos(bend), chord * np.sin(bend)
    return np.stack((cos * steps[:, 0] - sin * steps[:, 1], sin * steps[:, 0] + cos * steps[:, 1], turns), axis=1)


def _with_whole_counts(counts: NDArray[np.int64], factors: Array, wheels: Wheels) -> NDArray[np.int64]:
    """Counts [n, 4] with the noise of all steps [n - 1, 2], of distance and turn; the first reading is of no step."""
    distance, turn = wheel_motion(*side_travel(counts[1:], wheels), wheels.effective_track)
    longer, turned = distance * (factors[:, 0] - 1), turn * (factors[:, 1] - 1) * wheels.effective_track / 2
    right, left = longer + turned, longer - turned
    added = np.cumsum(np.stack((right, left, right, left), axis=1), axis=0) / wheels.metres_per_count
    whole = np.rint(added).astype(np.int64)
    return counts + np.diff(whole, axis=0, prepend=np.zeros((2, 4), np.int64))
