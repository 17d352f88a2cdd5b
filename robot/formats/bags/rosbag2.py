"""ROS 2 bags: a folder with ``metadata.yaml`` and the files that it names, SQLite or MCAP."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path, PurePosixPath
from typing import Any

from moteslam.errors import InputError
from moteslam.robot.formats.bags.container import MAX_MESSAGE, Channel, Container, Indices, missing_extra, zstd
from moteslam.robot.formats.bags.database import Database
from moteslam.robot.formats.bags.mcap import Mcap
from moteslam.robot.yaml_table import read_yaml

METADATA = "metadata.yaml"

_TABLE = "rosbag2_bagfile_information"
_STORAGES: dict[str, Callable[[Path], Container]] = {"sqlite3": Database, "mcap": Mcap}
_MAX_BYTES = 4_000_000
_MAX_FILES = 10_000


def is_rosbag2(folder: Path) -> bool:
    """Whether a folder holds a ``metadata.yaml`` of a bag."""
    try:
        with (folder / METADATA).open("rb") as file:
            return _TABLE.encode() in file.read(4096)
    except OSError:
        return False


def open_rosbag2(folder: Path) -> tuple[Container, ...]:
    """The files of a bag, by their indices.

    Raises:
        InputError: a ``metadata.yaml`` that is none, that names files outside the folder or that are not there, a
            storage or compression not known here, or a file that is damaged.
    """
    path = folder / METADATA
    about = _metadata(path)
    storage = about.get("storage_identifier")
    if not isinstance(storage, str) or storage not in _STORAGES:
        known = " or ".join(_STORAGES)
        raise InputError(f"{str(storage)[:40]!r}, expected {known}", file=path, field="storage_identifier")
    mode = str(about.get("compression_mode") or "none").lower()
    packing = str(about.get("compression_format") or "")
    if mode == "file":
        problem = "files packed as a whole, expected plain ones: unpack them, and name them in metadata.yaml"
        raise InputError(problem, file=path, field="compression_mode")
    if mode not in ("none", "storage", "message") or (mode == "message" and packing != "zstd"):
        raise InputError(f"{mode[:20]} {packing[:20]}, expected zstd or none", file=path, field="compression_mode")
    names = about.get("relative_file_paths")
    if not isinstance(names, list) or not names or len(names) > _MAX_FILES:
        raise InputError("no list of files, expected one", file=path, field="relative_file_paths")
    files = [_inside(folder, name) for name in names]
    if len(set(files)) < len(files):
        raise InputError("a file twice, expected each once", file=path, field="relative_file_paths")
    opened = tuple(_STORAGES[storage](file) for file in files)
    return tuple(PackedMessages(container) for container in opened) if mode == "message" else opened


class PackedMessages:
    """A container whose messages are packed by Zstandard one by one; see `Container`."""

    def __init__(self, container: Container) -> None:
        self._container = container
        self.path, self.ros1, self.damage = container.path, container.ros1, container.damage
        self.channels: tuple[Channel, ...] = container.channels

    def payloads(self, places: Indices, at_most: Indices) -> Iterator[bytes]:
        """See `Container`."""
        whole = at_most * 0 + MAX_MESSAGE
        try:
            module = zstd()
        except ImportError as error:
            raise missing_extra(self.path) from error
        for data, most in zip(self._container.payloads(places, whole), at_most.tolist(), strict=True):
            try:
                yield module.ZstdDecompressor().decompress(data, max_length=most)
            except Exception as error:
                raise InputError(f"a message cannot be unpacked: {error}", file=self.path) from error


def _metadata(path: Path) -> dict[str, Any]:
    table = read_yaml(path, "the metadata of a ROS 2 bag", limit=_MAX_BYTES)
    about = table.get(_TABLE) if isinstance(table, dict) else None
    if not isinstance(about, dict):
        raise InputError("missing or no table", file=path, field=_TABLE)
    return about


def _inside(folder: Path, name: object) -> Path:
    """The file of that name in the folder; bags before version 4 name it with the folder before it.

    Raises:
        InputError: it lies, or a link leads, outside the folder; or it is not there.
    """
    path, field = folder / METADATA, "relative_file_paths"
    if not isinstance(name, str) or "\0" in name or "\\" in name:
        raise InputError(f"{str(name)[:80]!r}, expected the name of a file", file=path, field=field)
    relative = PurePosixPath(name)
    if relative.is_absolute() or ".." in relative.parts:
        raise InputError(f"{name[:80]!r} lies outside the folder, expected a file in it", file=path, field=field)
    found = next((file for file in (folder / relative, folder / relative.name) if file.is_file()), None)
    if found is None:
        raise InputError(f"{name[:80]!r} is not there, expected a file in the folder", file=path, field=field)
    if not found.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"{name[:80]!r} leads outside the folder, expected a file in it", file=path, field=field)
    return found
