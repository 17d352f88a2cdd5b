"""Scans of ``sensor_msgs/LaserScan`` and ``MultiEchoLaserScan``: their figures from the heads, their ranges on demand.

Ranges mean what REP 117 says: positive infinity is no return, negative infinity too near, NaN an error; and what is
beyond the limits that a message states counts as no return, or invalid (``docs/reference/formats.md``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.formats.bags.bag import Bag, Topic
from moteslam.robot.formats.bags.cursor import BrokenMessageError, Cursor
from moteslam.robot.formats.bags.heads import HeadReader
from moteslam.robot.formats.bags.times import used_messages
from moteslam.robot.formats.bags.transforms import frame_name
from moteslam.robot.formats.bounds import check_fan
from moteslam.robot.formats.no_return import no_return_limit
from moteslam.robot.formats.ranges import clean_ranges
from moteslam.robot.issues import Issue
from moteslam.robot.specs import MAX_BEAMS
from moteslam.robot.wording import counted

LASER_SCAN, MULTI_ECHO = "sensor_msgs/LaserScan", "sensor_msgs/MultiEchoLaserScan"

SAMPLE = 64
"""Scans, spread over the bag, that are looked at for the limit where the messages state none."""

MAX_STEP = 0.01
"""Between two beams [s]: no lidar is slower."""

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

    def flipped(self) -> Fan:
        """The fan seen from the other side: of a lidar that hangs upside down."""
        return replace(self, angle_min=-self.angle_min, angle_increment=-self.angle_increment)


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
        name = Path(self.topic)
        ranges, _ = clean_ranges(self.load(indices), fan.range_min, fan.range_max, file=name, field="ranges")
        ranges[ranges == 0] = np.nan
        return ranges


def scan_reader(topic: Topic, *, ros1: bool) -> HeadReader:
    """What reads the heads of scans: seven float32 and the number of beams, four bytes each."""
    return HeadReader(len(topic), ros1=ros1, texts=1, kind="u4", width=8)


def laser_scans(bag: Bag, topic: Topic, reader: HeadReader, issues: list[Issue]) -> Scans:
    """The scans of a topic, from their heads.

    The number of beams that most scans have is kept; scans with another, or whose first or last beam points more than
    half an increment elsewhere, are left aside, and counted in an issue.

    Raises:
        InputError: too many broken messages, absurd stamps, no beams, or figures of no lidar.
    """
    heads = reader.heads()
    figures = heads.values.view(np.float32).astype(np.float64)
    beams = heads.values[:, 7].astype(np.int64)
    broken = heads.broken | ~np.isfinite(figures[:, :3]).all(axis=1) | (beams < 1) | (beams > MAX_BEAMS)
    kept, stamps = used_messages(bag.path, topic, heads.stamps, broken, issues)
    figures, beams = figures[kept], beams[kept]
    alike, fan = _common_fan(bag.path, topic, figures, beams, issues)
    frame = frame_name(heads.texts[kept[int(np.argmax(alike))]][0])
    chosen = kept[alike]
    read = _multi_echo if topic.kind == MULTI_ECHO else _laser_scan

    def load(indices: NDArray[np.intp]) -> Rows:
        rows = np.empty((len(indices), fan.beams), np.float32)
        for row, data in zip(rows, bag.messages(topic, chosen[indices]), strict=True):
            try:
                row[:] = read(data, bag.ros1, fan.beams)
            except (BrokenMessageError, ValueError) as error:
                raise InputError(f"a scan is broken: {error}", file=bag.path, field=topic.name) from error
        return rows

    scans = Scans(topic.name, frame, stamps[alike], fan, load)
    return _with_limit(bag.path, _with_step(bag.path, scans, issues), issues)


def _common_fan(
    path: Path, topic: Topic, figures: NDArray[np.float64], beams: NDArray[np.int64], issues: list[Issue]
) -> tuple[NDArray[np.bool_], Fan]:
    """Which scans have the fan of most of them, and that."""
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
    if others := int((~alike).sum()):
        text = f"{path.name}: {topic.name}: {counted(others, 'scan')} of other beams than {most} left aside"
        issues.append(Issue("other-scans", text, others))
    time_increment, _, range_min, range_max = (_most_frequent(column[alike]) for column in figures[:, 3:7].T)
    return alike, Fan(most, angle_min, increment, max(0.0, range_min), range_max, max(0.0, time_increment))


def _most_frequent(values: NDArray[np.float64]) -> float:
    """The value that most messages have; 0 where that is not a number."""
    numbers, counts = np.unique(values, return_counts=True)
    value = float(numbers[np.argmax(counts)])
    return 0.0 if np.isnan(value) else value


def _with_step(path: Path, scans: Scans, issues: list[Issue]) -> Scans:
    """The scans with a time between beams that can be: of a scan that is over before the next but one begins."""
    fan = scans.fan
    period = float(np.median(np.diff(scans.stamps))) if len(scans.stamps) > 1 else np.inf
    if fan.time_increment * fan.beams <= 2 * period and fan.time_increment <= MAX_STEP:
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


def _at_beams(data: bytes, ros1: bool) -> Cursor:
    """A cursor before the ranges: behind header and figures."""
    cursor = Cursor(data, ros1=ros1)
    cursor.position = 12
    cursor.raw_text()
    cursor.align(4)
    cursor.position += 28
    return cursor


def _laser_scan(data: bytes, ros1: bool, beams: int) -> Rows:
    return _at_beams(data, ros1).array("f4")[:beams]


def _multi_echo(data: bytes, ros1: bool, beams: int) -> Rows:
    """The first echo of each beam; a beam without one has no return."""
    cursor = _at_beams(data, ros1)
    if cursor.number("I") != beams:
        raise BrokenMessageError("another number of beams")
    left = (len(data) - cursor.position) // 4
    words = cursor.array("u4", left)
    values, lengths = words.view(f"{cursor.order}f4"), words.tolist()
    firsts = np.empty(beams, np.intp)
    at = 0
    for beam in range(beams):
        if at >= left or at + lengths[at] >= left + 1:
            raise BrokenMessageError("cut short")
        firsts[beam] = at + 1 if lengths[at] else -1
        at += 1 + lengths[at]
    return np.where(firsts < 0, np.float32(np.inf), values[firsts].astype(np.float32))
