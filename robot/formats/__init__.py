"""Recordings of other people's robots, one file a format, all behind :func:`open_recording`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from moteslam.errors import InputError
from moteslam.robot.formats.carmen import is_carmen, read_carmen
from moteslam.robot.formats.ucsd import read_ucsd, ucsd_sequences
from moteslam.robot.platform import Platform
from moteslam.robot.recording import Recording

__all__ = ["FORMATS", "Format", "open_recording"]


Robot = Platform | str | PathLike[str] | None
"""A robot, a ``platform.toml`` that overrides the format's own robot, or that one as it is."""


@dataclass(frozen=True)
class Format:
    """A way to store a recording.

    Attributes:
        name: what it is called, and how to tell one by its looks.
        is_folder: whether a recording is a folder or a file.
        recognise: whether the content of a path (of that kind) is of this format; must not raise for any other.
        read: ``read(path, sequence, platform)``.
    """

    name: str
    is_folder: bool
    recognise: Callable[[Path], bool]
    read: Callable[[Path, str | int | None, Robot], Recording]


def _read_ucsd(path: Path, sequence: str | int | None, platform: Robot) -> Recording:
    return read_ucsd(path, sequence=sequence, platform=platform)


def _read_carmen(path: Path, sequence: str | int | None, platform: Robot) -> Recording:
    if sequence is not None:
        raise InputError("a CARMEN log is one sequence, expected none to be chosen", file=path, field="sequence")
    return read_carmen(path, platform=platform)


FORMATS: tuple[Format, ...] = (
    Format(
        "UCSD folder (Encoders*.npz, Hokuyo*.npz, Imu*.npz, Kinect*.npz)",
        True,
        lambda path: bool(ucsd_sequences(path)),
        _read_ucsd,
    ),
    Format("CARMEN log (FLASER, ROBOTLASER1, ODOM lines; plain or gzip)", False, is_carmen, _read_carmen),
)
"""The formats known, asked in this order."""


def open_recording(
    path: str | PathLike[str], *, sequence: str | int | None = None, platform: Robot = None
) -> Recording:
    """Read a recording, whatever its format: it is known by the content, not by the name.

    Args:
        path: a file or folder.
        sequence: which of several, where the format holds several.
        platform: the robot, instead of what the recording (or the format) tells; or a ``platform.toml`` that overrides
            that key by key.

    Raises:
        InputError: nothing there, no format known here, or a recording that is broken; one line says which.
        ConfigError: a ``platform.toml`` that is none.
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
    for known in FORMATS:
        if known.is_folder == is_folder and known.recognise(path):
            return known.read(path, sequence, platform)
    names = " or a ".join(known.name for known in FORMATS)
    if not is_folder and _holds_arrays(path):
        raise InputError("holds NumPy arrays, expected the folder it is in, with all files of the recording", file=path)
    raise InputError(f"not a recording known here, expected a {names}", file=path)


def _holds_arrays(path: Path) -> bool:
    """Whether a file is an ``.npy`` or ``.npz``, by its first bytes."""
    try:
        with path.open("rb") as file:
            return file.read(6).startswith((b"\x93NUMPY", b"PK\x03\x04"))
    except OSError:
        return False
