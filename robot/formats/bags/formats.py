"""The ways in which a ROS bag comes: a ROS 1 file, a ROS 2 folder, and a single MCAP or SQLite file."""

from __future__ import annotations

from functools import partial

from moteslam.robot.formats.bags.database import is_bag_database
from moteslam.robot.formats.bags.folder import begins_as, is_bag_folder
from moteslam.robot.formats.bags.read import read_bag
from moteslam.robot.formats.bags.write import write_mcap, write_rosbag1, write_rosbag2
from moteslam.robot.formats.format import Format

_file = partial(Format, is_folder=False, read=read_bag, read_topics=read_bag)

ROSBAG1 = _file("ROS 1 bag", recognise=lambda path: begins_as(path) == "bag", write=write_rosbag1, endings=(".bag",))
MCAP = _file("MCAP file of ROS", recognise=lambda path: begins_as(path) == "mcap", write=write_mcap, endings=(".mcap",))
DB3 = _file("SQLite file of ROS 2", recognise=lambda path: begins_as(path) == "db3" and is_bag_database(path))
ROSBAG2 = Format(
    "ROS 2 bag (a folder with metadata.yaml)",
    is_folder=True,
    recognise=is_bag_folder,
    read=read_bag,
    read_topics=read_bag,
    write=write_rosbag2,
)
