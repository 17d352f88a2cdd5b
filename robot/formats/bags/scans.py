"""Scans of lidars: figures on opening, ranges on demand, one fan for all scans; and images on demand.

``sensor_msgs/LaserScan`` and ``MultiEchoLaserScan`` mean what REP 117 says: positive infinity is no return, negative
infinity too near, NaN an error; and what is beyond the limits that a message states counts as no return, or invalid.

Of several lidars a scan of the first is joined with the scan of each other one that is nearest in time, moved by what
the odometry drives in between. Every endpoint falls into the beam of its direction from the robot's centre, and the
nearest one in a beam counts. A beam without one has no return if a beam of a lidar without return ends in it, put at
that lidar's limit; a beam in which nothing falls says nothing.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.formats.bags.bag import Bag, Rows, Table
from moteslam.robot.formats.streams import FEWEST, Fan, Stamps, clean_ranges, given_again, sampled
from moteslam.robot.platform import MAX_BEAMS, LidarSpec, too_wide
from moteslam.robot.recording import Images, RgbdStream, nearest_stamp, no_return_limit
from moteslam.robot.rgbd import decode_disparity, decode_rgb, disparity_of
from moteslam.robot.values import counted

LASER_SCAN, MULTI_ECHO = "sensor_msgs/LaserScan", "sensor_msgs/MultiEchoLaserScan"

MAX_STEP = 0.01  # between two beams [s]: no lidar is slower
SLOWEST = 1.05  # times the time to the next one, a scan takes at most: motors turn a little faster than nominal
FINER = 4
"""Of scans with beams of their own each, the common fan has this many beams for one of theirs: an endpoint lies up to
an eighth of their step beside its beam."""
BUNDLE = 20  # scans, as many as can arrive together
HELD, MOVED = 0.002, 0.05
"""A lidar says the same where its ranges change by less [m], which is less than its noise; one by more has moved."""
GAP = 1.5  # times the time between two scans: one further away is not joined, that lidar was silent
TOGETHER = 0.01  # Scans that are this near count as taken at once [s]

Pixel = TypeVar("Pixel", np.uint8, np.uint16)
Ranges = NDArray[np.float32]
Figures = NDArray[np.float64]
"""Of scans [n, 7]: first and last angle, steps of angle and time, limits, number of beams."""
_FIGURES = attrgetter("angle_min", "angle_max", "angle_increment", "time_increment", "range_min", "range_max")


def figures_of(message: Any) -> tuple[float, ...]:
    """The figures of a scan, see `Figures`."""
    return (*_FIGURES(message), len(message.ranges))


@dataclass(frozen=True, eq=False)
class Scans:
    """The scans of a topic, their stamps [n] rising [s]; ``load(indices)`` reads the ranges [k, beams] [m] of some."""

    topic: str
    stamps: Stamps
    fan: Fan
    load: Callable[[Rows], Ranges]

    @property
    def period(self) -> float:
        """The usual time between two scans [s], over several, as they can arrive in pairs or bundles; 0 of one."""
        step = min(BUNDLE, (len(self.stamps) - 1) // 2 * 2 or len(self.stamps) - 1)
        return float(np.median(self.stamps[step:] - self.stamps[:-step])) / step if step > 0 else 0.0

    def cleaned(self, indices: Rows, fan: Fan) -> Ranges:
        """The ranges [k, beams] of some scans: endpoints within a fan's limits, ``inf`` and ``nan``."""
        return clean_ranges(self.load(indices), fan, [], "")


