"""A bag: its files, gone through once, what is kept of their messages, and which of these are used."""

from __future__ import annotations

import re
import shutil
from array import array
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from backports import zstd
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.files import open_regular, read_yaml
from moteslam.robot.formats.bags.definitions import decode
from moteslam.robot.formats.bags.storage import (
    ZSTD,
    Database,
    Mcap,
    Rosbag1,
    Topic,
    damage_in_one_line,
    temporary_folder,
)
from moteslam.robot.formats.streams import MAX_DROPPED, Stamps, clock_cuts, sort_by_stamp
from moteslam.robot.values import Issue, counted

SECOND, FRACTION = 1_000_000_000, 1_000_000  # [ns]; a clock that shows no more than this beyond seconds counts these
MAX_MESSAGES = 20_000_000  # an hour of twenty streams at 250 Hz
GAP = 10  # a first stamp of 0 this many times the usual step before the next one is no time
MAX_RATIO = 1000  # no file of a recording is packed tighter
MAX_FILES = 10_000
METADATA, _INFORMATION = "metadata.yaml", "rosbag2_bagfile_information"
_MAGICS = {b"#ROSBAG V": "bag", b"\x89MCAP0\r\n": "mcap", b"SQLite format 3\0": "db3"}
_PART = re.compile(r"(?P<stem>.*)_(?P<number>\d+)\.(?P<ending>mcap|db3|bag)")
_STORAGES: dict[str, type[Rosbag1 | Mcap | Database]] = {"bag": Rosbag1, "mcap": Mcap, "db3": Database}

Rows = NDArray[np.intp]

HEAD = [("stamp", "i8"), ("received", "i8"), ("order", "i8"), ("place", "i8", 4), ("mark", "i8")]
"""What is kept of every message: the stamp of its header and when it came [ns], its number in the bag, where it lies
(file, and the place in it), and a checksum."""


