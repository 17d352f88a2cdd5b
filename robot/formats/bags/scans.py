"""Scans of lidars: figures on opening, ranges on demand, one fan for all scans.

``sensor_msgs/LaserScan`` and ``MultiEchoLaserScan`` mean what REP 117 says: positive infinity is no return, negative
infinity too near, NaN an error; and what is beyond the limits that a message states counts as no return, or invalid.

Of several lidars a scan of the first is joined with the scan of each other one that is nearest in time; what the robot
moves in between, at most half the time between two scans, is left out of account. Every endpoint falls into the beam of
its direction from the robot's centre, and the nearest one in a beam counts. A beam without one has no return if a beam
of a lidar without return ends in it, put at that lidar's limit; a beam in which nothing falls says nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.formats.bags.bag import Bag, Rows, Table
from moteslam.robot.formats.bags.frames import Mount
from moteslam.robot.formats.streams import Fan, Stamps, clean_ranges, given_again, no_return_limit
from moteslam.robot.platform import MAX_BEAMS, too_wide
from moteslam.robot.recording import nearest_stamp
from moteslam.robot.values import counted

LASER_SCAN, MULTI_ECHO = "sensor_msgs/LaserScan", "sensor_msgs/MultiEchoLaserScan"

SAMPLE = 64
"""Scans, spread over the bag, that are looked at for the limit where the messages state none."""
MAX_STEP = 0.01
"""Between two beams [s]: no lidar is slower."""
FINER = 4
"""Of scans with beams of their own each, the common fan has this many beams for one of theirs: an endpoint lies up to
an eighth of their step beside its beam."""
GAP = 1.5
"""A scan further away in time than this many times between two scans is not joined: that lidar was silent."""

Ranges = NDArray[np.float32]
Figures = NDArray[np.float64]
"""Of scans [n, 7]: first and last angle, steps of angle and time, limits, number of beams."""


@dataclass(frozen=True, eq=False)
class Scans:
    """The scans of a topic.

    Attributes:
        topic: their name.
        frame: in which the beams' angles are.
        stamps: [n] rising [s].
        fan: of all of them.
        load: ``load(indices)`` reads the ranges [k, beams] [m] of some scans, raw.
    """

    topic: str
    frame: str
    stamps: Stamps
    fan: Fan
    load: Callable[[Rows], Ranges]

    def cleaned(self, indices: Rows, fan: Fan) -> Ranges:
        """The ranges [k, beams] of some scans: endpoints within a fan's limits, ``inf`` and ``nan``."""
        return clean_ranges(self.load(indices), fan, [], "")


def figures_of(message: Any) -> tuple[float, ...]:
    """The figures of a scan, see `Figures`."""
    angles = (message.angle_min, message.angle_max, message.angle_increment)
    if not all(map(math.isfinite, angles)) or len(message.ranges) > MAX_BEAMS:
        raise ValueError("no angles")
    return (*angles, message.time_increment, message.range_min, message.range_max, len(message.ranges))


