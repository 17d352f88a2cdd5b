"""A recording from an MCAP file that is still being written."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

from moteslam.robot.formats.bags.bag import Bag, Topic
from moteslam.robot.formats.bags.choice import Chosen, choose
from moteslam.robot.formats.bags.mcap import GrowingMcap
from moteslam.robot.formats.bags.progress import Progress
from moteslam.robot.formats.bags.read import BagReading
from moteslam.robot.formats.format import Robot
from moteslam.robot.given_robot import GivenRobot
from moteslam.robot.issues import Issue
from moteslam.robot.ranges import CHUNK
from moteslam.robot.recording import Recording

FEW = 16
"""Scans whose ranges are read at a time while the file grows: SLAM wants the latest ones alone."""

_STREAMS = tuple(field.name for field in fields(Chosen))


class McapFollower:
    """Reads an MCAP file that is still being written; see `Follower`.

    Records are gone through once and the heads of messages read once. The streams are made of these anew at every
    poll: with an hour of 36 000 scans, 144 000 odometry messages and 360 000 of an IMU that costs 150 ms.

    Args:
        path: of the file, which exists.
        platform: as of `open_recording`.

    Raises:
        ConfigError: a ``platform.toml`` that is none.
    """

    def __init__(self, path: Path, platform: Robot) -> None:
        self._file, self._progress = GrowingMcap(path), Progress()
        self._given = GivenRobot.read(platform)
        self._held: dict[str, tuple[str, ...]] = {}

    def poll(self, *, last: bool = False) -> Recording | None:
        """See `Follower`."""
        if not self._file.go_on(last=last):
            return None
        bag = Bag(self._file.path, (self._file,))
        issues = list(bag.issues)
        chosen = self._chosen(bag, issues)
        chunk = CHUNK if last else FEW
        reading = BagReading(bag, chosen, self._given, issues, progress=self._progress, chunk=chunk)
        return None if reading.is_empty and not last else reading.recording()

    def _chosen(self, bag: Bag, issues: list[Issue]) -> Chosen:
        """The topics to read: those that were chosen first, though others have more messages now."""
        found: list[Issue] = []
        chosen = choose(bag, {}, found)
        if any(_names(chosen, stream) != names for stream, names in self._held.items()):
            found.clear()
            chosen = choose(bag, self._held, found)
            held = ", ".join(name for topics in self._held.values() for name in topics)
            found.append(
                Issue("topics-held", f"{bag.path.name}: {held} read on, though other topics have more messages")
            )
        self._held = {stream: names for stream in _STREAMS if (names := _names(chosen, stream))}
        issues.extend(found)
        return chosen


def _names(chosen: Chosen, stream: str) -> tuple[str, ...]:
    topics: tuple[Topic, ...] | Topic | None = getattr(chosen, stream)
    if topics is None:
        return ()
    return tuple(topic.name for topic in topics) if isinstance(topics, tuple) else (topics.name,)
