"""Recordings of other people's robots: opened whatever their format (:func:`open_recording`), cut, written.

Other packages bring formats of their own as entry points ``moteslam.formats``.
"""

import warnings
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from math import inf
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import ConfigError, InputError
from moteslam.files import result_folder, staged_file
from moteslam.plugins import Plugins, PluginWarning
from moteslam.robot.platform import Platform
from moteslam.robot.platforms import bundled_platform
from moteslam.robot.recording import STREAMS, Images, LidarStream, Recording, RgbdStream, Stream
from moteslam.robot.values import Issue, expect_type

Robot = Platform | str | PathLike[str] | None
"""A robot, a ``platform.toml`` that overrides the format's own robot, or that one as it is."""

Topics = Mapping[str, tuple[str, ...]]
"""Of which topics of a bag the streams are: ``{"lidar": ("/scan",)}``; several lidars are merged to one."""


@dataclass(frozen=True)
class Format:
    """How a recording is stored, in a folder or a file."""

    name: str  # what it is called, and how to recognise it
    is_folder: bool
    recognise: Callable[[Path], bool]  # by the content of a file or folder; must not raise for any other
    read: Callable[[Path, str | int | None, Robot], Recording]  # of a path, a sequence and a platform
    read_topics: Callable[[Path, str | int | None, Robot, Topics], Recording] | None = None
    write: Callable[[Path, Recording], tuple[Issue, ...]] | None = None  # an issue for each thing it cannot hold
    endings: tuple[str, ...] = ()  # of the names of files, the first the usual one: ``.log``, ``.log.gz``


FORMATS: Plugins[Format] = Plugins(
    "moteslam.formats",
    Format,
    bundled={
        "ucsd": "moteslam.robot.formats.ucsd:FORMAT",
        "carmen": "moteslam.robot.formats.carmen:FORMAT",
        "csv": "moteslam.robot.formats.csv_log:FORMAT",
        "bag": "moteslam.robot.formats.bags:ROSBAG1",
        "rosbag2": "moteslam.robot.formats.bags:ROSBAG2",
        "mcap": "moteslam.robot.formats.bags:MCAP",
        "db3": "moteslam.robot.formats.bags:DB3",
    },
)
"""By name, asked in this order, those of other packages last."""


def open_recording(
    path: str | PathLike[str],
    *,
    sequence: str | int | None = None,
    platform: Robot = None,
    topics: Topics | None = None,
    streams: Collection[str] = (),
) -> Recording:
    """Read a recording, a file or a folder of any format, known by the content, not by the name.

    Args:
        path: of the recording.
        sequence: which of several, where the format holds several; of a bag whose clock was set the session, from 1 on.
        platform: the robot, or the name of a bundled one, instead of what the recording (or the format) states; or a
            ``platform.toml`` that lies over that key by key.
        topics: of a bag, which of its topics a stream is read from; by their types where it is left out.
        streams: of a bag, the only ones that are read, ``lidar``, ``odometry`` and so on; all if empty. What is wrong
            with the others does not matter then.
    """
    known, path = format_of(path), Path(path)
    if isinstance(platform, str | PathLike):
        file = Path(platform)
        if file.name == str(platform) and file.suffix != ".toml" and not file.exists():
            platform = bundled_platform(file.name)
    if streams and known.read_topics is not None:
        topics = {**dict.fromkeys(set(STREAMS) - set(streams), ()), **(topics or {})}
    if not topics:
        return known.read(path, sequence, platform)
    if known.read_topics is None:
        raise InputError(f"a {known.name} has no topics, expected no names of topics", file=path, field="topics")
    return known.read_topics(path, sequence, platform, topics)


def expect_no_sequence(path: str | PathLike[str], sequence: str | int | None) -> None:
    """Refuse the name of a sequence of a format that holds one a file."""
    if sequence is not None:
        raise InputError("a log of one sequence, expected no name of one", file=path, field="sequence")


def write_recording(path: str | PathLike[str], recording: Recording, *, to: str | None = None) -> tuple[Issue, ...]:
    """Write a recording, whole or not at all, in a format named or that the ending of its new name stands for.

    A file is replaced with those that its format puts beside it; a folder is made, and must be empty if it is there.
    What the format cannot hold is returned, an issue each.
    """
    expect_type(recording, Recording, "recording", "open_recording(path) reads one")
    _, known = format_to_write(path, to)
    assert known.write is not None
    path = Path(path)
    if not known.is_folder:
        with staged_file(path, force=True) as file:
            return known.write(file, recording)
    with result_folder(path, force=path.is_dir() and not any(path.iterdir())) as folder:
        return known.write(folder, recording)


def format_to_write(path: str | PathLike[str], name: str | None = None) -> tuple[str, Format]:
    """The name of a format and the format itself: the one named, or the one that the ending of a path stands for."""
    written = {each: known for each, known in FORMATS.items() if known.write is not None}
    if name is not None:
        if name not in written:
            found = f"{name!r} is only read" if name in FORMATS.names() else repr(name)
            raise ConfigError(f"{found}, expected one of {', '.join(written)}", field="to")
        return name, written[name]
    for each, known in written.items():
        if Path(path).name.lower().endswith(known.endings):
            return each, known
    endings = ", ".join(ending for known in written.values() for ending in known.endings)
    folders = " or ".join(each for each, known in written.items() if known.is_folder)
    problem = f"{Path(path).name!r} has the ending of no format, expected one of {endings}, or {folders} to be named"
    raise ConfigError(problem, field="to")


