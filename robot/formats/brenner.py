"""Folders of C. Brenner's LEGO robot: text files of stamped lines, as ``robot4_motors.txt`` and ``robot4_scan.txt``.

``M t left . . . right ...``: running ticks of the two motors, in words 3 and 7 of 14.
``S t n r1..rn``: a scan [mm]; beam i looks to (i - 330) 2 pi / 1024, in a scanner that is turned by -4 degrees.
``P t x y``: a measured position of the scanner [mm]; a truth and no part of the recording (``robot/positions.py``).
Stamps are milliseconds. Source: the files and the reader that come with the lectures *SLAM* (C. Brenner, Leibniz
Universitaet Hannover, 2012).
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path

import numpy as np

from moteslam.errors import InputError
from moteslam.robot.formats.format import Format, Robot
from moteslam.robot.formats.streams import Fan, axle_counts, counts_of, encoder_stream, lidar_stream
from moteslam.robot.formats.text import TextLines
from moteslam.robot.formats.words import (
    are_numbers,
    begins_with,
    broken_issues,
    count_at,
    expect_stamp,
    expect_words,
    finite_numbers,
    numbers,
    parse_words,
    whole_numbers,
)
from moteslam.robot.given_robot import GivenRobot
from moteslam.robot.issues import Issue
from moteslam.robot.platform import Platform, Wheels
from moteslam.robot.recording import EncoderStream, LidarStream, Recording
from moteslam.robot.specs import LidarSpec

MOTOR_WORDS = 14
LEFT, RIGHT = 2, 6
MILLI = 0.001

MAX_TICKS = 2**31
"""Running ticks stay below it."""

MAX_FILES = 100
"""Of a folder that are looked into."""

STEP = 2 * math.pi / 1024
FIRST = -330 * STEP
"""Of beam 0 in the scanner's frame [rad]; Brenner counts beams from the front, which is beam 330."""

ROBOT = Platform(
    name="lego",
    description="C. Brenner's LEGO robot: two tracks, a Hokuyo URG-04LX",
    wheels=Wheels(metres_per_count=0.000349, diameter=0.04, wheel_base=0.0, track=0.155, effective_track=0.173),
    lidar=LidarSpec(
        x=0.03, yaw=math.radians(-4), angle_min=FIRST, angle_increment=STEP, range_min=0.02, range_max=4.095
    ),
)
"""The robot of these files: 0.349 mm a tick, 155 mm from track to track, which turn it as wheels 173 mm apart do, the
scanner 30 mm ahead; as the lectures have it, checked in ``docs/reference/formats.md``."""


@dataclass
class _Log:
    """What the files say: stamps [s] and ticks, flat [n * 2], and stamps [s] and ranges [m], flat [n * beams]."""

    motor_stamps: array[float] = field(default_factory=lambda: array("d"))
    ticks: array[int] = field(default_factory=lambda: array("q"))
    scan_stamps: array[float] = field(default_factory=lambda: array("d"))
    ranges: array[float] = field(default_factory=lambda: array("f"))
    beams: int | None = None

    def motors(self, words: Sequence[bytes], number: int) -> None:
        """Keep a reading of the two motors."""
        expect_words(words, MOTOR_WORDS, "motors")
        both = whole_numbers((words[LEFT], words[RIGHT]), "ticks", below=MAX_TICKS)
        self.motor_stamps.append(_stamp(words))
        self.ticks.extend(both)

    def scan(self, words: Sequence[bytes], number: int) -> None:
        """Keep a scan; all have the beams of the first."""
        count = count_at(words, 2, "ranges")
        expect_words(words, 3 + count, f"{count} ranges")
        if count != (self.beams or count):
            raise ValueError(f"{count} ranges, expected {self.beams} as in the scans before it")
        values = array("f", [value * MILLI for value in numbers(words[3:])])
        self.scan_stamps.append(_stamp(words))
        self.ranges.extend(values)
        self.beams = count


def _stamp(words: Sequence[bytes]) -> float:
    return expect_stamp(finite_numbers(words[1:2])[0] * MILLI)


