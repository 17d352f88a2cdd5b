"""Streams of what a file says: sorted by their stamps, ranges by their meaning, without what no robot does."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.formats.stamps import MAX_DROPPED, Stamps, stamp_order
from moteslam.robot.platform import LidarSpec, Platform, too_wide
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, OdometryStream
from moteslam.robot.tables import Table
from moteslam.robot.values import Issue, counted, given_up

Array = NDArray[Any]

MAX_RATE = 100.0
"""No robot turns faster [rad/s]: 16 turns a second; common gyros end at 35 rad/s, the largest range sold is 70."""
MAX_SPEED = 100.0
"""No wheeled robot drives faster [m/s]."""
MAX_PLACE = 1e7
"""No robot is farther from where it began [m], nor has turned more in all [rad]: a quarter of the globe."""
SLACK = 1.0
"""Travel [m] that a reading may give beyond that, for stamps jitter: a late one leaves the next no time."""
_SAME = 0.005

SICK_REACH, SICK_CODES = 80.0, 82.0
"""A SICK LMS reaches the first [m]; its codes for no return and errors, 81.83, 81.91 and the like, end below the
second."""


class Fan(NamedTuple):
    """Angles and limits of a lidar: of the first beam and between beams [rad], of the ranges [m]; of scans in bags also
    the number of beams and the time between them [s].
    """

    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    beams: int = 0
    time_increment: float = 0.0

    def over(self, given: Table) -> Fan:
        """The same with what a caller's ``platform.toml`` puts in place of angles and limits."""
        return self._replace(**{key: given[key] for key in self._fields[:4] if key in given})

    @property
    def angles(self) -> NDArray[np.float64]:
        """Of the beams [beams] [rad]."""
        return self.angle_min + self.angle_increment * np.arange(self.beams, dtype=np.float64)

    def flipped(self) -> Fan:
        """The fan seen from the other side: of a lidar that hangs upside down."""
        return self._replace(angle_min=-self.angle_min, angle_increment=-self.angle_increment)

    def reversed(self) -> Fan:
        """The fan with its last beam first."""
        last = self.angle_min + (self.beams - 1) * self.angle_increment
        step, time = -self.angle_increment, -self.time_increment
        return self._replace(angle_min=last, angle_increment=step, time_increment=time)


def sort_by_stamp(
    path: Path, field: str, stamps: Array, issues: list[Issue], *values: Array
) -> tuple[Stamps, tuple[Array, ...]]:
    """Stamps [n] that rise and the values [n, ...] that belong to them; raises as `stamp_order`."""
    stamps = stamps.astype(np.float64)
    order, found = stamp_order(stamps, file=path, field=field)
    issues.extend(found)
    if order is None:
        return stamps, values
    return stamps[order], tuple(value[order] for value in values)