@dataclass(eq=False)
class Table:
    """What is kept of the messages of a topic, in the order they were written.

    Attributes:
        take: gives the numbers that are kept of a message, ``width`` of them; raises a ValueError for a broken one.
        frame, child: of the first header, and of an odometry; ``others``, further frames.
        flat, numbers: of all messages, as `HEAD`, and flat [n * width].
        broken, problem: how many were, and what is wrong with the last of them.
        rows: of the session of the clock that is read, after `Bag.choose_session`.
    """

    topic: Topic
    take: Callable[[Any], tuple[float, ...]] = lambda _: ()
    width: int = 0
    frame: str = ""
    child: str = ""
    others: set[str] = field(default_factory=set)
    flat: array[int] = field(default_factory=lambda: array("q"))
    numbers: array[float] = field(default_factory=lambda: array("d"))
    broken: int = 0
    problem: str = ""
    rows: Rows = field(default_factory=lambda: np.empty(0, np.intp))

    def __len__(self) -> int:
        return len(self.flat) // 8

    @property
    def count(self) -> int:
        """Of messages, whole and broken."""
        return len(self) + self.broken

    @cached_property
    def heads(self) -> NDArray[Any]:
        """[n] of `HEAD`."""
        return np.frombuffer(self.flat, HEAD) if self.flat else np.empty(0, HEAD)

    @property
    def values(self) -> NDArray[np.float64]:
        """The numbers [n, width] of the messages."""
        return np.array(self.numbers).reshape(len(self), self.width)

    @cached_property
    def stamps(self) -> NDArray[np.int64]:
        """[n] [ns] of the headers, of reception where these have none or, on the same clock, whole seconds alone."""
        stamps, received = self.heads["stamp"], self.heads["received"]
        if stamps.any() and ((stamps % SECOND >= FRACTION).any() or (np.diff(stamps // SECOND) != 0).all()):
            return stamps
        is_finer = (received % SECOND).any() and (np.abs(received - stamps) < 2 * SECOND).all()
        return received if is_finer or not stamps.any() else stamps

    @cached_property
    def unset(self) -> NDArray[np.bool_]:
        """[n] which stamps of headers are none: 0, but for a first one that the others follow."""
        zero = self.stamps == 0
        later = np.sort(self.stamps[~zero])
        usual = np.median(np.diff(later)) if len(later) > 1 else np.inf
        is_first = zero.sum() == 1 and later[:1].max(initial=0) <= GAP * usual
        return np.asarray(zero & bool(len(later) and not is_first))

    @cached_property
    def cuts(self) -> list[int]:
        """The rows before which the clock was set."""
        rows = np.flatnonzero(~self.unset)
        return [int(rows[cut]) for cut in clock_cuts(seconds(self.stamps[rows]))]


class Bag:
    """A bag; messages are read from its files whenever they are asked for.

    Attributes:
        topics: those that were met when it was gone through; swept: the number of messages, so far.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.issues = path, list[Issue]()
        self._counts = dict[str, int]()  # of messages by topic, as ``metadata.yaml`` has them
        self._files = [_open_file(file) for file in self._files_of(path)]
        self.topics: set[Topic] = set()
        self.swept = 0

    def _files_of(self, path: Path) -> list[Path]:
        """A single file, those that ``metadata.yaml`` names, or the parts of a recording.

        What had to be unpacked is there as long as the bag.
        """
        if not path.is_dir():
            return [path]
        if not _has_metadata(path):
            return _parts(path, self.issues)
        metadata = path / METADATA
        table = read_yaml(metadata, "the metadata of a ROS 2 bag", limit=4_000_000)
        about = table.get(_INFORMATION) if isinstance(table, dict) else None
        about = about if isinstance(about, dict) else {}
        names = about.get("relative_file_paths")
        if not isinstance(names, list) or not 0 < len(set(map(str, names))) == len(names) <= MAX_FILES:
            raise InputError("no list of files, expected one", file=metadata, field="relative_file_paths")
        files = [path / Path(str(name)).name for name in names]  # bags before version 4 have the folder before it
        if missing := [file for file in files if not file.is_file() or file.resolve().parent != path.resolve()]:
            problem = f"{missing[0].name[:80]!r}, expected the name of a file in the folder"
            raise InputError(problem, file=metadata, field="relative_file_paths")
        counts = about.get("topics_with_message_count")
        for topic in counts if isinstance(counts, list) else ():
            with suppress(TypeError, KeyError, ValueError):
                self._counts[str(topic["topic_metadata"]["name"])] = int(topic["message_count"])
        return [_plain(file, self) for file in files]

    def tell(self, code: str, topic: Topic | str, what: str, count: int = 1) -> None:
        name = topic if isinstance(topic, str) else topic.name
        self.issues.append(Issue(code, f"{self.path.name}: {name}: {what}", count))

    def sweep(self, wanted: Callable[[Topic], bool]) -> Iterator[tuple[Topic, int, tuple[int, ...], bytes]]:
        """The messages of some topics, in the order they were written: when they were received [ns], where they lie,
        and their bytes. Damage is told at the end.
        """
        self.swept, known = 0, cache(wanted)
        for number, file in enumerate(self._files):
            for topic, received, place, data in file.messages(known):
                self.swept += 1
                if self.swept > MAX_MESSAGES:
                    raise InputError(f"more messages than {MAX_MESSAGES}, expected fewer", file=self.path)
                yield topic, received, (number, *place), data
            self.topics.update(file.topics.values())
            if file.damage:
                self.issues.append(Issue("damaged-bag", f"{file.path.name}: {file.damage}; what can be read is used"))

    def fill(self, table_of: Callable[[Topic], Table | None]) -> list[Table]:
        """The tables of the topics that have one, those with most messages first; the bag is gone through once."""
        tables: dict[Topic, Table] = {}

        def wanted(topic: Topic) -> bool:
            if (table := table_of(topic)) is not None:
                tables[topic] = table
            return table is not None

        for topic, received, place, data in self.sweep(wanted):
            table = tables[topic]
            try:
                message = decode(topic, data)
                numbers = table.take(message)
                if (header := getattr(message, "header", None)) is None:
                    continue
                stamp = int(header.stamp.sec) * SECOND + int(header.stamp.nanosec)
                mark = hash(data[12:4096])  # behind the number and stamp
                row = array("q", (stamp, received, self.swept, *place, mark))
            except (ValueError, OverflowError) as error:
                table.broken, table.problem = table.broken + 1, str(error)
                continue
            frame = header.frame_id.lstrip("/")
            table.frame = table.frame or frame
            table.others |= {frame} - {table.frame}
            table.child = table.child or getattr(message, "child_frame_id", "").lstrip("/")
            table.flat.extend(row)
            table.numbers.extend(numbers)
        found = [table for table in tables.values() if table.count]
        for table in found:
            if (stated := self._counts.get(table.topic.name, 0)) > table.count:
                text = f"{table.count} of the {stated} messages that {METADATA} states: is a part missing, or a -wal?"
                self.tell("damaged-bag", table.topic, text, stated - table.count)
        return sorted(found, key=lambda table: (-table.count, table.topic.name))

    def messages(self, table: Table, rows: Rows) -> Iterator[Any]:
        places = table.heads["place"][rows].tolist()
        for number, found in groupby(places, key=lambda place: place[0]):
            for data in self._files[number].payloads([(*place,) for _, *place in found]):
                try:
                    yield decode(table.topic, data)
                except ValueError as error:
                    raise InputError(f"a message is broken: {error}", file=self.path, field=table.topic.name) from error

    def choose_session(self, tables: Sequence[Table], session: str | int | None) -> None:
        """Settle which messages of all tables, the lidar's first, are read: of a session, from 1 on, else the longest.

        The recording is cut where the clock was set back (a simulator reset, a log played in a loop) or ahead by more
        than a day: each table where its own stamps say so near by, else where those of the table with most cuts do.
        """
        tables = [table for table in tables if len(table)]
        leader = max(tables, key=lambda table: len(table.cuts), default=None)
        edges = [] if leader is None else leader.heads["order"][leader.cuts].tolist()
        count = len(edges) + 1
        if session is not None and str(session) not in map(str, range(1, count + 1)):
            problem = f"{str(session)[:20]!r}, expected {f'1 to {count}' if count > 1 else 'the one session, 1'}"
            raise InputError(problem, file=self.path, field="sequence")
        parts = []
        for table in tables:
            order = table.heads["order"]
            near = {min(edges, key=lambda edge: abs(edge - order[cut])): cut for cut in table.cuts}
            parts.append(np.split(np.arange(len(table)), [near.get(one, order.searchsorted(one)) for one in edges]))
        used = 0
        if count > 1:
            first = tables[0]
            stamps = [first.stamps[rows][~first.unset[rows]] for rows in parts[0]]
            spans = [np.ptp(some) / SECOND if len(some) else 0.0 for some in stamps]
            used = int(np.argmax(spans)) if session is None else int(session) - 1
            lengths = ", ".join(f"{index} ({span:.1f} s)" for index, span in enumerate(spans[:8], 1))
            text = f"the clock was set {counted(len(edges), 'time')} in between: the sessions are {lengths}; session "
            text += f"{used + 1} is read{', the longest of them (--sequence reads another)' if session is None else ''}"
            self.issues.append(Issue("sessions", f"{self.path.name}: {text}", len(edges)))
        for table, rows in zip(tables, parts, strict=True):
            table.rows = rows[used]

    def used(self, table: Table, good: NDArray[np.bool_] | None = None) -> tuple[Rows, Stamps]:
        """Which messages of a table are used, in the order of their stamps, and these [s]; ``good`` [n] are what their
        type says, all if None.
        """
        topic, total = table.topic, table.count
        good = np.ones(len(table), np.bool_) if good is None else good
        bad = total - int(good.sum())
        if bad == total or bad > max(MAX_DROPPED, total // 10):
            why = f" ({table.problem})" if table.problem else ""
            problem = f"{bad} of {counted(total, 'message')} broken{why}, expected those of a {topic.kind}"
            raise InputError(problem, file=self.path, field=topic.name)
        rows = table.rows[(good & ~table.unset)[table.rows]]
        if not len(rows):
            raise InputError("no message in this session, expected some", file=self.path, field=topic.name)
        stamps, marks = table.stamps[rows], table.heads["mark"][rows]
        twice = np.ones(len(rows), np.bool_)
        twice[np.unique(np.column_stack((stamps, marks)), axis=0, return_index=True)[1]] = False
        unstamped = 0 if (table.stamps == table.heads["stamp"]).all() else len(table)
        for code, count, what in (
            ("no-header-stamps", unstamped, "stamped by none or seconds alone: times of reception are taken"),
            ("broken-messages", bad, "broken: dropped"),
            ("unset-stamps", int(table.unset[table.rows].sum()), "without a stamp (0) dropped"),
            ("doubles", int(twice.sum()), "recorded twice: the second is dropped"),
        ):
            if count:
                self.tell(code, topic, f"{counted(count, 'message')} {what}", count)
        times, order = sort_by_stamp(self.path, topic.name, seconds(stamps[~twice]), self.issues)
        return rows[~twice][order], times


def seconds(nanoseconds: NDArray[np.int64]) -> NDArray[np.float64]:
    """Stamps [s], each the float64 nearest to it but for one rounding more."""
    return nanoseconds // SECOND + (nanoseconds % SECOND) / SECOND


def is_bag(path: Path, kind: str | None = None) -> bool:
    """Whether a path is a bag: a file, of a kind if one is named (of SQLite one that has the tables of a bag), or a
    folder that holds a ``metadata.yaml`` or the parts of a single recording.
    """
    try:
        if path.is_dir():
            return _has_metadata(path) or bool(_parts(path, []))
        begins = _kind_of(path)
        return begins is not None and kind in (None, begins) and (begins != "db3" or bool(_open_file(path)))
    except (InputError, OSError, ValueError):
        return False


def _kind_of(path: Path) -> str | None:
    with open_regular(path, "a ROS bag") as file:
        start = file.read(16)
    return next((kind for magic, kind in _MAGICS.items() if start.startswith(magic)), None)


def _open_file(path: Path) -> Rosbag1 | Mcap | Database:
    kind = _kind_of(path)
    if kind is None:
        raise InputError("does not begin as a ROS bag, an MCAP or a SQLite file", file=path)
    with damage_in_one_line(path):
        return _STORAGES[kind](path)


def _plain(file: Path, owner: object) -> Path:
    """A file, unpacked where it is packed as a whole."""
    with damage_in_one_line(file), file.open("rb") as packed:
        if packed.read(4) != ZSTD:
            return file
        packed.seek(0)
        into = temporary_folder(owner) / file.stem
        limit = min(MAX_RATIO * file.stat().st_size, shutil.disk_usage(into.parent).total // 2)
        with zstd.open(packed, "rb") as content, into.open("wb") as plain:
            while block := content.read(1 << 20):
                plain.write(block)
                if plain.tell() > limit:
                    raise InputError("unpacks to more than a recording does: unpack it with zstd -d", file=file)
    return into


def _has_metadata(folder: Path) -> bool:
    try:
        with (folder / METADATA).open("rb") as file:
            return _INFORMATION.encode() in file.read(4096)
    except OSError:
        return False


def _parts(folder: Path, issues: list[Issue]) -> list[Path]:
    """The parts ``name_0.mcap``, ``name_1.mcap`` of the only recording in a folder, in order; else an empty list."""
    entries = (file for _, file in zip(range(MAX_FILES), folder.iterdir(), strict=False))
    files = [file for file in entries if file.is_file() and is_bag(file)]
    named = sorted((int(part["number"]), part["stem"], file) for file in files if (part := _PART.fullmatch(file.name)))
    if len(named) < len(files) or len({(stem, file.suffix) for _, stem, file in named}) != 1:
        return []
    missing = len({*range(min(named[-1][0], MAX_FILES))} - {number for number, *_ in named})
    text = f"{folder.name}: no metadata.yaml; {', '.join(file.name for *_, file in named[:4])}"
    text += f"{' and others' if len(named) > 4 else ''} are read as one recording"
    issues.append(Issue("no-metadata", text + (f"; {missing} are missing" if missing else ""), len(named)))
    return [file for *_, file in named]
