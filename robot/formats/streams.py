"""Streams of what a file says: sorted by their stamps, ranges by their meaning, without what no robot does."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.formats.bounds import check_fan, check_figures, plausible_counts, plausible_rates
from moteslam.robot.formats.ranges import clean_ranges
from moteslam.robot.formats.stamps import stamp_order
from moteslam.robot.platform import LidarSpec, Platform
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, OdometryStream
from moteslam.robot.tables import Table
from moteslam.robot.values import Issue, given_up

Array = NDArray[Any]

MAX_DROPPED = 3
"""Up to this many implausible readings are always dropped; more of them only up to a tenth of the stream."""

_SAME = 0.005


class Fan(NamedTuple):
    """Angles and limits of a lidar: of the first beam and between beams [rad], and of the ranges [m]."""

    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float

    def over(self, given: Table) -> Fan:
        """The same with what a caller's ``platform.toml`` puts in place of it."""
        return self._replace(**{key: given[key] for key in self._fields if key in given})


def sort_by_stamp(
    path: Path, field: str, stamps: Array, issues: list[Issue], *values: Array
) -> tuple[NDArray[np.float64], tuple[Array, ...]]:
    """Stamps [n] that rise and the values [n, ...] that belong to them; what was done goes to ``issues``.

    Raises:
        InputError: stamps that are none (``stamp_order``).
    """
    stamps = stamps.astype(np.float64)
    order, found = stamp_order(stamps, file=path, field=field)
    issues.extend(found)
    if order is None:
        return stamps, values
    return stamps[order], tuple(value[order] for value in values)


def keep_plausible(
    path: Path, field: str, plausible: NDArray[np.bool_], what: str, issues: list[Issue], *values: Array
) -> tuple[Array, ...]:
    """The plausible readings [k, ...] of values [n, ...]; the others are dropped and counted.

    Raises:
        InputError: none is, or more than 3 and a tenth of them are not: the stream is in other units.
    """
    dropped = int((~plausible).sum())
    if not dropped:
        return values
    if dropped == len(plausible) or dropped > max(MAX_DROPPED, len(plausible) // 10):
        raise InputError(
            f"{dropped} of {len(plausible)} readings {what}, expected those of a robot", file=path, field=field
        )
    text = f"{path.name}: {field}: {dropped} readings {what} dropped"
    issues.append(Issue("implausible-readings", text, dropped))
    return tuple(value[plausible] for value in values)


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
    """The scans of a file.

    Args:
        path, field: where they come from, for messages.
        stamps: [n] [s], in the order of the file.
        ranges: [n, beams] [m], as reported.
        fan: angles and limits that the file or its format states.
        robot: for the time between beams.
        given: figures that a caller's ``platform.toml`` puts in place of those.
        issues: what was done is added.
        odometry: poses [n, 3] logged with the scans.
        zero_is_invalid: a range of 0 is an error code, whatever the least range.
        interlace: of the scans, see `LidarStream`; the robot's time between beams is that between those of one scan.

    Raises:
        InputError: a fan of more than a turn, limits the wrong way round, or stamps that are none.
    """
    beams = ranges.shape[1]
    check_fan(beams, fan.angle_increment, file=path, field=f"{field} angular resolution")
    angle_min, increment, range_min, range_max = fan.over(given)
    check_figures(beams, increment, range_min, range_max, file=path)
    stamps, (order,) = sort_by_stamp(path, field, stamps, issues, np.arange(len(stamps)))
    poses = None if odometry is None else odometry[order]
    sequence = None if odometry is None else _sequence(path, field, odometry, order, issues)
    clean, found = clean_ranges(ranges[order], range_min, range_max, file=path, field=field)
    if zero_is_invalid:
        clean[clean == 0] = np.nan
    issues.extend(found)
    return LidarStream(
        stamps=stamps,
        ranges=given_up(clean),
        angle_min=angle_min,
        angle_increment=increment,
        range_min=range_min,
        range_max=range_max,
        time_increment=robot.lidar.time_increment / interlace,
        odometry=poses,
        sequence=sequence,
        interlace=interlace,
    )


def _sequence(
    path: Path, field: str, odometry: Array, order: NDArray[np.int64], issues: list[Issue]
) -> NDArray[np.int64] | None:
    """The order [n] in which scans sorted by stamp were taken, where it is the file's and not that of their stamps.

    A clock that is set back or a message that waits gives a scan the stamp of another moment. In the right order
    the robot's path by the poses logged with the scans is the shorter one.

    Args:
        path, field: where they come from, for messages.
        odometry: [n, 3] poses logged with the scans, in the order of the file.
        order: [n] of the scans by their stamps.
        issues: what was found is added.
    """

    def metres(poses: Array) -> float:
        return float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())

    written, sorted_ = metres(odometry), metres(odometry[order])
    if written >= sorted_:
        return None
    text = (
        f"{path.name}: {field}: by the odometry logged with them ({written:.0f} m in the file's order, {sorted_:.0f} m "
        "in that of their stamps) the scans were taken in the file's order: SLAM takes them so"
    )
    issues.append(Issue("stamps-out-of-order", text))
    return order


