"""The ways in which a ROS bag comes: a ROS 1 file, a ROS 2 folder, and a single MCAP or SQLite file."""

from __future__ import annotations

from functools import partial

from moteslam.robot.formats import Format
from moteslam.robot.formats.bags.files import is_bag
from moteslam.robot.formats.bags.read import read_bag
from moteslam.robot.formats.bags.write import write_mcap, write_rosbag1, write_rosbag2

_format = partial(Format, is_folder=False, read=read_bag, read_topics=read_bag)

ROSBAG1 = _format("ROS 1 bag", recognise=partial(is_bag, kind="bag"), write=write_rosbag1, endings=(".bag",))
MCAP = _format("MCAP file of ROS", recognise=partial(is_bag, kind="mcap"), write=write_mcap, endings=(".mcap",))
DB3 = _format("SQLite file of ROS 2", recognise=partial(is_bag, kind="db3"))
ROSBAG2 = _format("ROS 2 bag (a folder with metadata.yaml)", is_folder=True, recognise=is_bag, write=write_rosbag2)