def laser_scans(bag: Bag, table: Table) -> Scans:
    """The scans of a topic, each with its angles, on the fan that most of them have or on a finer one."""
    topic, values = table.topic.name, table.values
    kept, stamps = bag.used(table, np.isfinite(values[:, :3]).all(axis=1) & (values[:, 6] <= MAX_BEAMS))
    new = ~given_again(bag.path, topic, stamps, table.heads["mark"][kept], bag.issues)
    kept, stamps = kept[new], stamps[new]
    figures = values[kept]

    def keep_and_tell(code: str, good: NDArray[np.bool_], what: str) -> None:
        nonlocal kept, stamps, figures
        if left := int((~good).sum()):
            bag.tell(code, topic, f"{counted(left, 'scan')} {what} left aside", left)
            kept, stamps, figures = kept[good], stamps[good], figures[good]

    keep_and_tell("empty-scans", figures[:, 6] > 0, "without ranges")
    if not len(kept):
        raise InputError("scans without ranges, expected some", file=bag.path, field=topic)
    alike, fan = _common_fan(bag, topic, figures)
    steps = _steps(figures)
    turn = np.abs(steps) * (figures[:, 6] - 1) <= 2 * np.pi + np.abs(steps) / 2
    can_be = alike | ((np.abs(figures[:, 0]) <= 4 * np.pi) & turn & (steps != 0))
    keep_and_tell("other-scans", can_be, "of angles of no lidar")
    steps = steps[can_be]
    others = int((~alike[can_be]).sum())
    if others:
        fan = fan if 2 * others < len(steps) else _finer_fan(figures, steps, fan)
        what = f"{counted(others, 'scan')} of other beams than most: laid by their angles on {fan.beams} beams"
        bag.tell("other-scans", topic, what, others)

    def load(indices: Rows) -> Ranges:
        rows = np.full((len(indices), fan.beams), np.nan, np.float32)
        for row, index, message in zip(rows, indices.tolist(), bag.messages(table, kept[indices]), strict=True):
            ranges = message.ranges
            if table.topic.kind == MULTI_ECHO:  # the first echo of each beam; one without has no return
                ranges = np.array([beam.echoes[0] if len(beam.echoes) else np.inf for beam in ranges], np.float32)
            if others:
                _lay(row, ranges, figures[index, 0] + steps[index] * np.arange(len(ranges)), fan)
            else:
                row[:] = ranges
        return rows[:, ::-1] if fan.time_increment < 0 else rows

    scans = Scans(topic, stamps, fan, load)
    sweep = float(np.median(np.abs(figures[:, 3]) * (figures[:, 6] - 1)))  # of their own beams
    if sweep > SLOWEST * (scans.period or np.inf) or abs(fan.time_increment) > MAX_STEP:
        what = f"time_increment of {fan.time_increment:g} s, {sweep:.3g} s a scan, is more than scans take; not used"
        bag.tell("time-increment", topic, what)
        fan = fan._replace(time_increment=0.0)
    sample = load(sampled(len(stamps)))
    if not fan.range_min < fan.range_max < np.inf:  # the limit is that of a sample of the ranges, as for a log
        limit = no_return_limit(sample, None)
        bag.tell("range-max", topic, f"range_max of {fan.range_max:g} m; {limit:g} m is taken, by the ranges")
        fan = fan._replace(range_min=0.0 if fan.range_min >= limit else fan.range_min, range_max=limit)
    fan = fan.within(sample, bag.issues, f"{bag.path.name}: {topic}")
    return replace(scans, fan=fan.reversed() if fan.time_increment < 0 else fan)


def _lay(row: Ranges, ranges: NDArray[np.floating], angles: NDArray[np.float64], fan: Fan) -> None:
    """Put the ranges of beams at some angles into the nearest beams of a fan; of two in one the nearer counts."""
    turn = 2 * np.pi / abs(fan.angle_increment)
    steps = (angles - fan.angle_min) / fan.angle_increment
    beams = np.rint(np.mod(steps + 0.5, turn) - 0.5)
    inside = (beams >= 0) & (beams < fan.beams)
    np.fmin.at(row, beams[inside].astype(np.intp), ranges[inside].astype(np.float32))


def _steps(figures: Figures) -> NDArray[np.float64]:
    """Between the beams of scans [n] [rad]: as stated, else by the first and the last angle."""
    even = (figures[:, 1] - figures[:, 0]) / np.maximum(1, figures[:, 6] - 1)
    return np.where(figures[:, 2] == 0, even, figures[:, 2])