def keep_plausible(
    path: Path, field: str, plausible: NDArray[np.bool_], what: str, issues: list[Issue], *values: Array
) -> tuple[Array, ...]:
    """The plausible readings [k, ...] of values [n, ...]; the others are dropped and counted."""
    dropped = int((~plausible).sum())
    if not dropped:
        return values
    if dropped == len(plausible) or dropped > max(MAX_DROPPED, len(plausible) // 10):
        problem = f"{dropped} of {len(plausible)} readings {what}, expected those of a robot"
        raise InputError(problem, file=path, field=field)
    issues.append(Issue("implausible-readings", f"{path.name}: {field}: {dropped} readings {what} dropped", dropped))
    return tuple(value[plausible] for value in values)


def plausible_rates(angular_velocity: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Which readings [n] of a gyro [n, 3] [rad/s] can be a robot's: none beyond 100 rad/s about any axis."""
    return np.asarray((np.abs(angular_velocity) <= MAX_RATE).all(axis=1))


def plausible_counts(stamps: Stamps, counts: Array, metres_per_count: float) -> NDArray[np.bool_]:
    """Which readings [n] of wheel counters [n, 4] can be a robot's: no wheel beyond 100 m/s (and 1 m for jitter)."""
    elapsed = np.diff(stamps, prepend=stamps[:1])
    travel = np.abs(counts.astype(np.float64)).max(axis=1) * metres_per_count
    return np.asarray(travel <= SLACK + MAX_SPEED * elapsed)


def check_fan(beams: int, increment: float, *, file: Path, field: str) -> None:
    """Refuse a fan of more than a full turn; first and last beam may be the same direction."""
    if (problem := too_wide(beams, increment)) is not None:
        raise InputError(problem, file=file, field=field)


def check_figures(beams: int, fan: Fan, *, file: Path) -> None:
    """Refuse figures of a lidar that a caller's ``platform.toml`` gives in part, and that do not fit together."""
    check_fan(beams, fan.angle_increment, file=file, field="platform.lidar.angle_increment")
    if fan.range_min >= fan.range_max:
        problem = f"{fan.range_min:g} m, expected less than the {fan.range_max:g} m that are its range_max"
        raise InputError(problem, file=file, field="platform.lidar.range_min")


def clean_ranges(ranges: NDArray[np.float32], fan: Fan, issues: list[Issue], head: str) -> NDArray[np.float32]:
    """Ranges [n, beams] [m] as endpoints, no return and invalid.

    At or beyond ``range_max``, and ``+inf``: no return, ``inf``. Below ``range_min`` (lidars put error codes there):
    invalid, ``nan``. Negative, ``-inf`` and NaN: invalid, and counted in an issue, for no sensor reports them.
    """
    clean = ranges.copy()
    garbage = ~(ranges >= 0)
    clean[ranges >= np.float32(fan.range_max)] = np.inf
    clean[garbage | (ranges < np.float32(fan.range_min))] = np.nan
    if count := int(garbage.sum()):
        found = f"{counted(count, 'range')} in {counted(int(garbage.any(axis=1).sum()), 'scan')}"
        issues.append(Issue("invalid-ranges", f"{head}: {found} left out, NaN or negative", count))
    return clean


def no_return_limit(ranges: NDArray[np.float32], stated: float | None) -> float:
    """The range from which on a reading is no endpoint [m]. No table of data sets, only what the log itself says.

    1. What the log states, unless that lies among the codes of a SICK (80 to 82 m), of which it has several: 80 m.
    2. Else 80 m, if any range is that long.
    3. Else the most frequent of the longest ranges, those within 0.15 % of the longest (a SICK's codes end at 8.183,
       8.187, 8.191 or ten times that), if it is a spike: at least 0.2 % of all beams and 10 of them stand at this
       value, to a tenth of a millimetre, 5 times as many as at any other in the upper half of the ranges, and ranges
       below it exist. (In the logs we know 0.5 to 12 % of the beams do, and no other long range reaches 0.02 %.)
    4. Else 80 m: every range is an endpoint.

    Args:
        ranges: of the whole log, any shape [m]; not finite ones are left aside.
        stated: the limit that the log states [m].
    """
    if stated is not None:
        return SICK_REACH if SICK_REACH < stated <= SICK_CODES else stated
    finite = ranges[np.isfinite(ranges) & (ranges >= 0)]
    bins = np.rint(finite.astype(np.float64) * 10_000).astype(np.int64)
    if not len(bins) or bins.max() >= SICK_REACH * 10_000:
        return SICK_REACH
    tally = np.bincount(bins)
    used = np.flatnonzero(tally)
    counts = tally[used]
    code = int(np.where(used > used[-1] * (1 - 0.0015), counts, 0).argmax())
    upper = used >= used[-1] / 2
    upper[code] = False
    is_spike = counts[code] >= max(0.002 * len(bins), 10, 5 * counts[upper].max(initial=0))
    return float(finite[bins == used[code]].min()) if is_spike and (used[:code] > 0).any() else SICK_REACH


def no_return_codes(codes: tuple[float, ...], range_max: float, otherwise: float, beams: int) -> NDArray[np.float32]:
    """What is written for no return, a value a beam [beams] [m]: those of the lidar's codes that read as no return."""
    usable = [code for code in codes if code >= range_max] or [otherwise]
    return np.resize(np.asarray(usable, np.float32), beams)


def lidar_stream(
    path: Path,
    field: str,
    *,
    stamps: Array,
    ranges: NDArray[np.float32],
    fan: Fan,
    robot: Platform,
    given: Table,
    issues: list[Issue],
    odometry: Array | None = None,
    zero_is_invalid: bool = True,
    interlace: int = 1,
) -> LidarStream:
    """The scans of a file: stamps [n] [s] and ranges [n, beams] [m] as reported, in the order of the file.

    ``fan`` is what the file or its format states, ``given`` what a caller's ``platform.toml`` puts in place of it;
    ``odometry`` are poses [n, 3] logged with the scans. The robot's time between beams is that between those of one
    scan, see `LidarStream` on ``interlace``.
    """
    beams = ranges.shape[1]
    check_fan(beams, fan.angle_increment, file=path, field=f"{field} angular resolution")
    fan = fan.over(given)
    check_figures(beams, fan, file=path)
    stamps, (order,) = sort_by_stamp(path, field, stamps, issues, np.arange(len(stamps)))
    sequence = None if odometry is None else _sequence(path, field, odometry, order, issues)
    clean = clean_ranges(ranges[order], fan, issues, f"{path.name}: {field}")
    if zero_is_invalid:
        clean[clean == 0] = np.nan
    poses = None if odometry is None else odometry[order]
    step = robot.lidar.time_increment / interlace
    return LidarStream(stamps, given_up(clean), *fan[:4], step, poses, sequence, interlace)


def _sequence(
    path: Path, field: str, odometry: Array, order: NDArray[np.int64], issues: list[Issue]
) -> NDArray[np.int64] | None:
    """The order [n] in which scans sorted by stamp were taken, where it is the file's and not that of their stamps.

    A clock that is set back or a message that waits gives a scan the stamp of another moment. In the right order
    the robot's path by the poses logged with the scans, ``odometry`` [n, 3] in the file's order, is the shorter one.
    """
    written, by_stamp = (
        float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum()) for poses in (odometry, odometry[order])
    )
    if written >= by_stamp:
        return None
    text = f"by the odometry logged with them ({written:.0f} m in the file's order, {by_stamp:.0f} m in that of their "
    text += "stamps) the scans were taken in the file's order: SLAM takes them so"
    issues.append(Issue("stamps-out-of-order", f"{path.name}: {field}: {text}"))
    return order


def odometry_stream(path: Path, field: str, stamps: Array, poses: Array, issues: list[Issue]) -> OdometryStream | None:
    """The poses [n, 3] of a base at stamps [n]; None where there are none."""
    if not len(stamps):
        return None
    stamps, (poses,) = sort_by_stamp(path, field, stamps, issues, poses)
    return OdometryStream(stamps, poses)


def encoder_stream(
    path: Path, fields: tuple[str, str], stamps: Array, counts: Array, robot: Platform, issues: list[Issue]
) -> EncoderStream:
    """Counts [n, 4] since the last reading; those of more than 100 m/s are dropped.

    ``fields`` are those of the stamps and of the counts.
    """
    stamps, (counts,) = sort_by_stamp(path, fields[0], stamps, issues, counts)
    if robot.wheels is not None:
        plausible = plausible_counts(stamps, counts, robot.wheels.metres_per_count)
        stamps, counts = keep_plausible(path, fields[1], plausible, "beyond 100 m/s", issues, stamps, counts)
    return EncoderStream(stamps, counts.astype(np.int64))


def imu_stream(
    path: Path, fields: tuple[str, str], stamps: Array, angular: Array, linear: Array, issues: list[Issue]
) -> ImuStream:
    """Turn rates [n, 3] [rad/s] and accelerations [n, 3] [g]; rates beyond 100 rad/s are dropped.

    ``fields`` are those of the stamps and of the rates.
    """
    stamps, values = sort_by_stamp(path, fields[0], stamps, issues, angular, linear)
    plausible = plausible_rates(values[0])
    stamps, angular, linear = keep_plausible(path, fields[1], plausible, "beyond 100 rad/s", issues, stamps, *values)
    return ImuStream(stamps, angular.astype(np.float64), linear.astype(np.float64))


def mount_between(robot: NDArray[np.float64], laser: NDArray[np.float64]) -> LidarSpec | None:
    """Where a lidar stands on its robot, by logged poses [n, 3] of both, where 99 % of them agree (5 mm, 0.005 rad)."""
    if not len(robot):
        return None
    mounts = se2.between(robot, laser)
    middle = np.median(mounts, axis=0)
    apart = np.abs(np.column_stack((mounts[:, :2] - middle[:2], se2.wrap(mounts[:, 2] - middle[2]))))
    if np.quantile(apart.max(axis=1), 0.99) >= _SAME:
        return None
    x, y, yaw = np.round(middle, 6).tolist()  # logs have six digits
    return LidarSpec(x=x, y=y, yaw=yaw)