def format_of(path: str | PathLike[str]) -> Format:
    """The format of a recording, by the beginning of its content."""
    path = Path(path)
    try:
        is_folder, size = path.is_dir(), path.stat().st_size
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{reason}, expected a recording", file=path) from error
    if not is_folder and (not path.is_file() or not size):
        problem = "is empty" if path.is_file() else "neither a file nor a folder"
        raise InputError(f"{problem}, expected a recording", file=path)
    if found := _recognised(path, is_folder):
        return found
    names = ", ".join(name for name, known in FORMATS.items() if known.is_folder == is_folder)
    problem = f"not a recording known here, expected {'a folder' if is_folder else 'a file'} of one of {names}"
    if is_folder:
        with suppress(OSError):
            children = sorted(path.iterdir(), key=lambda child: (not child.is_dir(), child))[:100]
            if inside := next((child for child in children if _recognised(child, child.is_dir())), None):
                problem = f"a folder with recordings in it, expected one of them, as {inside}"
    elif around := _recognised(path.absolute().parent, True):
        problem = f"part of a {around.name}, expected the folder it is in"
    raise InputError(problem, file=path)


def _recognised(path: Path, is_folder: bool) -> Format | None:
    """The format of a path, if any; one of another package that fails to say is left out."""
    for name, known in FORMATS.items():  # those after the one that it is are not even imported
        try:
            if known.is_folder == is_folder and known.recognise(path):
                return known
        except Exception as error:
            if FORMATS.is_bundled(name):
                raise
            warnings.warn(f"format {name!r} is left out: {type(error).__name__}: {error}", PluginWarning, stacklevel=3)
    return None


@dataclass(frozen=True)
class Cut:
    """Which part of a recording: start and end are seconds after its first stamp."""

    start: float = 0.0
    end: float = inf
    every: int = 1  # keep every n-th scan
    streams: tuple[str, ...] = ()  # that are kept; all if empty

    def __post_init__(self) -> None:
        if not 0 <= self.start < inf:
            raise ConfigError(f"{self.start:g} s, expected a finite time of at least 0", field="start")
        if not self.end > self.start:
            raise ConfigError(f"{self.end:g} s, expected more than start, {self.start:g} s", field="end")
        if self.every < 1:
            raise ConfigError(f"{self.every}, expected at least 1", field="every")
        for name in self.streams:
            if name not in STREAMS:
                raise ConfigError(f"{name!r}, expected some of {', '.join(STREAMS)}", field="streams")


def cut(recording: Recording, part: Cut) -> Recording:
    """The readings of a part of a recording; stamps stay as they are, and ranges and images where they are.

    Of the two images of a camera frame each is kept by its own stamp. A stream of which nothing is left is None.
    """
    expect_type(recording, Recording, "recording", "open_recording(path) reads one")
    if part == Cut():
        return recording
    present = {name: stream for name in STREAMS if (stream := getattr(recording, name)) is not None}
    kept = {name: stream for name, stream in present.items() if not part.streams or name in part.streams}
    if not kept:
        problem = f"no {' or '.join(part.streams)}, expected one of the streams it has: {', '.join(present) or 'none'}"
        raise InputError(problem, file=recording.name, field="streams")
    stamps = [stamps for stream in present.values() for stamps in _stamps(stream) if len(stamps)]
    first = min((float(some[0]) for some in stamps), default=0.0)
    last = max((float(some[-1]) for some in stamps), default=0.0)
    parts = {name: _within(stream, first + part.start, first + part.end, part.every) for name, stream in kept.items()}
    parts = {name: stream for name, stream in parts.items() if any(len(some) for some in _stamps(stream))}
    if not parts:
        problem = f"no reading from {part.start:g} to {part.end:g} s, expected times within its {last - first:.6g} s"
        raise InputError(problem, file=recording.name, field="start")
    return recording.replace(**{name: parts.get(name) for name in STREAMS})


def _stamps(stream: Stream | RgbdStream) -> list[NDArray[np.float64]]:
    return [stream.rgb_stamps, stream.disparity_stamps] if isinstance(stream, RgbdStream) else [stream.stamps]


def _within(stream: Stream | RgbdStream, begin: float, end: float, every: int) -> Stream | RgbdStream:
    """The readings of a stream from one time to another [s], both included; of scans, every n-th."""
    inside = [np.flatnonzero((stamps >= begin) & (stamps <= end)) for stamps in _stamps(stream)]
    if isinstance(stream, RgbdStream):
        (rgb, disparity), images = inside, stream.images
        some = images and Images(lambda k: images.rgb(int(rgb[k])), lambda k: images.disparity(int(disparity[k])))
        return RgbdStream(
            stream.rgb_stamps[rgb],
            stream.disparity_stamps[disparity],
            tuple(stream.rgb_files[index] for index in rgb if stream.rgb_files),
            tuple(stream.disparity_files[index] for index in disparity if stream.disparity_files),
            some,
        )
    return stream.take(inside[0][:: every if isinstance(stream, LidarStream) else 1])
