"""The options of commands that read a recording: which sequence, topics and robot, and which part of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from moteslam.errors import ConfigError
from moteslam.eval.cli import options

if TYPE_CHECKING:
    from moteslam.robot.formats import Topics
    from moteslam.robot.recording import Recording

TOPIC_STREAMS = ("lidar", "odometry", "imu", "encoders", "rgb", "depth")
"""What a topic of a bag can be read as."""


@dataclass(frozen=True)
class RecordingOptions:
    """Which recording, and which part of it: each field is an option."""

    sequence: options.Sequence = None
    platform: options.PlatformFile = None
    topics: Annotated[
        list[str] | None,
        typer.Option(metavar="STREAM=TOPIC", help="Of a bag: the topic that a stream is read from; may be repeated."),
    ] = None
    streams: Annotated[
        str | None, typer.Option(metavar="NAMES", help="Keep these alone: lidar,encoders,odometry,imu,rgbd.")
    ] = None
    start: Annotated[float, typer.Option(metavar="S", help="Seconds after the first stamp.")] = 0.0
    end: Annotated[float | None, typer.Option(metavar="S", help="Seconds after the first stamp.")] = None
    every: Annotated[int, typer.Option(metavar="N", help="Keep every N-th scan.")] = 1

    def open(self, path: Path) -> Recording:
        """The part of the recording at a path that the options ask for.

        Raises:
            InputError: it cannot be read, or nothing is left of it.
            ConfigError: an option that is wrong; it is named.
        """
        from moteslam.robot.cut import Cut, cut
        from moteslam.robot.formats import open_recording

        try:
            streams = tuple(name.strip() for name in self.streams.split(",")) if self.streams is not None else ()
            part = Cut(self.start, inf if self.end is None else self.end, self.every, streams)
        except ConfigError as error:
            raise ConfigError(error.problem, field=f"--{error.field}") from error
        topics = topics_of(self.topics or ())
        recording = open_recording(path, sequence=self.sequence, platform=self.platform, topics=topics, streams=streams)
        return cut(recording, part)

    @property
    def about(self) -> dict[str, object]:
        """The part that was asked for, for ``run.json``; empty for the whole recording."""
        asked = {"topics": self.topics, "streams": self.streams, "start": self.start, "end": self.end}
        return {name: value for name, value in {**asked, "every": self.every}.items() if value not in (None, 0.0, 1)}

    @property
    def given(self) -> tuple[str, ...]:
        """The options that were given, as they are typed: ``--start``."""
        return tuple(f"--{field.name}" for field in fields(self) if getattr(self, field.name) != field.default)


def topics_of(given: Sequence[str]) -> Topics:
    """The topics of each stream: ``lidar=/scan`` or, to merge several lidars, ``lidar=/front,/back``.

    Raises:
        ConfigError: not of this form, no such stream, or one stream twice.
    """
    topics: dict[str, tuple[str, ...]] = {}
    for words in given:
        stream, _, names = words.partition("=")
        found = tuple(name.strip() for name in names.split(",") if name.strip())
        if stream not in TOPIC_STREAMS or not found:
            raise ConfigError(
                f"{words!r}, expected STREAM=TOPIC with a stream of {', '.join(TOPIC_STREAMS)}", field="--topics"
            )
        if stream in topics:
            raise ConfigError(f"{stream} twice, expected lidars to merge as lidar=/front,/back", field="--topics")
        topics[stream] = found
    return topics
