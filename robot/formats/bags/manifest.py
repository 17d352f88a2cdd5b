"""What this package writes into a bag beside the messages: the robot, and the figures that messages round.

A ``std_msgs/String`` on one topic, a TOML text: which streams the recording had (the others were computed for those
who play the bag), its platform, and the scans' figures, which ``sensor_msgs/LaserScan`` holds as float32 only.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from typing import Any

import numpy as np
import tomli_w

from moteslam.errors import ConfigError, InputError
from moteslam.robot.formats.bags.bag import Bag
from moteslam.robot.formats.streams import Fan
from moteslam.robot.platform import Platform
from moteslam.robot.platforms import platform_of, platform_table
from moteslam.robot.recording import Recording
from moteslam.robot.tables import Table

TOPIC, KIND = "/moteslam/recording", "std_msgs/String"
MAX_LETTERS = 1 << 20
STREAMS = ("lidar", "encoders", "odometry", "imu", "rgbd")
FIGURES = ("angle_min", "angle_increment", "range_min", "range_max", "time_increment")


@dataclass(frozen=True)
class Manifest:
    """What a bag says about the recording that it was written from: its streams, robot and figures of the scans."""

    streams: tuple[str, ...]
    platform: Platform
    scan: Table

    def sharpened(self, fan: Fan) -> Fan:
        """The fan with the figures that the messages round, wherever they round to those of the messages."""
        exact: dict[str, Any] = {name: value for name in FIGURES if isinstance(value := self.scan.get(name), float)}
        rounded = {name: np.float32(getattr(fan, name)) for name in exact}
        return fan._replace(**{name: value for name, value in exact.items() if np.float32(value) == rounded[name]})


def manifest_of(recording: Recording, *, with_odometry: bool) -> str:
    """The text for a recording; ``with_odometry`` where that of the bag was not computed."""
    lidar = recording.lidar
    has = {name: with_odometry if name == "odometry" else getattr(recording, name) is not None for name in STREAMS}
    table: Table = {
        "streams": [name for name in STREAMS if has[name]],
        "scan": {} if lidar is None else {name: float(getattr(lidar, name)) for name in FIGURES},
        "platform": platform_table(recording.platform),
    }
    return tomli_w.dumps(table)


def read_manifest(bag: Bag) -> Manifest | None:
    """What a bag says about its recording; None of a bag that this package did not write."""
    topic = next((topic for topic in bag.of_kind(KIND) if topic.name == TOPIC), None)
    if topic is None:
        return None
    try:
        _, _, _, data = next(bag.sweep([topic]))
        if len(text := bag.decode(topic, data).data) > MAX_LETTERS:
            raise ValueError(f"{len(text)} letters")
        table = tomllib.loads(text)
        streams, scan, robot = table["streams"], table["scan"], table["platform"]
        if not isinstance(streams, list) or not isinstance(scan, dict) or not isinstance(robot, dict):
            raise ValueError("another table")
        return Manifest(tuple(name for name in STREAMS if name in streams), platform_of(robot, file=bag.path), scan)
    except (ValueError, KeyError, RecursionError, StopIteration, ConfigError) as error:
        problem = f"{' '.join(str(error).split())[:200]}, expected the description of a recording"
        raise InputError(problem, file=bag.path, field=TOPIC) from error
