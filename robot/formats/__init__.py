"""Recordings of other people's robots, one file a format, all behind :func:`open_recording`."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping
from os import PathLike
from pathlib import Path

from moteslam.errors import ConfigError, InputError
from moteslam.plugins import PluginWarning
from moteslam.robot.files import result_folder, staged_file
from moteslam.robot.formats.format import FORMATS, Format, Robot, Topics
from moteslam.robot.platform import Platform
from moteslam.robot.platforms import bundled_platform
from moteslam.robot.recording import Recording
from moteslam.robot.values import Issue, expect_type

__all__ = [
    "FORMATS",
    "Format",
    "Robot",
    "Topics",
    "format_of",
    "format_to_write",
    "open_recording",
    "write_recording",
]

_FILES = 100
"""Of a folder that are looked into for a log."""


def open_recording(
    path: str | PathLike[str],
    *,
    sequence: str | int | None = None,
    platform: Robot = None,
    topics: Topics | None = None,
    streams: Collection[str] = (),
) -> Recording:
    """Read a recording, whatever its format: it is known by the content, not by the name.

    Args:
        path: a file or folder.
        sequence: which of several, where the format holds several; of a bag whose clock was set the session, from 1 on.
        platform: the robot, or the name of a bundled one, instead of what the recording (or the format) states; or a
            ``platform.toml`` that lies over that key by key.
        topics: of a bag, which of its topics a stream is read from; by their types where it is left out.
        streams: of a bag, the only ones that are read, ``lidar``, ``odometry`` and so on; all if empty. What is wrong
            with the others does not matter then.

    Raises:
        InputError: nothing there, no format known here, topics of a format that has none, or a recording that is
            broken; one line says which.
        ConfigError: a ``platform.toml`` that is none.
    """
    platform = _bundled_or_file(platform)
    known = format_of(path)
    if streams and known.read_topics is not None:
        left = {"lidar", "odometry", "imu", "encoders", "rgbd"} - set(streams)
        topics = {
            **dict.fromkeys(left - {"rgbd"} | ({"rgb", "depth"} if "rgbd" in left else set()), ()),
            **(topics or {}),
        }
    if not topics:
        return known.read(Path(path), sequence, platform)
    if known.read_topics is None:
        raise InputError(f"a {known.name} has no topics, expected none to be named", file=path, field="topics")
    return known.read_topics(Path(path), sequence, platform, topics)


def write_recording(path: str | PathLike[str], recording: Recording, *, to: str | None = None) -> tuple[Issue, ...]:
    """Write a recording in the format that the ending of its new name stands for, whole or not at all.

    Args:
        path: a file, which is replaced with those that its format puts beside it, or a folder, which is made.
        recording: any.
        to: the name of the format, where the ending does not say it.

    Returns:
        what the format cannot hold, an issue each.

    Raises:
        ConfigError: no such format, or one that is only read.
        InputError: the format cannot hold such a recording at all.
        ExistsError: a folder that holds something already, or a file beside a new one that belongs to something else.
        OutputError: it cannot be written.
    """
    expect_type(recording, Recording, "recording", "open_recording(path) reads one")
    _, known = format_to_write(path, to)
    assert known.write is not None
    path = Path(path)
    if not known.is_folder:
        with staged_file(path, force=True) as file:
            return known.write(file, recording)
    with result_folder(path, force=_is_empty(path)) as folder:
        return known.write(folder, recording)


def _is_empty(folder: Path) -> bool:
    try:
        return next(folder.iterdir(), None) is None
    except OSError:
        return False


def format_to_write(path: str | PathLike[str], name: str | None = None) -> tuple[str, Format]:
    """The name of a format and the format itself: the one named, or the one that the ending of a path stands for.

    Raises:
        ConfigError: no such format, one that is only read, or an ending that stands for none; its field is ``to``.
    """
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
    """The format of a recording, by the beginning of its content.

    Raises:
        InputError: nothing there, or no format known here; one line says which.
    """
    path = Path(path)
    try:
        is_folder = path.is_dir()
        empty = not is_folder and path.stat().st_size == 0 and path.is_file()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{reason}, expected a recording", file=path) from error
    if not is_folder and not path.is_file():
        raise InputError("neither a file nor a folder, expected a recording", file=path)
    if empty:
        raise InputError("is empty, expected a recording", file=path)
    for name, known in FORMATS.items():  # those after the one that it is are not even imported
        if known.is_folder == is_folder and _recognises(name, known, path):
            return known
    formats = dict(FORMATS.items())
    if is_folder and (inside := _first_inside(path, formats)) is not None:
        raise InputError(f"a folder with recordings in it, expected one of them, as {inside}", file=path)
    if not is_folder and _holds_arrays(path):
        raise InputError("holds NumPy arrays, expected the folder it is in, with all files of the recording", file=path)
    for name, known in formats.items():
        if known.is_folder and not is_folder and _recognises(name, known, path.absolute().parent):
            raise InputError(f"part of a {known.name}, expected the folder it is in", file=path)
    kind = [name for name, known in formats.items() if known.is_folder == is_folder]
    what = "folder" if is_folder else "file"
    raise InputError(f"not a recording known here, expected a {what} of one of {', '.join(kind)}", file=path)


def _bundled_or_file(platform: Robot) -> Robot:
    """The bundled robot, where a robot is given by a bare name that is no file's."""
    if platform is None or isinstance(platform, Platform):
        return platform
    file = Path(platform)
    is_name = file.name == str(platform) and file.suffix != ".toml" and not file.exists()
    return bundled_platform(file.name) if is_name else platform


def _recognises(name: str, known: Format, path: Path) -> bool:
    """Whether a path is of a format; a format of another package that fails to say is left out."""
    try:
        return known.recognise(path)
    except Exception as error:
        if FORMATS.is_bundled(name):
            raise
        warnings.warn(f"format {name!r} is left out: {type(error).__name__}: {error}", PluginWarning, stacklevel=3)
        return False


def _first_inside(folder: Path, formats: Mapping[str, Format]) -> Path | None:
    """The first recording within a folder: a folder, as of ``simulate --batch``, else one of the first files, a log."""
    try:
        children = sorted(folder.iterdir())
    except OSError:
        return None
    folders = [child for child in children if child.is_dir()]
    files = [child for child in children if child.is_file()][:_FILES]
    for is_folder, found in ((True, folders), (False, files)):
        kinds = [(name, known) for name, known in formats.items() if known.is_folder == is_folder]
        for child in found:
            if any(_recognises(name, known, child) for name, known in kinds):
                return child
    return None


def _holds_arrays(path: Path) -> bool:
    """Whether a file is an ``.npy`` or ``.npz``, by its first bytes."""
    try:
        with path.open("rb") as file:
            return file.read(6).startswith((b"\x93NUMPY", b"PK\x03\x04"))
    except OSError:
        return False