def laser_scans(bag: Bag, table: Table) -> Scans:
    """The scans of a topic, each with its angles, on the fan that most of them have or on a finer one."""
    topic = table.topic.name
    kept, stamps = bag.used(table)
    same = np.diff(table.heads["mark"][kept], prepend=0) == 0
    new = ~given_again(bag.path, topic, stamps, same, bag.issues)
    kept, stamps = kept[new], stamps[new]
    figures = table.values[kept]

    def keep_and_tell(code: str, good: NDArray[np.bool_], what: str) -> None:
        nonlocal kept, stamps, figures
        if left := int((~good).sum()):
            bag.tell(code, topic, f"{counted(left, 'scan')} {what} left aside", left)
            kept, stamps, figures = kept[good], stamps[good], figures[good]

    keep_and_tell("empty-scans", figures[:, 6] > 0, "without ranges")
    if not len(kept):
        raise InputError("scans without ranges, expected some", file=bag.path, field=topic)
    alike, fan = _common_fan(bag, topic, figures)
    frame = table.frame(int(kept[int(np.argmax(alike))]))
    steps = _steps(figures)
    turn = np.abs(steps) * (figures[:, 6] - 1) <= 2 * np.pi + np.abs(steps) / 2
    can_be = alike | ((np.abs(figures[:, 0]) <= 4 * np.pi) & turn & (steps != 0))
    keep_and_tell("other-scans", can_be, "of angles of no lidar")
    alike = alike[can_be]
    is_laid = not alike.all()
    if is_laid:
        fan = fan if 2 * alike.sum() > len(alike) else _finer_fan(figures, fan)
        others = int((~alike).sum())
        what = f"{counted(others, 'scan')} of other beams than most: laid by their angles on {fan.beams} beams"
        bag.tell("other-scans", topic, what, others)
    steps = _steps(figures)

    def load(indices: Rows) -> Ranges:
        rows = np.full((len(indices), fan.beams), np.nan, np.float32)
        for row, index, message in zip(rows, indices.tolist(), bag.messages(table, kept[indices]), strict=True):
            ranges = message.ranges
            if table.topic.kind == MULTI_ECHO:  # the first echo of each beam; one without has no return
                firsts = [beam.echoes[0] if len(beam.echoes) else np.inf for beam in ranges]
                ranges = np.array(firsts, np.float32)
            if is_laid:
                _lay(row, ranges, figures[index, 0] + steps[index] * np.arange(len(ranges)), fan)
            else:
                row[:] = ranges
        return rows

    scans = _with_figures_that_can_be(bag, Scans(topic, frame, stamps, fan, load))
    if scans.fan.time_increment >= 0:
        return scans
    return replace(scans, fan=scans.fan.reversed(), load=lambda indices: load(indices)[:, ::-1])


def _lay(row: Ranges, ranges: Ranges, angles: NDArray[np.float64], fan: Fan) -> None:
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
    beams = figures[:, 6].astype(np.int64)
    most = int(_most_frequent(figures[:, 6]))
    same = beams == most
    angle_min, angle_max, increment = (_most_frequent(column[same]) for column in figures[:, :3].T)
    if increment == 0 and most > 1:
        increment = (angle_max - angle_min) / (most - 1)
    if increment == 0:
        raise InputError("angle_increment of 0, expected an angle between beams", file=bag.path, field=topic)
    if (problem := too_wide(most, increment)) is not None:
        raise InputError(problem, file=bag.path, field=f"{topic}: angle_increment")
    if abs(angle_min) > 4 * np.pi:
        raise InputError(f"angle_min of {angle_min:.6g}, expected radians", file=bag.path, field=topic)
    last = angle_min + (most - 1) * increment
    if abs(last - angle_max) > abs(increment):
        what = f"angle_max of {angle_max:.4f} rad, but {most} beams end at {last:.4f}; the beams are used"
        bag.tell("angle-max", topic, what)
    ends = figures[:, 0] + (beams - 1) * figures[:, 2]
    half = abs(increment) / 2
    alike = same & (np.abs(figures[:, 0] - angle_min) <= half)
    alike &= (np.abs(ends - last) <= half) | (figures[:, 2] == 0)
    time_increment, range_min, range_max = (_most_frequent(column[alike]) for column in figures[:, 3:6].T)
    return alike, Fan(angle_min, increment, max(0.0, range_min), range_max, most, time_increment)


def _finer_fan(figures: Figures, common: Fan) -> Fan:
    """A fan over all the directions of scans that have beams of their own each."""
    steps = _steps(figures)
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
    value = float(numbers[np.argmax(counts)])
    return 0.0 if np.isnan(value) else value


