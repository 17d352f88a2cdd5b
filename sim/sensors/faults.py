"""What goes wrong on the way into a log: a lidar sees what travels along or the floor, gaps, stale or jumping odometry.

Faults of the log are apart from the sensors, since none of them changes what is measured, only what is written down.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from moteslam.robot import se2
from moteslam.robot.recording import LidarStream, OdometryStream, Recording
from moteslam.robot.se2 import Array
from moteslam.robot.values import Angle, Number, Positive, Section, Truth
from moteslam.sim.robot.driver import MAX_DURATION
from moteslam.sim.robot.mishaps import Interval, Spell
from moteslam.sim.sensors.clock import EPOCH

Length = Annotated[Number, Field(gt=0, le=20)]


class Cart(Interval):
    """Something that travels with the robot stands in the lidar's view: a box, or its four legs.

    It is at the same place in the robot's frame throughout, and goes through walls; what is nearer hides it.
    """

    kind: Literal["cart"] = "cart"
    distance: Length = 0.9  # from the lidar to the middle of its near side [m]
    # of that from the lidar, in the robot's frame [rad]; 0 is ahead
    bearing: Angle = 0.0
    width: Length = 0.6  # across that direction [m]
    depth: Length = 0.4  # along it [m]
    # of four square legs at its corners, all that the lidar sees of it [m]; 0 for a box that is solid
    leg: Annotated[Number, Field(ge=0, le=1)] = 0.0

    @model_validator(mode="after")
    def _stands_on_its_legs(self) -> Self:
        if self.leg > min(self.width, self.depth) / 2:
            raise ValueError(f"leg of {self.leg:g} m, expected at most half of width and depth")
        return self

    def ranges(self, origin: tuple[float, float], bearings: Array) -> Array:
        """The range [n], ``inf`` for a miss, from beside the lidar's mount [m] at bearings [n] in the robot's frame."""
        dx, dy = origin
        cos, sin = np.cos(self.bearing), np.sin(self.bearing)
        along, across = cos * dx + sin * dy, cos * dy - sin * dx
        near, far, half = self.distance, self.distance + self.depth, self.width / 2
        rows, columns = [(near, far)], [(-half, half)]  # of the solid boxes, from the lidar's mount towards the cart
        if self.leg:
            rows = [(near, near + self.leg), (far - self.leg, far)]
            columns = [(-half, -half + self.leg), (half - self.leg, half)]
        boxes = [(a - along, b - along, c - across, d - across) for a, b in rows for c, d in columns]
        return np.asarray(np.min([_box_ranges(box, bearings - self.bearing) for box in boxes], axis=0))


class Tilt(Interval):
    """The lidar is mounted aslant: beams that go down end on the floor, and walls are a little further."""

    kind: Literal["tilt"] = "tilt"
    pitch: Annotated[Number, Field(ge=-0.5, le=0.5)] = 0.05  # forward positive [rad]
    roll: Annotated[Number, Field(ge=-0.5, le=0.5)] = 0.0  # to the right positive [rad]
    # of the lidar above the floor [m]; that of the robot's lidar by default
    height: Annotated[Positive, Field(le=10)] | None = None
    # floor that is met at a smaller angle sends nothing back [rad]
    grazing: Annotated[Number, Field(ge=0, le=0.5)] = 0.02

    @model_validator(mode="after")
    def _is_aslant(self) -> Self:
        if not self.pitch and not self.roll:
            raise ValueError("pitch and roll of 0, expected one of them other than 0")
        return self


def leaning(leans: Array, z: float, tilts: Sequence[Tilt], times: Array) -> tuple[Array, Array | float, Array | float]:
    """Roll and pitch of beams, the height of their lidar, and from which angle on they measure the floor.

    Without tilts of its mount they lean [n, beams, 2] or [2] [rad] at a height z [m]; tilts add up, but of height and
    grazing the last one's count. ``times`` [n, beams] are since the drive's start [s].
    """
    if not tilts:
        return leans, z, np.inf
    leans = np.array(np.broadcast_to(leans, (*times.shape, 2)))
    height, grazing = np.full(times.shape, z), np.full(times.shape, np.inf)
    for tilt in tilts:
        covered = tilt.covers(times)
        leans[covered] += (tilt.roll, tilt.pitch)
        grazing[covered] = tilt.grazing
        if tilt.height is not None:
            height[covered] = tilt.height
    return leans, height.reshape(-1), grazing.reshape(-1)


def _box_ranges(box: tuple[float, float, float, float], bearings: Array) -> Array:
    """The range [n] from the origin to a box (least and largest x, least and largest y) along bearings [n]."""
    least_x, largest_x, least_y, largest_y = box
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = np.array(((least_x, largest_x), (least_y, largest_y)))[:, :, None] / np.stack(
            (np.cos(bearings), np.sin(bearings))
        ).reshape(2, 1, -1)
    enters, leaves = np.fmin(*sides.swapaxes(0, 1)).max(0), np.fmax(*sides.swapaxes(0, 1)).min(0)
    return np.where((leaves >= enters) & (enters > 0), enters, np.inf)


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
    def _goes_somewhere(self) -> Self:
        moves = bool(self.x or self.y or self.theta)
        if moves == self.reset:
            found = "both a step and a reset" if self.reset else "no step"
            raise ValueError(f"{found}, expected one or more of x, y and theta, or reset = true")
        return self


class Repeating:
    """The lidar's driver, which sends a scan again and again wherever a scenario's faults are `RepeatedScans`."""

    def __init__(self, faults: Iterable[object]) -> None:
        self._faults = [fault for fault in faults if isinstance(fault, RepeatedScans)]
        self._last: dict[int, NDArray[np.float32]] = {}  # what each has sent last

    def sent(self, lidar: LidarStream) -> LidarStream:
        """The next scans, those of every fault in place of their own."""
        for k, fault in enumerate(self._faults if len(lidar) else ()):
            frozen, ranges = np.flatnonzero(fault.covers(lidar.stamps - EPOCH)), np.array(lidar.ranges)
            if len(frozen):
                ranges[frozen] = ranges[frozen[0] - 1] if frozen[0] else self._last.get(k, ranges[0])
            self._last[k] = ranges[-1]
            lidar = replace(lidar, ranges=ranges)
        return lidar


def without_lost_motion(recording: Recording, faults: Iterable[object]) -> Recording:
    """The recording with no counts and no turns in every gap whose counts are lost: what a base integrates of it.

    ``faults`` are a scenario's, here and below: those of other kinds are passed over.
    """
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
                    recording = recording.replace(**{name: stream.take(~fault.covers(stream.stamps - EPOCH))})
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
    held = _last_before(recording.odometry, stale.start + EPOCH)
    return recording.with_poses(lambda stamps, poses: np.where(stale.covers(stamps - EPOCH)[:, None], held, poses))


def _jumping(recording: Recording, jump: OdometryJump) -> Recording:
    at = EPOCH + jump.start
    before = _last_before(recording.odometry, at)
    there = np.zeros(3) if jump.reset else se2.compose(before, (jump.x, jump.y, jump.theta))
    move = se2.compose(there, se2.inverse(before))
    recording = recording.with_poses(
        lambda stamps, poses: np.where((stamps >= at)[:, None], se2.compose(move, poses), poses)
    )
    encoders, wheels = recording.encoders, recording.platform.wheels
    assert encoders is not None
    assert wheels is not None
    aside = jump.theta * wheels.effective_track / 2
    right, left = ((jump.x + side) / wheels.metres_per_count for side in (aside, -aside))
    counts = np.array(encoders.counts)
    counts[np.flatnonzero(encoders.stamps >= at)[:1]] += np.rint((right, left, right, left)).astype(np.int64)
    return recording.replace(encoders=replace(encoders, counts=counts))


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
