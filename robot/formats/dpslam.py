"""DP-SLAM logs (``loop5.log``): ``Odometry x y theta`` before every ``Laser n r1..rn``, metres and radians, no stamps.

Beams are those of a ``FLASER`` line of a CARMEN log. Source: the logs that A. Eliazar and R. Parr published with
DP-SLAM (people.duke.edu/~parr/dpslam, 2003).
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path

import numpy as np

from moteslam.robot.formats.carmen_lines import fov_of
from moteslam.robot.formats.format import Format, Robot, one_sequence
from moteslam.robot.formats.no_return import no_return_limit
from moteslam.robot.formats.streams import Fan, lidar_stream
from moteslam.robot.formats.text import TextLines
from moteslam.robot.formats.words import (
    are_numbers,
    begins_with,
    broken_issues,
    count_at,
    expect_words,
    numbers,
    parse_words,
    pose_of,
)
from moteslam.robot.given_robot import GivenRobot
from moteslam.robot.issues import Issue
from moteslam.robot.platform import Platform
from moteslam.robot.recording import Recording

ODOMETRY_WORDS = 4

PERIOD = 1.0
"""Between scans, which state no time [s]."""

ROBOT = Platform(name="dpslam")
"""A robot of which a log states nothing: odometry poses and a lidar at its centre."""


@dataclass
class _Log:
    """What a log says: the poses before the scans, flat [n * 3], and their ranges, flat [n * beams]."""

    poses: array[float] = field(default_factory=lambda: array("d"))
    ranges: array[float] = field(default_factory=lambda: array("f"))
    beams: int | None = None
    pose: list[float] | None = None

    def odometry(self, words: Sequence[bytes], number: int) -> None:
        """Keep a pose for the scan that follows."""
        self.pose = None
        expect_words(words, ODOMETRY_WORDS, "odometry")
        self.pose = pose_of(words[1:4])

    def scan(self, words: Sequence[bytes], number: int) -> None:
        """Keep a scan at the pose before it."""
        pose, self.pose = self.pose, None
        count = count_at(words, 1, "ranges")
        expect_words(words, 2 + count, f"{count} ranges")
        if pose is None:
            raise ValueError("a Laser line without odometry, expected an Odometry line before it")
        if count != (self.beams or count):
            raise ValueError(f"{count} ranges, expected {self.beams} as in the scans before it")
        self.ranges.extend(array("f", numbers(words[2:])))
        self.poses.extend(pose)
        self.beams = count


def is_dpslam(path: Path) -> bool:
    """Whether a file, plain or gzip, begins with an ``Odometry`` line of 3 numbers and a ``Laser`` line."""
    return begins_with(path, _is_entry, lines=2)


def _is_entry(words: Sequence[bytes]) -> bool:
    if words[0] == b"Odometry":
        return len(words) == ODOMETRY_WORDS and are_numbers(words[1:])
    return words[0] == b"Laser" and words[1:2] == [str(len(words) - 2).encode()] and are_numbers(words[2:])


def read_dpslam(path: str | PathLike[str], *, platform: Robot = None) -> Recording:
    """Read a DP-SLAM log.

    Scans state no time: they are one second apart, which an issue says. No return is found as in a CARMEN log that
    states no limit. Broken lines are dropped and counted, as long as there are no more than 3 of them or a tenth of
    the log.

    Args:
        path: the log.
        platform: the robot, or a ``platform.toml`` whose keys override what is known of it.

    Returns:
        a recording with ``lidar``, and in it the odometry pose at every scan.

    Raises:
        InputError: nothing usable in it, or too much broken.
    """
    path = Path(path)
    log = _Log()
    lines = TextLines(path)
    broken = parse_words(lines, {b"Odometry": log.odometry, b"Laser": log.scan})
    poses = np.array(log.poses, np.float64).reshape(-1, 3)
    issues = broken_issues(lines, broken, len(poses), "no Laser line, expected a DP-SLAM log")
    issues.append(Issue("no-stamps", f"{path.name}: scans without stamps; one second a scan is assumed"))
    beams = log.beams or 1
    ranges = np.array(log.ranges, np.float32).reshape(-1, beams)
    given = GivenRobot.read(platform)
    robot, figures = given.over(ROBOT), given.lidar_figures
    range_max = figures.get("range_max") or no_return_limit(ranges, None)
    return Recording(
        name=path.name.removesuffix(".gz").removesuffix(".log"),
        platform=robot,
        lidar=lidar_stream(
            path,
            "Laser",
            stamps=PERIOD * np.arange(len(poses)),
            ranges=ranges,
            fan=Fan(*fov_of(beams), 0.0, range_max),
            robot=robot,
            given=figures,
            issues=issues,
            odometry=poses,
        ),
        warnings=tuple(issues),
    )


FORMAT = Format(
    "DP-SLAM log (Odometry and Laser lines)",
    is_folder=False,
    recognise=is_dpslam,
    read=one_sequence("a DP-SLAM log", read_dpslam),
)
