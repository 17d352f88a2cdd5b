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
from moteslam.robot.formats.bags.bag import Bag, Table, Topic
from moteslam.robot.formats.bags.times import Times
from moteslam.robot.formats.bounds import check_fan
from moteslam.robot.formats.no_return import no_return_limit
from moteslam.robot.formats.ranges import clean_ranges
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

Rows = NDArray[np.float32]


@dataclass(frozen=True)
class Fan:
    """What the scans of a topic have in common.

    Attributes:
        beams: ranges in a scan.
        angle_min: of the first beam, in the lidar's frame [rad].
        angle_increment: between beams [rad].
        range_min, range_max: what the sensor can measure [m].
        time_increment: between beams [s]; 0 where it is not known.
    """

    beams: int
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    time_increment: float = 0.0

    @property
    def angles(self) -> NDArray[np.float64]:
        """Of the beams [beams] [rad]."""
        return self.angle_min + self.angle_increment * np.arange(self.beams, dtype=np.float64)

    def flipped(self) -> Fan:
        """The fan seen from the other side: of a lidar that hangs upside down."""
        return replace(self, angle_min=-self.angle_min, angle_increment=-self.angle_increment)

    def reversed(self) -> Fan:
        """The fan with its last beam first."""
        last = self.angle_min + (self.beams - 1) * self.angle_increment
        step, time = -self.angle_increment, -self.time_increment
        return replace(self, angle_min=last, angle_increment=step, time_increment=time)


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
    stamps: NDArray[np.float64]
    fan: Fan
    load: Callable[[NDArray[np.intp]], Rows]

    def cleaned(self, indices: NDArray[np.intp], fan: Fan) -> Rows:
        """The ranges [k, beams] of some scans: endpoints within a fan's limits, ``inf`` and ``nan``."""
        ranges, _ = clean_ranges(
            self.load(indices), fan.range_min, fan.range_max, file=Path(self.topic), field="ranges"
        )
        ranges[ranges == 0] = np.nan
        return ranges


def scan_table(topic: Topic) -> Table:
    """Of scans: first and last angle, steps of angle and time, limits, number of beams."""
    return Table(topic, _figures, 7)


def _figures(message: Any) -> tuple[float, ...]:
    angles = (message.angle_min, message.angle_max, message.angle_increment)
    if not all(map(math.isfinite, angles)) or len(message.ranges) > MAX_BEAMS:
        raise ValueError("no angles")
    return (*angles, message.time_increment, message.range_min, message.range_max, len(message.ranges))


def laser_scans(bag: Bag, table: Table, times: Times, issues: list[Issue]) -> Scans:
    """The scans of a topic, each with its angles, on the fan that most of them have or on a finer one.

    Raises:
        InputError: too many broken messages, absurd stamps, no beams, or figures of no lidar.
    """
    name = f"{bag.path.name}: {table.topic.name}"
    figures = table.values
    kept, stamps = times.used(table)
    beams = figures[kept, 6].astype(np.int64)
    if empty := int((beams == 0).sum()):
        issues.append(Issue("empty-scans", f"{name}: {counted(empty, 'scan')} without ranges left aside", empty))
        kept, stamps, beams = kept[beams > 0], stamps[beams > 0], beams[beams > 0]
    if not len(kept):
        raise InputError("scans without ranges, expected some", file=bag.path, field=table.topic.name)
    figures = figures[kept]
    alike, fan = _common_fan(bag.path, table.topic, figures, beams, issues)
    frame = table.frame(int(kept[int(np.argmax(alike))]))
    can_be = alike | _can_be(figures, beams)
    if absurd := int((~can_be).sum()):
        issues.append(
            Issue("other-scans", f"{name}: {counted(absurd, 'scan')} of angles of no lidar left aside", absurd)
        )
        kept, stamps, beams = kept[can_be], stamps[can_be], beams[can_be]
        figures, alike = figures[can_be], alike[can_be]
    laid = not alike.all()
    if laid:
        fan = fan if 2 * alike.sum() > len(alike) else _finer_fan(figures, beams, fan)
        check_fan(fan.beams, fan.angle_increment, file=bag.path, field=f"{table.topic.name}: angle_increment")
        text = f"{name}: {counted(int((~alike).sum()), 'scan')} of other beams than most: laid by their angles on "
        issues.append(Issue("other-scans", f"{text}{fan.beams} beams", int((~alike).sum())))
    places = np.array(table.places).reshape(-1, 3)[kept]
    read = _first_echoes if table.topic.kind == MULTI_ECHO else _ranges

    def load(indices: NDArray[np.intp]) -> Rows:
        rows = np.full((len(indices), fan.beams), np.nan, np.float32)
        for row, index, data in zip(rows, indices.tolist(), bag.payloads(places[indices]), strict=True):
            try:
                ranges = read(bag.decode(table.topic, data))
            except ValueError as error:
                raise InputError(f"a scan is broken: {error}", file=bag.path, field=table.topic.name) from error
            if laid:
                lay(row, ranges, figures[index, 0] + _step(figures[index]) * np.arange(len(ranges)), fan)
            else:
                row[:] = ranges
        return rows

    scans = Scans(table.topic.name, frame, stamps, fan, load)
    scans = _with_limit(bag.path, _with_step(bag.path, scans, issues), issues)
    if scans.fan.time_increment >= 0:
        return scans
    return replace(scans, fan=scans.fan.reversed(), load=lambda indices: load(indices)[:, ::-1])