def _with_figures_that_can_be(bag: Bag, scans: Scans) -> Scans:
    """The scans with a time between beams and a limit that can be.

    A scan is over before the next but one begins; else the time is not used. Where the messages state no limit, it is
    that of a sample of the ranges, as for a log.
    """
    fan = scans.fan
    period = float(np.median(np.diff(scans.stamps))) if len(scans.stamps) > 1 else np.inf
    if abs(fan.time_increment) * fan.beams > 2 * period or abs(fan.time_increment) > MAX_STEP:
        what = f"time_increment of {fan.time_increment:g} s is more than scans take; not used"
        bag.tell("time-increment", scans.topic, what)
        fan = fan._replace(time_increment=0.0)
    if not fan.range_min < fan.range_max < np.inf:
        count = len(scans.stamps)
        sample = np.unique(np.linspace(0, count - 1, min(SAMPLE, count)).astype(np.intp))
        limit = no_return_limit(scans.load(sample), None)
        bag.tell("range-max", scans.topic, f"range_max of {fan.range_max:g} m; {limit:g} m is taken, by the ranges")
        fan = fan._replace(range_min=0.0 if fan.range_min >= limit else fan.range_min, range_max=limit)
    return replace(scans, fan=fan)


def merged_scans(path: Path, lidars: list[Scans], mounts: list[Mount]) -> Scans:
    """The scans of two or more lidars as one fan about the robot's centre; the first sets the stamps."""
    first = lidars[0]
    fans = [one.fan.flipped() if mount.upside_down else one.fan for one, mount in zip(lidars, mounts, strict=True)]
    beams = min(MAX_BEAMS, round(2 * np.pi / min(abs(fan.angle_increment) for fan in fans)))
    reach = max(fan.range_max + float(np.hypot(mount.x, mount.y)) for fan, mount in zip(fans, mounts, strict=True))
    whole = Fan(-np.pi + np.pi / beams, 2 * np.pi / beams, 0.0, reach, beams)
    names = ", ".join(scans.topic for scans in lidars)
    if len(set(mounts)) < len(mounts):
        table = f'[lidars."{first.topic}"] with x, y, yaw for each in the platform\'s file'
        problem = f"two lidars at one place, expected a transform to each, or a table {table}"
        raise InputError(problem, file=path, field=names)

    def load(indices: Rows) -> Ranges:
        rows = np.full((len(indices), beams), np.nan, np.float32)
        for scans, fan, mount in zip(lidars, fans, mounts, strict=True):
            near = nearest_stamp(scans.stamps, first.stamps[indices])
            period = float(np.median(np.diff(scans.stamps))) if len(scans.stamps) > 1 else 0.0
            used = np.flatnonzero(np.abs(scans.stamps[near] - first.stamps[indices]) <= GAP * period)
            if len(used):
                rows[used] = _joined(rows[used], scans.cleaned(near[used], fan).astype(np.float64), fan, mount, whole)
        return rows

    return Scans(names, "", first.stamps, whole, load)


def _joined(rows: Ranges, ranges: NDArray[np.float64], fan: Fan, mount: Mount, whole: Fan) -> Ranges:
    """Rows [k, beams] of the whole fan with the ranges [k, b] of a lidar laid into them; what is nearer stays."""
    echo = np.isfinite(ranges)
    placed = np.where(np.isinf(ranges), fan.range_max, ranges)
    angles = mount.yaw + fan.angles
    x, y = mount.x + placed * np.cos(angles), mount.y + placed * np.sin(angles)
    known = np.isfinite(placed)
    turn = np.mod(np.arctan2(y[known], x[known]) + np.pi, 2 * np.pi)
    column = np.minimum((turn / whole.angle_increment).astype(np.intp), whole.beams - 1)
    row = np.broadcast_to(np.arange(len(rows))[:, None], ranges.shape)[known]
    found = np.where(echo[known], np.hypot(x[known], y[known]), np.inf).astype(np.float32)
    laid = np.where(np.isnan(rows), np.inf, rows)  # as far as an endpoint goes, what says nothing is beyond reach
    np.minimum.at(laid, (row, column), found)
    seen = ~np.isnan(rows)
    seen[row, column] = True
    return np.where(seen, laid, np.nan)
