"""Scans of ``sensor_msgs/LaserScan`` and ``MultiEchoLaserScan``: figures on opening, ranges on demand, one fan.

Ranges mean what REP 117 says: positive infinity is no return, negative infinity too near, NaN an error; and what is
beyond the limits that a message states counts as no return, or invalid (``docs/reference/formats.md``).
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
from moteslam.robot.formats.bags.bag import Bag, Table
from moteslam.robot.formats.bags.times import Rows, Times
from moteslam.robot.formats.stamps import Stamps
from moteslam.robot.formats.streams import Fan, check_fan, clean_ranges, no_return_limit
from moteslam.robot.platform import MAX_BEAMS
from moteslam.robot.values import Issue, counted

LASER_SCAN, MULTI_ECHO = "sensor_msgs/LaserScan", "sensor_msgs/MultiEchoLaserScan"

SAMPLE = 64
"""Scans, spread over the bag, that are looked at for the limit where the messages state none."""
MAX_STEP = 0.01
"""Between two beams [s]: no lidar is slower."""
FINER = 4
"""Of scans with beams of their own each, the common fan has this many beams for one of theirs: an endpoint lies up to
an eighth of their step beside its beam."""

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
        ranges = clean_ranges(self.load(indices), fan, [], "")
        ranges[ranges == 0] = np.nan
        return ranges


def figures_of(message: Any) -> tuple[float, ...]:
    """The figures of a scan, see `Figures`."""
    angles = (message.angle_min, message.angle_max, message.angle_increment)
    if not all(map(math.isfinite, angles)) or len(message.ranges) > MAX_BEAMS:
        raise ValueError("no angles")
    return (*angles, message.time_increment, message.range_min, message.range_max, len(message.ranges))


def laser_scans(bag: Bag, table: Table, times: Times, issues: list[Issue]) -> Scans:
    """The scans of a topic, each with its angles, on the fan that most of them have or on a finer one."""
    name, topic = f"{bag.path.name}: {table.topic.name}", table.topic.name
    kept, stamps = times.used(table)
    figures = table.values[kept]

    def keep_and_tell(code: str, good: NDArray[np.bool_], what: str) -> None:
        nonlocal kept, stamps, figures
        if left := int((~good).sum()):
            issues.append(Issue(code, f"{name}: {counted(left, 'scan')} {what} left aside", left))
            kept, stamps, figures = kept[good], stamps[good], figures[good]

    keep_and_tell("empty-scans", figures[:, 6] > 0, "without ranges")
    if not len(kept):
        raise InputError("scans without ranges, expected some", file=bag.path, field=topic)
    alike, fan = _common_fan(bag.path, topic, figures, issues)
    frame = table.frame(int(kept[int(np.argmax(alike))]))
    steps = _steps(figures)
    turn = np.abs(steps) * (figures[:, 6] - 1) <= 2 * np.pi + np.abs(steps) / 2
    can_be = alike | ((np.abs(figures[:, 0]) <= 4 * np.pi) & turn & (steps != 0))
    keep_and_tell("other-scans", can_be, "of angles of no lidar")
    alike = alike[can_be]
    is_laid = not alike.all()
    if is_laid:
        fan = fan if 2 * alike.sum() > len(alike) else _finer_fan(figures, fan)
        check_fan(fan.beams, fan.angle_increment, file=bag.path, field=f"{topic}: angle_increment")
        text = f"{name}: {counted(int((~alike).sum()), 'scan')} of other beams than most: laid by their angles on "
        issues.append(Issue("other-scans", f"{text}{fan.beams} beams", int((~alike).sum())))
    places, steps = table.places_of(kept), _steps(figures)

    def load(indices: Rows) -> Ranges:
        rows = np.full((len(indices), fan.beams), np.nan, np.float32)
        for row, index, data in zip(rows, indices.tolist(), bag.payloads(places[indices]), strict=True):
            try:
                message = bag.decode(table.topic, data)
            except ValueError as error:
                raise InputError(f"a scan is broken: {error}", file=bag.path, field=topic) from error
            ranges = message.ranges
            if table.topic.kind == MULTI_ECHO:  # the first echo of each beam; one without has no return
                firsts = [beam.echoes[0] if len(beam.echoes) else np.inf for beam in ranges]
                ranges = np.array(firsts, np.float32)
            if is_laid:
                lay(row, ranges, figures[index, 0] + steps[index] * np.arange(len(ranges)), fan)
            else:
                row[:] = ranges
        return rows

    scans = _with_limit(bag.path, _with_step(bag.path, Scans(topic, frame, stamps, fan, load), issues), issues)
    if scans.fan.time_increment >= 0:
        return scans
    return replace(scans, fan=scans.fan.reversed(), load=lambda indices: load(indices)[:, ::-1])


def lay(row: Ranges, ranges: Ranges, angles: NDArray[np.float64], fan: Fan) -> None:
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


def _common_fan(path: Path, topic: str, figures: Figures, issues: list[Issue]) -> tuple[NDArray[np.bool_], Fan]:
    """Which scans have the fan of most of them, to half a step at both ends, and that."""
    beams = figures[:, 6].astype(np.int64)
    most = int(_most_frequent(figures[:, 6]))
    same = beams == most
    angle_min, angle_max, increment = (_most_frequent(column[same]) for column in figures[:, :3].T)
    if increment == 0 and most > 1:
        increment = (angle_max - angle_min) / (most - 1)
    if increment == 0:
        raise InputError("angle_increment of 0, expected an angle between beams", file=path, field=topic)
    check_fan(most, increment, file=path, field=f"{topic}: angle_increment")
    if abs(angle_min) > 4 * np.pi:
        raise InputError(f"angle_min of {angle_min:.6g}, expected radians", file=path, field=topic)
    last = angle_min + (most - 1) * increment
    if abs(last - angle_max) > abs(increment):
        text = f"{path.name}: {topic}: angle_max of {angle_max:.4f} rad, but {most} beams end at {last:.4f}"
        issues.append(Issue("angle-max", f"{text}; the beams are used"))
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


def _with_step(path: Path, scans: Scans, issues: list[Issue]) -> Scans:
    """The scans with a time between beams that can be: of a scan that is over before the next but one begins."""
    fan = scans.fan
    period = float(np.median(np.diff(scans.stamps))) if len(scans.stamps) > 1 else np.inf
    if abs(fan.time_increment) * fan.beams <= 2 * period and abs(fan.time_increment) <= MAX_STEP:
        return scans
    text = f"{path.name}: {scans.topic}: time_increment of {fan.time_increment:g} s is more than scans take; not used"
    issues.append(Issue("time-increment", text))
    return replace(scans, fan=fan._replace(time_increment=0.0))


def _with_limit(path: Path, scans: Scans, issues: list[Issue]) -> Scans:
    """The scans with a limit that can be: where the messages state none, by a sample of the ranges, as for a log."""
    fan = scans.fan
    if fan.range_min < fan.range_max < np.inf:
        return scans
    chosen = np.unique(np.linspace(0, len(scans.stamps) - 1, min(SAMPLE, len(scans.stamps))).astype(np.intp))
    limit = no_return_limit(scans.load(chosen), None)
    text = f"{path.name}: {scans.topic}: range_max of {fan.range_max:g} m; {limit:g} m is taken, by the ranges"
    issues.append(Issue("range-max", text))
    least = 0.0 if fan.range_min >= limit else fan.range_min
    return replace(scans, fan=fan._replace(range_min=least, range_max=limit))