def _common_fan(bag: Bag, topic: str, figures: Figures) -> tuple[NDArray[np.bool_], Fan]:
    """Which scans have the fan of most of them, to half a step at both ends, and that."""
    most = int(_most_frequent(figures[:, 6]))
    same = figures[:, 6] == most
    angle_min, angle_max, increment = (_most_frequent(column[same]) for column in figures[:, :3].T)
    if increment == 0 and most > 1:
        increment = (angle_max - angle_min) / (most - 1)
    if increment == 0:
        raise InputError("angle_increment of 0, expected an angle between beams", file=bag.path, field=topic)
    if (problem := too_wide(most, increment)) is not None:
        raise InputError(problem, file=bag.path, field=f"{topic}: angle_increment")
    if abs(angle_min) > 4 * np.pi:
        raise InputError(f"angle_min of {angle_min:.6g}, expected radians", file=bag.path, field=topic)
    last, half = angle_min + (most - 1) * increment, abs(increment) / 2
    if abs(last - angle_max) > 2 * half:
        what = f"angle_max of {angle_max:.4f} rad, but {most} beams end at {last:.4f}; the beams are used"
        bag.tell("angle-max", topic, what)
    ends = figures[:, 0] + (figures[:, 6] - 1) * figures[:, 2]
    alike = same & (np.abs(figures[:, 0] - angle_min) <= half)
    alike &= (np.abs(ends - last) <= half) | (figures[:, 2] == 0)
    time_increment, range_min, range_max = (_most_frequent(column[alike]) for column in figures[:, 3:6].T)
    return alike, Fan(angle_min, increment, max(0.0, range_min), range_max, most, time_increment)


def _finer_fan(figures: Figures, steps: NDArray[np.float64], common: Fan) -> Fan:
    """A fan over all the directions of scans that have beams of their own each, ``steps`` [n] [rad] apart."""
    ends = figures[:, 0] + (figures[:, 6] - 1) * steps
    step = float(np.median(np.abs(steps))) / FINER
    low, high = float(np.minimum(figures[:, 0], ends).min()), float(np.maximum(figures[:, 0], ends).max())
    beams = round((high - low) / step) + 1
    if high - low > 2 * np.pi - 2 * FINER * step:
        beams = round(2 * np.pi / step)
        step = 2 * np.pi / beams
    sweep = np.median(figures[:, 3] / np.where(steps == 0, np.inf, np.abs(steps)))  # [s/rad]
    up = common.angle_increment > 0
    return common._replace(
        beams=min(beams, MAX_BEAMS),
        angle_min=low if up else high,
        angle_increment=step if up else -step,
        time_increment=float(np.nan_to_num(sweep, posinf=0, neginf=0)) * step,
    )


def _most_frequent(values: NDArray[np.float64]) -> float:
    """The value that most messages have; 0 where that is not a number."""
    numbers, counts = np.unique(values, return_counts=True)
    return float(np.nan_to_num(numbers[np.argmax(counts)], posinf=np.inf, neginf=-np.inf))


def _frozen(bag: Bag, one: Scans, lidars: list[tuple[Scans, LidarSpec]]) -> NDArray[np.bool_]:
    """Which scans [n] of a lidar say the same again and again while another one sees that the robot moves; told."""
    at, found = sampled(len(one.stamps)), np.zeros(len(one.stamps), np.bool_)
    some, moves = one.cleaned(at, one.fan), np.zeros(len(at) - 1, np.bool_)
    for other, _ in lidars:
        seen = other.cleaned(nearest_stamp(other.stamps, one.stamps[at]), other.fan)
        moves |= _change(seen[:-1], seen[1:], 50) > MOVED
    still = _change(some[:-1], some[1:], 95) < HELD
    edges = np.flatnonzero(np.diff(still, prepend=False, append=False))
    for first, last in edges.reshape(-1, 2).tolist():
        if moves[first:last].sum() >= FEWEST:
            found[at[first] : at[last] + 1] = True
            for begin, end in ((at[max(first - 1, 0)], at[first]), (at[last], at[min(last + 1, len(at) - 1)])):
                beside = np.arange(begin, end + 1)
                found[beside] = _change(one.cleaned(beside, one.fan), some[first], 95) < HELD
    if count := int(found.sum()):
        text = f"{counted(count, 'scan')} from {one.stamps[found.argmax()]:.2f} s on are alike to {1000 * HELD:g} mm"
        bag.tell("scans-repeat", one.topic, f"{text}, while another lidar sees the robot move: left out", count)
    return found


def _change(one: Ranges, other: Ranges, percent: float) -> NDArray[np.float64]:
    """By how much, at most, as many of the beams [n, beams] change [n] [m]; that without return does so by 1 m."""
    with np.errstate(invalid="ignore"):
        apart = np.where(np.isfinite(one) | np.isfinite(other), np.nan_to_num(np.abs(one - other), nan=1.0), np.nan)
    known = np.isfinite(one).any(axis=1, keepdims=True)
    return np.asarray(np.nanpercentile(np.where(known, apart, 1.0), percent, axis=1))


