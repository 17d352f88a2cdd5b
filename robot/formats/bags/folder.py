"""The files of a bag: a single one by its content, those that ``metadata.yaml`` names, or the parts of a recording."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

from moteslam.errors import InputError
from moteslam.robot.files import open_regular, read_yaml
from moteslam.robot.formats.bags.containers import (
    MAX_CHUNK,
    Container,
    Message,
    TemporaryFolder,
    damage_in_one_line,
    zstd,
)
from moteslam.robot.formats.bags.database import Database, is_bag_database
from moteslam.robot.formats.bags.mcap import Mcap
from moteslam.robot.formats.bags.rosbag1 import Rosbag1
from moteslam.robot.values import Issue

METADATA, _TABLE = "metadata.yaml", "rosbag2_bagfile_information"
MAX_RATIO = 1000
"""No file of a recording is packed tighter."""
MAGICS = {b"#ROSBAG V": "bag", b"\x89MCAP0\r\n": "mcap", b"SQLite format 3\0": "db3"}
_MAX_FILES = 10_000
_PART = re.compile(r"(?P<stem>.*)_(?P<number>\d+)\.(?P<ending>mcap|db3|bag)")


def open_files(path: Path, issues: list[Issue]) -> tuple[Container, ...]:
    """The files of the bag at a path.

    Raises:
        InputError: no bag, or one that is damaged.
    """
    with damage_in_one_line(path):
        return _folder(path, issues) if path.is_dir() else (open_container(path),)


def begins_as(path: Path) -> str | None:
    """The kind of bag that a file begins as, ``bag``, ``mcap`` or ``db3``, else None."""
    try:
        with path.open("rb") as file:
            start = file.read(16)
    except OSError:
        return None
    return next((kind for magic, kind in MAGICS.items() if start.startswith(magic)), None)


def open_container(path: Path) -> Container:
    """A file by its content.

    Raises:
        InputError: no file of a bag, or one that is damaged.
    """
    open_regular(path, "a ROS bag").close()
    kind = begins_as(path)
    if kind is None:
        raise InputError("does not begin as a ROS bag, an MCAP or a SQLite file", file=path)
    makers: dict[str, Callable[[Path], Container]] = {"bag": Rosbag1, "mcap": Mcap, "db3": Database}
    with damage_in_one_line(path):
        return makers[kind](path)


def _folder(folder: Path, issues: list[Issue]) -> tuple[Container, ...]:
    """The files that ``metadata.yaml`` names, or the parts of a recording whose recorder did not write one."""
    if not _has_metadata(folder):
        parts = parts_of(folder)
        if not parts:
            raise InputError("neither metadata.yaml nor parts of a recording, expected a ROS 2 bag", file=folder)
        numbers = [int(_PART.fullmatch(part.name)["number"]) for part in parts]  # type: ignore[index]
        missing = {*range(min(numbers[-1], _MAX_FILES))} - {*numbers}
        gaps = f"; {len(missing)} are missing" if missing else ""
        text = f"{folder.name}: no metadata.yaml; {', '.join(part.name for part in parts[:4])}"
        text += f"{' and others' if len(parts) > 4 else ''} are read as one recording{gaps}"
        issues.append(Issue("no-metadata", text, len(parts)))
        return tuple(open_container(part) for part in parts)
    path = folder / METADATA
    table = read_yaml(path, "the metadata of a ROS 2 bag", limit=4_000_000)
    about = table.get(_TABLE) if isinstance(table, dict) else None
    if not isinstance(about, dict):
        raise InputError("missing or no table", file=path, field=_TABLE)
    mode, packing = str(about.get("compression_mode") or "none").lower(), about.get("compression_format")
    if mode not in ("none", "storage") and (mode not in ("message", "file") or packing != "zstd"):
        raise InputError(f"{mode[:20]} {str(packing)[:20]}, expected zstd", file=path, field="compression_mode")
    names = about.get("relative_file_paths")
    if not isinstance(names, list) or not 0 < len(set(map(str, names))) == len(names) <= _MAX_FILES:
        raise InputError("no list of files, expected one", file=path, field="relative_file_paths")
    files = [_inside(folder, str(name)) for name in names]
    if mode != "file":
        opened: list[Container] = [open_container(file) for file in files]
    else:
        place = TemporaryFolder()
        unpacked = [_unpack(file, place.path / f"{index}_{file.stem}") for index, file in enumerate(files)]
        opened = [open_container(file) for file in unpacked]
        opened[0].temporary = place  # removed with it
    return tuple(opened) if mode != "message" else tuple(map(_PackedMessages, opened))


def _inside(folder: Path, name: str) -> Path:
    """The file of that name in the folder; bags before version 4 name it with the folder before it."""
    file, inside = folder / Path(name).name, not {"..", ""} & set(name.split("/"))
    inside = inside and not {"\0", "\\"} & set(name)
    if not inside or not file.is_file() or file.resolve().parent != folder.resolve():
        problem = f"{name[:80]!r}, expected the name of a file in the folder"
        raise InputError(problem, file=folder / METADATA, field="relative_file_paths")
    return file


class _PackedMessages:
    """A file whose messages are packed by Zstandard one by one; see `Container`."""

    def __init__(self, container: Container) -> None:
        self.path, self.ros1, self.damage = container.path, container.ros1, container.damage
        self.channels, self._container = container.channels, container
        self.temporary: TemporaryFolder | None = None

    def messages(self, channels: Collection[int]) -> Iterator[Message]:
        """See `Container`."""
        for message in self._container.messages(channels):
            yield message._replace(data=self._unpack(message.data))

    def payloads(self, places: Collection[tuple[int, int]]) -> Iterator[bytes]:
        """See `Container`."""
        yield from map(self._unpack, self._container.payloads(places))

    def _unpack(self, data: bytes) -> bytes:
        with damage_in_one_line(self.path):
            return bytes(zstd().ZstdDecompressor().decompress(data, max_length=MAX_CHUNK))


def _unpack(file: Path, into: Path) -> Path:
    """A file packed as a whole, unpacked."""
    limit = MAX_RATIO * file.stat().st_size
    with zstd().open(file, "rb") as packed, into.open("wb") as plain:
        while block := packed.read(1 << 20):
            plain.write(block)
            if plain.tell() > min(limit, shutil.disk_usage(into.parent).total // 2):
                raise InputError("unpacks to more than a recording does: unpack it with zstd -d", file=file)
    return into


def _has_metadata(folder: Path) -> bool:
    try:
        with (folder / METADATA).open("rb") as file:
            return _TABLE.encode() in file.read(4096)
    except OSError:
        return False


def is_bag_folder(folder: Path) -> bool:
    """Whether a folder holds the ``metadata.yaml`` of a bag, or the parts of a single one."""
    return _has_metadata(folder) or bool(parts_of(folder))


def parts_of(folder: Path) -> list[Path]:
    """The parts ``name_0.mcap``, ``name_1.mcap`` of the one recording in a folder, in order; else none."""
    try:
        files = [file for _, file in zip(range(_MAX_FILES), folder.iterdir(), strict=False) if begins_as(file)]
    except OSError:
        return []
    parts = [(found, file) for file in files if (found := _PART.fullmatch(file.name))]
    one = len({(found["stem"], found["ending"]) for found, _ in parts}) == 1 and len(parts) == len(files)
    if not one or any(file.suffix == ".db3" and not is_bag_database(file) for file in files):
        return []
    return [file for _, file in sorted(parts, key=lambda part: int(part[0]["number"]))]
