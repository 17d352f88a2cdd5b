"""What goes wrong between a robot's sensors and the log: gaps, scans sent again, odometry that is stale or jumps.

Apart from the sensors, since none of these changes what is measured, only what is written down.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from moteslam.robot import se2
from moteslam.robot.platform import Wheels
from moteslam.robot.recording import EncoderStream, OdometryStream, Recording
from moteslam.robot.tables import Number, Section, Truth
from moteslam.sim.robot.limits import MAX_DURATION, Interval, Spell
from moteslam.sim.sensors.faults import readings_of

Array = NDArray[np.float64]


class RepeatedScans(Spell):
    """The lidar's driver sends the last scan again and again; the stamps go on.

    Attributes:
        start: [s]; duration: [s].
    """

    kind: Literal["repeated_scans"] = "repeated_scans"


class Gap(Spell):
    """Nothing at all is recorded: no scan, no reading of wheels and gyro, no image.

    Attributes:
        start: [s]; duration: [s].
        counters: ``kept``: what the wheels turn meanwhile comes with the first reading after the gap; ``lost``: it is
            not counted.
    """

    kind: Literal["gap"] = "gap"
    counters: Literal["kept", "lost"] = "kept"


class StaleOdometry(Spell):
    """The odometry keeps the value from before while all else goes on, then takes the right one at once.

    Of the wheel counters no count comes meanwhile, and all of them with the first reading after it.

    Attributes:
        start: [s]; duration: [s].
    """

    kind: Literal["stale_odometry"] = "stale_odometry"


class OdometryJump(Section):
    """The odometry goes on from another pose than it was at, as after a restart of its driver.

    Attributes:
        start: when [s].
        x, y, theta: by which it jumps, in the robot's frame [m, m, rad]. Wheel counters know no step sideways: of them
            x and theta come as counts of one reading.
        reset: it begins anew at the origin, which counters that reset when read do not show.
    """

    kind: Literal["odometry_jump"] = "odometry_jump"
    start: Annotated[Number, Field(gt=0, le=MAX_DURATION)]
    x: Annotated[Number, Field(ge=-1000, le=1000)] = 0.0
    y: Annotated[Number, Field(ge=-1000, le=1000)] = 0.0
    theta: Annotated[Number, Field(ge=-np.pi, le=np.pi)] = 0.0
    reset: Truth = False

    @model_validator(mode="after")
    def _goes_somewhere(self) -> OdometryJump:
        moves = bool(self.x or self.y or self.theta)
        if moves == self.reset:
            found = "both a step and a reset" if self.reset else "no step"
            raise ValueError(f"{found}, expected one or more of x, y and theta, or reset = true")
        return self


def with_scans_repeated(recording: Recording, faults: Iterable[object], epoch: float) -> Recording:
    """The recording with the scans of every `RepeatedScans` of ``faults`` in place of its own.

    Args:
        recording: to change.
        faults: of a scenario; those of other kinds are passed over.
        epoch: the stamp of the drive's first moment [s].
    """
    lidar = recording.lidar
    for fault in faults:
        if lidar is None or not isinstance(fault, RepeatedScans):
            continue
        frozen = np.flatnonzero(fault.covers(lidar.stamps - epoch))
        if len(frozen):
            ranges = np.array(lidar.ranges)
            ranges[frozen] = ranges[max(frozen[0] - 1, 0)]
            lidar = replace(lidar, ranges=ranges)
    return recording.replace(lidar=lidar)


def without_lost_motion(recording: Recording, faults: Iterable[object], epoch: float) -> Recording:
    """The recording with no counts and no turns in every gap whose counts are lost: what a base integrates of it."""
    encoders, imu = recording.encoders, recording.imu
    for fault in faults:
        if not isinstance(fault, Gap) or fault.counters == "kept":
            continue
        if encoders is not None:
            counts = np.where(fault.covers(encoders.stamps - epoch)[:, None], 0, encoders.counts)
            encoders = replace(encoders, counts=counts)
        if imu is not None:
            rates = np.where(fault.covers(imu.stamps - epoch)[:, None], 0.0, imu.angular_velocity)
            imu = replace(imu, angular_velocity=rates)
    return recording.replace(encoders=encoders, imu=imu)


def with_gaps(recording: Recording, faults: Iterable[object], epoch: float) -> Recording:
    """The recording without what lies in its gaps; the counts of a gap come with the first reading after it.

    Arguments as of `with_scans_repeated`; images are left as they are.
    """
    for fault in faults:
        if not isinstance(fault, Gap):
            continue
        changed: dict[str, Any] = {}
        if recording.encoders is not None:
            changed["encoders"] = _held_back(recording.encoders, fault, epoch)
        recording = recording.replace(**changed)
        for name in ("lidar", "encoders", "odometry", "imu"):
            if (stream := getattr(recording, name)) is not None:
                changed[name] = readings_of(stream, ~fault.covers(stream.stamps - epoch))
        recording = recording.replace(**changed)
    return recording


def with_odometry_faults(recording: Recording, faults: Sequence[object], epoch: float) -> Recording:
    """The recording with its odometry, the pose at every scan and the wheel counters stale or jumping.

    The gyro measures on as it did. Arguments as of `with_scans_repeated`.
    """
    for jump in faults:
        if isinstance(jump, OdometryJump):
            recording = _jumping(recording, jump, epoch)
    for stale in faults:
        if not isinstance(stale, StaleOdometry):
            continue
        encoders, odometry, lidar = recording.encoders, recording.odometry, recording.lidar
        if encoders is not None:
            encoders = _held_back(encoders, stale, epoch)
        if odometry is not None and len(odometry):
            held = _last_before(odometry, stale.start + epoch)
            if lidar is not None and lidar.odometry is not None:
                covered = stale.covers(lidar.stamps - epoch)[:, None]
                lidar = replace(lidar, odometry=np.where(covered, held, lidar.odometry))
            covered = stale.covers(odometry.stamps - epoch)[:, None]
            odometry = replace(odometry, poses=np.where(covered, held, odometry.poses))
        recording = recording.replace(encoders=encoders, odometry=odometry, lidar=lidar)
    return recording


def _jumping(recording: Recording, jump: OdometryJump, epoch: float) -> Recording:
    """The recording with its odometry elsewhere from the jump on."""
    at = epoch + jump.start
    encoders, odometry, lidar = recording.encoders, recording.odometry, recording.lidar
    if odometry is not None and len(odometry):
        before = _last_before(odometry, at)
        there = np.zeros(3) if jump.reset else se2.compose(before, (jump.x, jump.y, jump.theta))
        move = se2.compose(there, se2.inverse(before))

        def moved(stamps: Array, poses: Array) -> Array:
            return np.where((stamps >= at)[:, None], se2.compose(move, poses), poses)

        if lidar is not None and lidar.odometry is not None:
            lidar = replace(lidar, odometry=moved(lidar.stamps, lidar.odometry))
        odometry = replace(odometry, poses=moved(odometry.stamps, odometry.poses))
    wheels = recording.platform.wheels
    if encoders is not None and wheels is not None:
        counts = np.array(encoders.counts)
        counts[np.flatnonzero(encoders.stamps >= at)[:1]] += _counts_of(jump, wheels)
        encoders = replace(encoders, counts=counts)
    return recording.replace(encoders=encoders, odometry=odometry, lidar=lidar)


def _counts_of(jump: OdometryJump, wheels: Wheels) -> NDArray[np.int64]:
    """The counts [4] of the FR, FL, RR, RL wheel for a step forward and a turn."""
    aside = jump.theta * wheels.effective_track / 2
    right, left = ((jump.x + side) / wheels.metres_per_count for side in (aside, -aside))
    return np.rint((right, left, right, left)).astype(np.int64)


def _held_back(encoders: EncoderStream, interval: Interval, epoch: float) -> EncoderStream:
    """The readings with no counts in an interval; they all come with the first reading after it, if there is one."""
    held = np.flatnonzero(interval.covers(encoders.stamps - epoch))
    if not len(held):
        return encoders
    counts, after = np.array(encoders.counts), held[-1] + 1
    if after < len(counts):
        counts[after] += counts[held].sum(0)
    counts[held] = 0
    return replace(encoders, counts=counts)


def _last_before(odometry: OdometryStream, stamp: float) -> Array:
    """The last pose [3] before a stamp, the first of all where there is none."""
    return np.asarray(odometry.poses[max(int(np.searchsorted(odometry.stamps, stamp)) - 1, 0)])
