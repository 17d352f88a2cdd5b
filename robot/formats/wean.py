"""Logs of CMU's Wean Hall (``robotdata1.log``), of the localisation exercise of the course 16-833.

``O x y theta stamp``: the robot's odometry.
``L x y theta laser_x laser_y laser_theta r1..r180 stamp``: a scan, with the odometry poses of robot and laser, from
right to left over 180 degrees.
Centimetres, radians and seconds. Source: ``instruct.txt``, which comes with the logs.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from functools import partial
from os import PathLike
from pathlib import Path

import numpy as np

from moteslam.robot.formats.carmen_lines import fov_of
from moteslam.robot.formats.format import Format, Robot, one_sequence
from moteslam.robot.formats.no_return import no_return_limit
from moteslam.robot.formats.streams import Fan, lidar_stream, mount_between, odometry_stream
from moteslam.robot.formats.text import TextLines
from moteslam.robot.formats.words import (
    are_numbers,
    begins_with,
    broken_issues,
    expect_stamp,
    expect_words,
    finite_numbers,
    numbers,
    parse_words,
    pose_of,
)
from moteslam.robot.given_robot import GivenRobot
from moteslam.robot.platform import Platform
from moteslam.robot.recording import Recording
from moteslam.robot.specs import LidarSpec

BEAMS = 180
ODOMETRY_WORDS = 5
SCAN_WORDS = 8 + BEAMS
CENTIMETRE = 0.01

ROBOT = Platform(name="wean", lidar=LidarSpec(x=0.25))
"""``instruct.txt``: the laser stands about 25 cm before the robot's centre; the logged poses say it exactly."""


def is_wean(path: Path) -> bool:
    """Whether a file, plain or gzip, begins with ``O`` lines of 4 numbers or ``L`` lines of 187."""
    return begins_with(path, _is_entry)


def _is_entry(words: Sequence[bytes]) -> bool:
    return {b"O": ODOMETRY_WORDS, b"L": SCAN_WORDS}.get(words[0]) == len(words) and are_numbers(words[1:])


def read_wean(path: str | PathLike[str], *, platform: Robot = None) -> Recording:
    """Read a Wean Hall log.

    No return is found as in a CARMEN log that states no limit. Broken lines are dropped and counted, as long as there
    are no more than 3 of them or a tenth of the log.

    Args:
        path: the log.
        platform: the robot, or a ``platform.toml`` whose keys override what the log gives.

    Returns:
        a recording with ``lidar`` (and in it the odometry pose at every scan) and ``odometry``, each where the log
        has it.

    Raises:
        InputError: nothing usable in it, too much broken, or absurd stamps.
    """
    path = Path(path)
    odometry, scans, values = array("d"), array("d"), array("f")
    lines = TextLines(path)
    parsers = {b"O": partial(_odometry, odometry), b"L": partial(_scan, scans, values)}
    broken = parse_words(lines, parsers)
    poses = np.array(odometry, np.float64).reshape(-1, 4)
    rows = np.array(scans, np.float64).reshape(-1, 7)
    ranges = np.array(values, np.float32).reshape(-1, BEAMS)
    issues = broken_issues(lines, broken, len(poses) + len(rows), "no O or L line, expected a Wean Hall log")
    given = GivenRobot.read(platform)
    mount = mount_between(rows[:, :3], rows[:, 3:6]) or ROBOT.lidar
    robot = given.over(ROBOT.model_copy(update={"lidar": mount}))
    lidar = None
    if len(rows):
        figures = given.lidar_figures
        range_max = figures.get("range_max") or no_return_limit(ranges, None)
        lidar = lidar_stream(
            path,
            "L",
            stamps=rows[:, 6],
            ranges=ranges,
            fan=Fan(*fov_of(BEAMS), 0.0, range_max),
            robot=robot,
            given=figures,
            issues=issues,
            odometry=rows[:, :3],
        )
    return Recording(
        name=path.name.removesuffix(".gz").removesuffix(".log"),
        platform=robot,
        lidar=lidar,
        odometry=odometry_stream(path, "O", poses[:, 3], poses[:, :3], issues),
        warnings=tuple(issues),
    )


def _odometry(poses: array[float], words: Sequence[bytes], number: int) -> None:
    expect_words(words, ODOMETRY_WORDS, "odometry")
    poses.extend([*pose_of(words[1:4], metres=CENTIMETRE), expect_stamp(finite_numbers(words[4:])[0])])


def _scan(scans: array[float], values: array[float], words: Sequence[bytes], number: int) -> None:
    expect_words(words, SCAN_WORDS, f"a scan of {BEAMS} ranges")
    row = [*pose_of(words[1:7], metres=CENTIMETRE), expect_stamp(finite_numbers(words[-1:])[0])]
    values.extend(array("f", [value * CENTIMETRE for value in numbers(words[7:-1])]))
    scans.extend(row)


FORMAT = Format(
    "Wean Hall log (O and L lines in centimetres)",
    is_folder=False,
    recognise=is_wean,
    read=one_sequence("a Wean Hall log", read_wean),
)
