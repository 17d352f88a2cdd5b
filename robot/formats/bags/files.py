"""The files of a bag: a single one by its content, those that ``metadata.yaml`` names, or the parts of a recording."""

from __future__ import annotations

import re
import shutil
import sqlite3
import tempfile
import weakref
from collections.abc import Collection, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path

from moteslam.errors import InputError
from moteslam.robot.files import open_regular, read_yaml
from moteslam.robot.formats.bags.records import (
    MAX_CHUNK,
    Channel,
    Mcap,
    Message,
    Place,
    Rosbag1,
    Storage,
    damage_in_one_line,
    zstd,
)
from moteslam.robot.values import Issue

METADATA, _TABLE = "metadata.yaml", "rosbag2_bagfile_information"
MAX_RATIO = 1000
"""No file of a recording is packed tighter."""
MAGICS = {b"#ROSBAG V": "bag", b"\x89MCAP0\r\n": "mcap", b"SQLite format 3\0": "db3"}
_MAX_FILES = 10_000
_PART = re.compile(r"(?P<stem>.*)_(?P<number>\d+)\.(?P<ending>mcap|db3|bag)")


def open_files(path: Path, owner: object, issues: list[Issue]) -> list[Storage]:
    """The files of the bag at a path; what had to be unpacked is there as long as its owner."""
    if not path.is_dir():
        return [_open_file(path)]
    if not _has_metadata(path):
        return [_open_file(part) for part in _parts(path, issues)]
    with damage_in_one_line(path):
        return _named(path, owner)


def is_bag(path: Path, kind: str | None = None) -> bool:
    """Whether a path is a bag: a file, of a kind if one is named (of SQLite one that has the tables of a bag), or a
    folder that holds a ``metadata.yaml`` or the parts of a single recording.
    """
    try:
        if path.is_dir():
            return _has_metadata(path) or bool(_parts(path, []))
        begins = path.is_file() and begins_as(path)
        return bool(begins) and kind in (None, begins) and (begins != "db3" or bool(_open_file(path)))
    except (InputError, OSError, ValueError):
        return False


def begins_as(path: Path) -> str | None:
    """The kind of bag that a file begins as: ``bag``, ``mcap`` or ``db3``."""
    try:
        with path.open("rb") as file:
            start = file.read(16)
    except OSError:
        return None
    return next((kind for magic, kind in MAGICS.items() if start.startswith(magic)), None)


def _open_file(path: Path) -> Storage:
    """A file by its content."""
    open_regular(path, "a ROS bag").close()
    kind = begins_as(path)
    if kind is None:
        raise InputError("does not begin as a ROS bag, an MCAP or a SQLite file", file=path)
    with damage_in_one_line(path):
        return _STORAGES[kind](path)


def _temporary_folder(owner: object) -> Path:
    """A folder that is there as long as its owner."""
    path = Path(tempfile.mkdtemp(prefix="moteslam-"))
    weakref.finalize(owner, shutil.rmtree, path, ignore_errors=True)
    return path


class Database(Storage):
    """A SQLite file of ROS 2: the tables ``topics`` and ``messages`` of rosbag2's storage sqlite3.

    With a ``-wal`` beside it, of a recorder that was killed, a copy of both is read: SQLite writes when it opens them.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._file = path
        beside = path.with_name(path.name + "-wal")
        if beside.is_file() and beside.stat().st_size:
            self._file = _temporary_folder(self) / "copy.db3"
            shutil.copyfile(path, self._file)
            shutil.copyfile(beside, self._file.with_name("copy.db3-wal"))
            with closing(sqlite3.connect(self._file)) as connection:
                connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
            self.damage = f"the recorder was killed: {beside.name} is read with it"
        with self._opened() as connection:
            query = "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND name IN ('topics', 'messages')"
            if connection.execute(query).fetchone() != (2,):  # a view would run what the file says
                raise InputError("no tables topics and messages, expected those of a ROS 2 bag", file=path)
            query = "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
            for number, name, kind, encoding in connection.execute(query):
                self.channels[number] = Channel(str(name), str(kind).replace("/msg/", "/"), "", str(encoding))

    @contextmanager
    def _opened(self) -> Iterator[sqlite3.Connection]:
        """The file, read alone; no value in it is longer than a chunk."""
        uri = f"{self._file.absolute().as_uri()}?mode=ro&immutable=1"
        with damage_in_one_line(self.path), closing(sqlite3.connect(uri, uri=True)) as connection:
            connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_CHUNK)
            connection.execute("PRAGMA trusted_schema = OFF")
            yield connection

    def totals(self) -> Mapping[int, int]:
        """See `Storage`."""
        with self._opened() as connection:
            return dict(connection.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id").fetchall())

    def messages(self, channels: Collection[int]) -> Iterator[Message]:
        """See `Storage`."""
        among = ", ".join(str(int(channel)) for channel in channels)
        query = f"SELECT topic_id, timestamp, id, data FROM messages WHERE topic_id IN ({among}) ORDER BY id"
        with self._opened() as connection:
            for channel, received, row, data in connection.execute(query):
                yield channel, int(received), (0, int(row), 0), bytes(data)

    def payloads(self, places: Collection[Place]) -> Iterator[bytes]:
        """See `Storage`."""
        with self._opened() as connection:
            for _, row, _ in places:
                (data,) = connection.execute("SELECT data FROM messages WHERE id = ?", (int(row),)).fetchone()
                yield bytes(data)


_STORAGES: dict[str, type[Rosbag1 | Mcap | Database]] = {"bag": Rosbag1, "mcap": Mcap, "db3": Database}


def _named(folder: Path, owner: object) -> list[Storage]:
    """The files that ``metadata.yaml`` names."""
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
    files = [folder / Path(str(name)).name for name in names]  # bags before version 4 have the folder before it
    if missing := [file for file in files if not file.is_file() or file.resolve().parent != folder.resolve()]:
        problem = f"{missing[0].name[:80]!r}, expected the name of a file in the folder"
        raise InputError(problem, file=path, field="relative_file_paths")
    if mode == "file":
        place = _temporary_folder(owner)
        files = [_unpack(file, place / f"{index}_{file.stem}") for index, file in enumerate(files)]
    opened = [_open_file(file) for file in files]
    for storage in opened:
        storage.packed = mode == "message"
    return opened


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


def _parts(folder: Path, issues: list[Issue]) -> list[Path]:
    """The parts ``name_0.mcap``, ``name_1.mcap`` of the only recording in a folder, in order; else an empty list."""
    try:
        files = [file for _, file in zip(range(_MAX_FILES), folder.iterdir(), strict=False) if begins_as(file)]
    except OSError:
        return []
    known = [(part, file) for file in files if (part := _PART.fullmatch(file.name))]
    found = sorted((int(part["number"]), file) for part, file in known)
    names = {(part["stem"], part["ending"]) for part, _ in known}
    if len(names) != 1 or len(found) < len(files) or not all(map(is_bag, files)):
        return []
    parts = [file for _, file in found]
    missing = {*range(min(found[-1][0], _MAX_FILES))} - {number for number, _ in found}
    text = f"{folder.name}: no metadata.yaml; {', '.join(part.name for part in parts[:4])}"
    text += f"{' and others' if len(parts) > 4 else ''} are read as one recording"
    issues.append(Issue("no-metadata", text + (f"; {len(missing)} are missing" if missing else ""), len(parts)))
    return parts