def _ranges(message: Any) -> Rows:
    ranges: Rows = message.ranges
    return ranges


def _first_echoes(message: Any) -> Rows:
    """The first echo of each beam; a beam without one has no return."""
    firsts = [beam.echoes[0] if len(beam.echoes) else np.inf for beam in message.ranges]
    return np.array(firsts, np.float32)


def lay(row: Rows, ranges: Rows, angles: NDArray[np.float64], fan: Fan) -> None:
    """Put the ranges of beams at some angles into the nearest beams of a fan; of two in one the nearer counts."""
    turn = 2 * np.pi / abs(fan.angle_increment)
    steps = (angles - fan.angle_min) / fan.angle_increment
    beams = np.rint(np.mod(steps + 0.5, turn) - 0.5)
    inside = (beams >= 0) & (beams < fan.beams)
    at, found = beams[inside].astype(np.intp), ranges[inside].astype(np.float32)
    np.fmin.at(row, at, found)


def _step(figures: NDArray[np.float64]) -> float:
    """Between the beams of a scan [rad]."""
    first, last, step, _, _, _, beams = figures.tolist()
    return float(step or (last - first) / max(1, beams - 1))


def _can_be(figures: NDArray[np.float64], beams: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which scans have angles in radians that go round once."""
    steps = np.array([_step(row) for row in figures])
    turn = np.abs(steps) * (beams - 1) <= 2 * np.pi + np.abs(steps) / 2
    return np.asarray((np.abs(figures[:, 0]) <= 4 * np.pi) & turn & (steps != 0))


def _common_fan(
    path: Path, topic: Topic, figures: NDArray[np.float64], beams: NDArray[np.int64], issues: list[Issue]
) -> tuple[NDArray[np.bool_], Fan]:
    """Which scans have the fan of most of them, to half a step at both ends, and that."""
    numbers, counts = np.unique(beams, return_counts=True)
    most = int(numbers[np.argmax(counts)])
    same = beams == most
    angle_min, angle_max, increment = (_most_frequent(column[same]) for column in figures[:, :3].T)
    if increment == 0 and most > 1:
        increment = (angle_max - angle_min) / (most - 1)
    if increment == 0:
        raise InputError("angle_increment of 0, expected an angle between beams", file=path, field=topic.name)
    check_fan(most, increment, file=path, field=f"{topic.name}: angle_increment")
    if abs(angle_min) > 4 * np.pi:
        raise InputError(f"angle_min of {angle_min:.6g}, expected radians", file=path, field=topic.name)
    last = angle_min + (most - 1) * increment
    if abs(last - angle_max) > abs(increment):
        text = f"{path.name}: {topic.name}: angle_max of {angle_max:.4f} rad, but {most} beams end at {last:.4f}"
        issues.append(Issue("angle-max", f"{text}; the beams are used"))
    ends = figures[:, 0] + (beams - 1) * figures[:, 2]
    half = abs(increment) / 2
    alike = same & (np.abs(figures[:, 0] - angle_min) <= half)
    alike &= (np.abs(ends - last) <= half) | (figures[:, 2] == 0)
    time_increment, range_min, range_max = (_most_frequent(column[alike]) for column in figures[:, 3:6].T)
    return alike, Fan(most, angle_min, increment, max(0.0, range_min), range_max, time_increment)


def _finer_fan(figures: NDArray[np.float64], beams: NDArray[np.int64], common: Fan) -> Fan:
    """A fan over all the directions of scans that have beams of their own each."""
    steps = np.array([_step(row) for row in figures])
    ends = figures[:, 0] + (beams - 1) * steps
    step = float(np.median(np.abs(steps))) / FINER
    low, high = float(np.minimum(figures[:, 0], ends).min()), float(np.maximum(figures[:, 0], ends).max())
    around = round(2 * np.pi / step)
    if high - low > 2 * np.pi - 2 * FINER * step:
        count, step = around, 2 * np.pi / around
    else:
        count = round((high - low) / step) + 1
    count = min(count, MAX_BEAMS)
    sweep = np.median(figures[:, 3] / np.where(steps == 0, np.inf, np.abs(steps)))
    up = common.angle_increment > 0
    first = low if up else high
    return replace(
        common,
        beams=count,
        angle_min=first,
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
    return replace(scans, fan=replace(fan, time_increment=0.0))


def _with_limit(path: Path, scans: Scans, issues: list[Issue]) -> Scans:
    """The scans with a limit that can be: where the messages state none, by a sample of the ranges, as for a log."""
    fan = scans.fan
    if fan.range_min < fan.range_max < np.inf:
        return scans
    chosen = np.unique(np.linspace(0, len(scans.stamps) - 1, min(SAMPLE, len(scans.stamps))).astype(np.intp))
    limit = no_return_limit(scans.load(chosen), None)
    text = f"{path.name}: {scans.topic}: range_max of {fan.range_max:g} m; {limit:g} m is taken, by the ranges"
    issues.append(Issue("range-max", text))
    return replace(scans, fan=replace(fan, range_min=0.0 if fan.range_min >= limit else fan.range_min, range_max=limit))
