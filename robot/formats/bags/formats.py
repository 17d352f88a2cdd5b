"""The ways in which a ROS bag comes: a ROS 1 file, a ROS 2 folder, and a single MCAP or SQLite file."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from moteslam.robot.formats.bags.bag import begins_as
from moteslam.robot.formats.bags.database import is_bag_database
from moteslam.robot.formats.bags.read import read_bag
from moteslam.robot.formats.bags.rosbag2 import is_rosbag2
from moteslam.robot.formats.bags.write import write_mcap, write_rosbag1, write_rosbag2
from moteslam.robot.formats.format import Format, Robot, Topics, one_sequence
from moteslam.robot.recording import Recording

_read = one_sequence("a bag", read_bag)


def _read_topics(path: Path, sequence: str | int | None, platform: Robot, topics: Topics) -> Recording:
    return one_sequence("a bag", partial(read_bag, topics=topics))(path, sequence, platform)


ROSBAG1 = Format(
    "ROS 1 bag",
    is_folder=False,
    recognise=lambda path: begins_as(path) == "bag",
    read=_read,
    read_topics=_read_topics,
    write=write_rosbag1,
    endings=(".bag",),
)

ROSBAG2 = Format(
    "ROS 2 bag (a folder with metadata.yaml)",
    is_folder=True,
    recognise=is_rosbag2,
    read=_read,
    read_topics=_read_topics,
    write=write_rosbag2,
)

MCAP = Format(
    "MCAP file of ROS",
    is_folder=False,
    recognise=lambda path: begins_as(path) == "mcap",
    read=_read,
    read_topics=_read_topics,
    write=write_mcap,
    endings=(".mcap",),
)

DB3 = Format(
    "SQLite file of ROS 2",
    is_folder=False,
    recognise=lambda path: begins_as(path) == "db3" and is_bag_database(path),
    read=_read,
    read_topics=_read_topics,
)
