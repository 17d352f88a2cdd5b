"""BreezySLAM logs (``exp2.dat``): wheel counters and a URG-04LX on a robot of Mines ParisTech, a line a reading.

Columns, from 1: the time [us]; 3 and 4 the running counters of the left and the right wheel; from 25 on 682 ranges
[mm], and one more that is no range. The others are of other sensors. Source: BreezySLAM (S. Levy), whose example
reads these logs; it names the figures of the robot too.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from functools import partial
from os import PathLike
from pathlib import Path

import numpy as np

from moteslam.robot.formats.format import Format, Robot, one_sequence
from moteslam.robot.formats.streams import Fan, axle_counts, counts_of, encoder_stream, lidar_stream
from moteslam.robot.formats.text import TextLines
from moteslam.robot.formats.words import (
    are_numbers,
    begins_with,
    broken_issues,
    expect_stamp,
    expect_words,
    finite_numbers,
    numbers,
    parse_rows,
    whole_numbers,
)
from moteslam.robot.given_robot import GivenRobot
from moteslam.robot.platform import Platform, Wheels
from moteslam.robot.recording import Recording
from moteslam.robot.specs import LidarSpec

WORDS = 707
"""Of a line."""

COUNTERS = slice(2, 4)
RANGES = slice(24, 706)

MAX_COUNTER = 2**53
"""Counters stay below it."""

BEAMS = 682
"""Steps 44 to 725 of 1024 a turn, the front is 384 (Hokuyo URG-04LX, specification C-42-3389)."""

STEP = 2 * math.pi / 1024

ROBOT = Platform(
    name="mines",
    description="a robot of Mines ParisTech with a Hokuyo URG-04LX",
    # BreezySLAM: wheels of 77 mm radius, half an axle of 165 mm, 2000 ticks a turn. (It takes 180 degrees for
    # 2000 ticks and adds left and right, where the mean is meant. The scans agree: docs/reference/formats.md.)
    wheels=Wheels(
        metres_per_count=2 * math.pi * 0.077 / 2000, diameter=0.154, wheel_base=0.0, track=0.33, effective_track=0.33
    ),
    # BreezySLAM: "no detection" from 4 m on; 145 mm before the axle, but by the scans' own motion it turns on the spot
    lidar=LidarSpec(
        x=0.0, beams=BEAMS, angle_min=-340 * STEP, angle_increment=STEP, rate=10.0, range_min=0.02, range_max=4.0
    ),
)
"""The robot of the logs that BreezySLAM comes with."""


def is_breezyslam(path: Path) -> bool:
    """Whether a file, plain or gzip, begins with lines of 707 numbers, a time and two counters among them whole."""
    return begins_with(path, _is_reading)


def _is_reading(words: Sequence[bytes]) -> bool:
    whole = (words[0], *words[COUNTERS]) if len(words) == WORDS else ()
    return bool(whole) and all(word.lstrip(b"-").isdigit() for word in whole) and are_numbers(words)


def read_breezyslam(path: str | PathLike[str], *, platform: Robot = None) -> Recording:
    """Read a BreezySLAM log.

    Ranges of 4 m and more are no return; those below 20 mm, 0 among them, are error codes of the URG-04LX. Broken
    lines are dropped and counted, as long as there are no more than 3 of them or a tenth of the log.

    Args:
        path: the log.
        platform: the robot, or a ``platform.toml`` whose keys override those of the robot of these logs.

    Returns:
        a recording with ``lidar`` and ``encoders``, both with the stamps of the lines.

    Raises:
        InputError: nothing usable in it, too much broken, or absurd stamps.
    """
    path = Path(path)
    stamps, counters, ranges = array("d"), array("q"), array("f")
    lines = TextLines(path)
    broken = parse_rows(lines, partial(_parse, stamps, counters, ranges))
    issues = broken_issues(lines, broken, len(stamps), "no lines, expected a BreezySLAM log")
    given = GivenRobot.read(platform)
    robot = given.over(ROBOT)
    times = np.array(stamps, np.float64)
    left, right = counts_of(np.array(counters, np.int64).reshape(-1, 2)).T
    spec = ROBOT.lidar.scan
    return Recording(
        name=path.name.removesuffix(".gz").removesuffix(".dat"),
        platform=robot,
        lidar=lidar_stream(
            path,
            "ranges",
            stamps=times,
            ranges=np.array(ranges, np.float32).reshape(-1, BEAMS),
            fan=Fan(spec.angle_min, spec.angle_increment, spec.range_min, spec.range_max),
            robot=robot,
            given=given.lidar_figures,
            issues=issues,
        ),
        encoders=encoder_stream(path, "counters", times, axle_counts(left, right), robot, issues),
        warnings=tuple(issues),
    )


def _parse(
    stamps: array[float], counters: array[int], ranges: array[float], words: Sequence[bytes], number: int
) -> None:
    expect_words(words, WORDS, "a reading")
    stamp = expect_stamp(finite_numbers(words[:1])[0] * 1e-6)
    both = whole_numbers(words[COUNTERS], "counters", below=MAX_COUNTER)
    ranges.extend(array("f", [value * 1e-3 for value in numbers(words[RANGES])]))
    stamps.append(stamp)
    counters.extend(both)


FORMAT = Format(
    "BreezySLAM log (lines of 707 numbers)",
    is_folder=False,
    recognise=is_breezyslam,
    read=one_sequence("a BreezySLAM log", read_breezyslam),
)