def lego_sequences(folder: Path) -> dict[str, tuple[Path, ...]]:
    """The files with motor or scan lines of a folder by the run they are of: what stands before the last ``_``.

    Files of one word, ``motors.txt`` and ``scan.txt``, are of the run that the folder is named for. Empty for any
    other folder.
    """
    try:
        files = sorted(path for path in folder.iterdir() if path.is_file())[:MAX_FILES]
    except OSError:
        return {}
    runs: dict[str, tuple[Path, ...]] = {}
    for file in files:
        if begins_with(file, _is_entry):
            name = file.name.partition(".")[0].rpartition("_")[0] or folder.resolve().name
            runs[name] = (*runs.get(name, ()), file)
    return runs


def _is_entry(words: Sequence[bytes]) -> bool:
    if words[0] == b"M":
        return len(words) == MOTOR_WORDS and are_numbers(words[1:])
    return words[0] == b"S" and words[2:3] == [str(len(words) - 3).encode()] and are_numbers(words[1:])


def read_lego(folder: str | PathLike[str], *, sequence: str | int | None = None, platform: Robot = None) -> Recording:
    """Read a run of C. Brenner's LEGO robot.

    Ranges below 20 mm are error codes of the scanner. Broken lines are dropped and counted, as long as there are no
    more than 3 of them or a tenth of a file.

    Args:
        folder: where the files lie.
        sequence: the run, ``robot4``; may be left out where there is only one.
        platform: the robot, or a ``platform.toml`` whose keys override those of the LEGO robot.

    Returns:
        a recording with ``lidar`` and ``encoders``, each where there is a file.

    Raises:
        InputError: no such run, too much broken, or absurd stamps.
    """
    folder = Path(folder)
    name, files = _choose(folder, sequence)
    log, issues = _Log(), list[Issue]()
    for file in files:
        used = len(log.motor_stamps) + len(log.scan_stamps)
        lines = TextLines(file)
        broken = parse_words(lines, {b"M": log.motors, b"S": log.scan})
        used = len(log.motor_stamps) + len(log.scan_stamps) - used
        issues += broken_issues(lines, broken, used, "no M or S line, expected lines of the LEGO robot")
    given = GivenRobot.read(platform)
    robot = given.over(ROBOT)
    return Recording(
        name=name,
        platform=robot,
        lidar=_lidar(folder, log, robot, given, issues),
        encoders=_encoders(folder, log, robot, issues),
        warnings=tuple(issues),
    )


def _choose(folder: Path, sequence: str | int | None) -> tuple[str, tuple[Path, ...]]:
    runs = lego_sequences(folder)
    if not runs:
        raise InputError("holds no file that begins with M or S lines of the LEGO robot", file=folder)
    wanted = next(iter(runs)) if sequence is None and len(runs) == 1 else str(sequence)
    if wanted in runs:
        return wanted, runs[wanted]
    found = "several sequences" if sequence is None else f"no sequence {wanted}"
    raise InputError(f"{found}, expected one of {', '.join(runs)}", file=folder, field="sequence")


def _lidar(folder: Path, log: _Log, robot: Platform, given: GivenRobot, issues: list[Issue]) -> LidarStream | None:
    if log.beams is None:
        return None
    assert ROBOT.lidar.range_min is not None
    assert ROBOT.lidar.range_max is not None
    return lidar_stream(
        folder,
        "S",
        stamps=np.array(log.scan_stamps, np.float64),
        ranges=np.array(log.ranges, np.float32).reshape(-1, log.beams),
        fan=Fan(FIRST, STEP, ROBOT.lidar.range_min, ROBOT.lidar.range_max),
        robot=robot,
        given=given.lidar_figures,
        issues=issues,
    )


def _encoders(folder: Path, log: _Log, robot: Platform, issues: list[Issue]) -> EncoderStream | None:
    if not log.motor_stamps:
        return None
    left, right = counts_of(np.array(log.ticks, np.int64).reshape(-1, 2)).T
    stamps = np.array(log.motor_stamps, np.float64)
    return encoder_stream(folder, "M", stamps, axle_counts(left, right), robot, issues)


def _read(path: Path, sequence: str | int | None, platform: Robot) -> Recording:
    return read_lego(path, sequence=sequence, platform=platform)


FORMAT = Format(
    "LEGO robot folder (files of M and S lines)",
    is_folder=True,
    recognise=lambda path: bool(lego_sequences(path)),
    read=_read,
)
