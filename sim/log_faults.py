"""What goes wrong between a robot's sensors and the log: gaps, scans sent again, odometry that is stale or jumps.

Apart from the sensors, since none of these changes what is measured, only what is written down.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from moteslam.robot import se2
from moteslam.robot.recording import OdometryStream, Recording
from moteslam.robot.values import Number, Section, Truth
from moteslam.sim.robot.driver import MAX_DURATION
from moteslam.sim.robot.mishaps import Interval, Spell
from moteslam.sim.sensors.clock import EPOCH, readings_of

Array = NDArray[np.float64]


class RepeatedScans(Spell):
    """The lidar's driver sends the last scan again and again; the stamps go on."""

    kind: Literal["repeated_scans"] = "repeated_scans"


class Gap(Spell):
    """Nothing at all is recorded: no scan, no reading of wheels and gyro, no image.

    The counts of the wheels meanwhile are ``kept``: they come with the first reading after the gap; or ``lost``.
    """

    kind: Literal["gap"] = "gap"
    counters: Literal["kept", "lost"] = "kept"


class StaleOdometry(Spell):
    """The odometry keeps the value from before while all else goes on, then takes the right one at once.

    Of the wheel counters no count comes meanwhile, and all of them with the first reading after it.
    """

    kind: Literal["stale_odometry"] = "stale_odometry"


class OdometryJump(Section):
    """The odometry goes on from another pose than it was at, as after a restart of its driver."""

    kind: Literal["odometry_jump"] = "odometry_jump"
    start: Annotated[Number, Field(gt=0, le=MAX_DURATION)]  # when [s]
    # by which it jumps, in the robot's frame [m, m, rad]. Wheel counters know no step sideways: of them x and theta
    # come as counts of one reading
    x: Annotated[Number, Field(ge=-1000, le=1000)] = 0.0
    y: Annotated[Number, Field(ge=-1000, le=1000)] = 0.0
    theta: Annotated[Number, Field(ge=-np.pi, le=np.pi)] = 0.0
    reset: Truth = False  # it begins anew at the origin, which counters that reset when read do not show

    @model_validator(mode="after")
    def _goes_somewhere(self) -> OdometryJump:
        moves = bool(self.x or self.y or self.theta)
        if moves == self.reset:
            found = "both a step and a reset" if self.reset else "no step"
            raise ValueError(f"{found}, expected one or more of x, y and theta, or reset = true")
        return self


def with_scans_repeated(recording: Recording, faults: Iterable[object]) -> Recording:
    """The recording with the scans of every `RepeatedScans` in place of its own.

    ``faults`` are a scenario's, here and below: those of other kinds are passed over.
    """
    lidar = recording.lidar
    assert lidar is not None
    for fault in faults:
        if isinstance(fault, RepeatedScans) and len(frozen := np.flatnonzero(fault.covers(lidar.stamps - EPOCH))):
            ranges = np.array(lidar.ranges)
            ranges[frozen] = ranges[max(frozen[0] - 1, 0)]
            lidar = replace(lidar, ranges=ranges)
    return recording.replace(lidar=lidar)


def without_lost_motion(recording: Recording, faults: Iterable[object]) -> Recording:
    """The recording with no counts and no turns in every gap whose counts are lost: what a base integrates of it."""
    encoders, imu = recording.encoders, recording.imu
    assert encoders is not None
    for fault in faults:
        if isinstance(fault, Gap) and fault.counters == "lost":
            counts = np.where(fault.covers(encoders.stamps - EPOCH)[:, None], 0, encoders.counts)
            encoders = replace(encoders, counts=counts)
            if imu is not None:
                rates = np.where(fault.covers(imu.stamps - EPOCH)[:, None], 0.0, imu.angular_velocity)
                imu = replace(imu, angular_velocity=rates)
    return recording.replace(encoders=encoders, imu=imu)


def with_gaps(recording: Recording, faults: Iterable[object]) -> Recording:
    """The recording without what lies in its gaps, but for images; counts come with the first reading after."""
    for fault in faults:
        if isinstance(fault, Gap):
            recording = _held_back(recording, fault)
            for name in ("lidar", "encoders", "odometry", "imu"):
                if (stream := getattr(recording, name)) is not None:
                    kept = readings_of(stream, ~fault.covers(stream.stamps - EPOCH))
                    recording = recording.replace(**{name: kept})
    return recording


def with_odometry_faults(recording: Recording, faults: Iterable[object]) -> Recording:
    """The recording with odometry, poses of scans and wheel counters stale or jumping; the gyro measures on."""
    faults = tuple(faults)
    for jump in faults:
        if isinstance(jump, OdometryJump):
            recording = _jumping(recording, jump)
    for stale in faults:
        if isinstance(stale, StaleOdometry):
            recording = _stale(_held_back(recording, stale), stale)
    return recording


def _stale(recording: Recording, stale: StaleOdometry) -> Recording:
    """The recording with the odometry's poses held."""
    held = _last_before(recording.odometry, stale.start + EPOCH)
    return _changed(recording, lambda stamps, poses: np.where(stale.covers(stamps - EPOCH)[:, None], held, poses))


def _jumping(recording: Recording, jump: OdometryJump) -> Recording:
    """The recording with its odometry elsewhere from the jump on."""
    at = EPOCH + jump.start
    before = _last_before(recording.odometry, at)
    there = np.zeros(3) if jump.reset else se2.compose(before, (jump.x, jump.y, jump.theta))
    move = se2.compose(there, se2.inverse(before))
    recording = _changed(
        recording, lambda stamps, poses: np.where((stamps >= at)[:, None], se2.compose(move, poses), poses)
    )
    encoders, wheels = recording.encoders, recording.platform.wheels
    assert encoders is not None
    assert wheels is not None
    aside = jump.theta * wheels.effective_track / 2
    right, left = ((jump.x + side) / wheels.metres_per_count for side in (aside, -aside))
    counts = np.array(encoders.counts)
    counts[np.flatnonzero(encoders.stamps >= at)[:1]] += np.rint((right, left, right, left)).astype(np.int64)
    return recording.replace(encoders=replace(encoders, counts=counts))


def _changed(recording: Recording, change: Callable[[Array, Array], Array]) -> Recording:
    """The recording with ``change(stamps, poses)`` for its odometry, if it has any, and the poses at its scans."""
    odometry, lidar = recording.odometry, recording.lidar
    if odometry is None:
        return recording
    if lidar is not None and lidar.odometry is not None:
        lidar = replace(lidar, odometry=change(lidar.stamps, lidar.odometry))
    return recording.replace(odometry=replace(odometry, poses=change(odometry.stamps, odometry.poses)), lidar=lidar)


def _held_back(recording: Recording, interval: Interval) -> Recording:
    """The recording with no counts in an interval; they all come with the first reading after it, if there is one."""
    encoders = recording.encoders
    assert encoders is not None
    held = np.flatnonzero(interval.covers(encoders.stamps - EPOCH))
    if not len(held):
        return recording
    counts, after = np.array(encoders.counts), held[-1] + 1
    if after < len(counts):
        counts[after] += counts[held].sum(0)
    counts[held] = 0
    return recording.replace(encoders=replace(encoders, counts=counts))


def _last_before(odometry: OdometryStream | None, stamp: float) -> Array:
    """The last pose [3] before a stamp, the first of all where there is none; the origin without odometry."""
    if odometry is None or not len(odometry):
        return np.zeros(3)
    return np.asarray(odometry.poses[max(int(np.searchsorted(odometry.stamps, stamp)) - 1, 0)])