def odometry_stream(path: Path, field: str, stamps: Array, poses: Array, issues: list[Issue]) -> OdometryStream | None:
    """The poses [n, 3] of a base at stamps [n]; None where there are none.

    Raises:
        InputError: stamps that are none.
    """
    if not len(stamps):
        return None
    stamps, (poses,) = sort_by_stamp(path, field, stamps, issues, poses)
    return OdometryStream(stamps, poses)


def encoder_stream(
    path: Path,
    field: str,
    stamps: Array,
    counts: Array,
    robot: Platform,
    issues: list[Issue],
    *,
    stamps_field: str | None = None,
) -> EncoderStream:
    """Counts [n, 4] since the last reading; those of more than 100 m/s are dropped.

    Args:
        path, field: where they come from, for messages; ``stamps_field`` where the stamps have a name of their own.
        stamps: [n] [s], in the order of the file.
        counts: whole numbers.
        robot: for the travel of a count.
        issues: what was done is added.

    Raises:
        InputError: stamps that are none, or many such counts.
    """
    stamps, (counts,) = sort_by_stamp(path, stamps_field or field, stamps, issues, counts)
    if robot.wheels is not None:
        plausible = plausible_counts(stamps, counts, robot.wheels.metres_per_count)
        stamps, counts = keep_plausible(path, field, plausible, "beyond 100 m/s", issues, stamps, counts)
    return EncoderStream(stamps, counts.astype(np.int64))


def imu_stream(
    path: Path,
    field: str,
    stamps: Array,
    angular: Array,
    linear: Array,
    issues: list[Issue],
    *,
    stamps_field: str | None = None,
) -> ImuStream:
    """Turn rates [n, 3] [rad/s] and accelerations [n, 3] [g]; rates beyond 100 rad/s are dropped.

    Arguments as of ``encoder_stream``.

    Raises:
        InputError: stamps that are none, or many such rates.
    """
    stamps, (angular, linear) = sort_by_stamp(path, stamps_field or field, stamps, issues, angular, linear)
    kept = keep_plausible(path, field, plausible_rates(angular), "beyond 100 rad/s", issues, stamps, angular, linear)
    stamps, angular, linear = kept
    return ImuStream(stamps, angular.astype(np.float64), linear.astype(np.float64))


def counts_of(running: NDArray[np.int64]) -> NDArray[np.int64]:
    """What running counters [n, k] change by from a reading to the next [n, k]; 0 at the first."""
    return np.diff(running, axis=0, prepend=running[:1])


def axle_counts(left: NDArray[np.int64], right: NDArray[np.int64]) -> NDArray[np.int64]:
    """The counts [n, 4] of two wheels on one axle [n]: front right, front left, rear right, rear left, each twice."""
    return np.stack((right, left, right, left), axis=-1)


def mount_between(robot: NDArray[np.float64], laser: NDArray[np.float64]) -> LidarSpec | None:
    """Where a lidar stands on its robot, by logged poses of both.

    Args:
        robot, laser: [n, 3] of the same times.

    Returns:
        the mount, if it is the same (5 mm, 0.005 rad) in 99 % of the pairs; else, and of no poses, None.
    """
    if not len(robot):
        return None
    mounts = se2.between(robot, laser)
    middle = np.median(mounts, axis=0)
    apart = np.abs(np.column_stack((mounts[:, :2] - middle[:2], se2.wrap(mounts[:, 2] - middle[2]))))
    if np.quantile(apart.max(axis=1), 0.99) >= _SAME:
        return None
    x, y, yaw = np.round(middle, 6).tolist()  # logs have six digits
    return LidarSpec(x=x, y=y, yaw=yaw)