def merged_scans(
    bag: Bag, lidars: list[tuple[Scans, LidarSpec]], driven: Callable[[Stamps, Stamps], Figures] | None
) -> Scans:
    """The scans of two or more lidars as one fan about the robot's centre; the first sets the stamps, and beams.

    ``driven`` gives the robot's motions [n, 3] between stamps [n] by odometry, if there is any.
    """
    path, (first, at_first), names = bag.path, lidars[0], ", ".join(scans.topic for scans, _ in lidars)
    if len({(mount.pose, mount.z) for _, mount in lidars}) < len(lidars):
        table = f'[lidars."{first.topic}"] with x, y, yaw for each in the platform\'s file'
        problem = f"two lidars at one place, expected a transform to each, or a table {table}"
        raise InputError(problem, file=path, field=names)
    beams = min(MAX_BEAMS, round(2 * np.pi / min(abs(scans.fan.angle_increment) for scans, _ in lidars)))
    reach = max(scans.fan.range_max + float(np.hypot(mount.x, mount.y)) for scans, mount in lidars)
    step = 2 * np.pi / beams
    whole = Fan(float((at_first.yaw + first.fan.angle_min + np.pi) % step) - np.pi, step, 0.0, reach, beams)
    frozen = [_frozen(bag, scans, lidars) for scans, _ in lidars]
    for scans, _ in lidars[1:] if driven is None else ():
        late = np.abs(scans.stamps[nearest_stamp(scans.stamps, first.stamps)] - first.stamps)
        if (apart := float(np.median(late))) > TOGETHER:
            what = f"{apart:.2f} s apart from {first.topic}, and no odometry says what the robot drives meanwhile"
            bag.tell("no-odometry", scans.topic, f"scans {what}: turns are smeared")

    def load(indices: Rows) -> Ranges:
        rows, stamps = np.full((len(indices), beams), np.nan, np.float32), first.stamps[indices]
        for (scans, mount), stuck in zip(lidars, frozen, strict=True):
            near = nearest_stamp(scans.stamps, stamps)
            used = np.flatnonzero((np.abs(scans.stamps[near] - stamps) <= GAP * scans.period) & ~stuck[near])
            moved = np.zeros((len(rows), 3)) if driven is None else driven(stamps, scans.stamps[near])
            angles, ranges = mount.yaw + scans.fan.angles, scans.cleaned(near[used], scans.fan).astype(np.float64)
            placed = np.where(np.isinf(ranges), scans.fan.range_max, ranges)
            x, y = mount.x + placed * np.cos(angles), mount.y + placed * np.sin(angles)
            dx, dy, turn = moved[used].T[..., None]
            x, y = dx + np.cos(turn) * x - np.sin(turn) * y, dy + np.sin(turn) * x + np.cos(turn) * y
            far, towards = np.where(np.isinf(ranges), np.inf, np.hypot(x, y)), np.arctan2(y, x)
            for row, ends, bearings in zip(used, far, towards, strict=True):
                _lay(rows[row], ends, bearings, whole)
        return rows

    return Scans(names, first.stamps, whole, load)


def rgbd_stream(bag: Bag, colour: Table, depth: Table) -> RgbdStream:
    """The frames of colour and depth images that this package wrote, read and decoded when they are asked for."""
    (rgb_rows, rgb), (depth_rows, disparity) = bag.used(colour), bag.used(depth)

    def decoded(table: Table, rows: Rows, index: int, decode: Callable[[bytes], NDArray[Pixel]]) -> NDArray[Pixel]:
        (message,) = bag.messages(table, rows[index : index + 1])
        try:
            return decode(message.data.tobytes())
        except ValueError as error:
            raise InputError(f"image {index}: {error}", file=bag.path, field=table.topic.name) from error

    def disparities(index: int) -> NDArray[np.uint16]:
        return disparity_of(0.001 * decoded(depth, depth_rows, index, decode_disparity).astype(np.float64))  # of mm

    images = Images(lambda index: decoded(colour, rgb_rows, index, decode_rgb), disparities)
    return RgbdStream(rgb, disparity, images=images)
