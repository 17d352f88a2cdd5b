"""A bag: its topics, what is kept of their messages in the order they were written, and which of these are used."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import groupby
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.formats.bags.files import open_files
from moteslam.robot.formats.bags.messages import SECOND, decoder, frame_name, full_name, seconds, store
from moteslam.robot.formats.bags.records import MAX_CHUNK, damage_in_one_line, unpack
from moteslam.robot.formats.streams import MAX_DROPPED, Stamps, clock_cuts, stamp_order
from moteslam.robot.values import Issue, counted

MAX_MESSAGES = 20_000_000
"""No bag has more: an hour of twenty streams at 250 Hz."""
BACK = 1.0
"""A stamp further behind the latest before it [s], with all that follow, is of a clock that was set back: what waits
in a queue is less late, or is followed by others that are not."""
_GAP = 10
"""A first stamp of 0 this many times the usual step before the next one is no time."""

Rows = NDArray[np.intp]

HEAD = [("stamp", "i8"), ("received", "i8"), ("order", "i8"), ("place", "i8", 4), ("mark", "i8"), ("frame", "i8")]
"""What is kept of every message: the stamp of its header and when it came [ns], its number in the bag, where it lies
(file, and the place in it), a checksum, and the index of its frame."""


@dataclass(frozen=True)
class Topic:
    """The messages of one topic and type.

    Attributes:
        name: with a leading slash.
        kind: the type, ``sensor_msgs/LaserScan``.
        digest: of the type's definition, where the bag states one, as ROS 1 does.
        count: of messages.
        channels: of it, each by the number of its file and its own.
    """

    name: str
    kind: str
    digest: str = ""
    count: int = 0
    channels: frozenset[tuple[int, int]] = frozenset()


@dataclass(eq=False)
class Table:
    """What is kept of the messages of a topic, in the order they were written.

    Attributes:
        topic: of them.
        take: gives the numbers that are kept of a message, ``width`` of them; raises a ValueError for a broken one.
        flat: of all messages, as `HEAD`; numbers: flat [n * width]; frames: their names.
        child: the child frame of an odometry.
        broken: how many were.
        rows: of the session of the clock that is read, after `Bag.choose_session`.
    """

    topic: Topic
    take: Callable[[Any], tuple[float, ...]] = lambda _: ()
    width: int = 0
    flat: array[int] = field(default_factory=lambda: array("q"))
    numbers: array[float] = field(default_factory=lambda: array("d"))
    frames: dict[str, int] = field(default_factory=dict)
    child: str = ""
    broken: int = 0
    rows: Rows = field(default_factory=lambda: np.empty(0, np.intp))

    def __len__(self) -> int:
        return len(self.flat) // 9

    @cached_property
    def heads(self) -> NDArray[Any]:
        """[n] of `HEAD`."""
        return np.frombuffer(self.flat, HEAD) if self.flat else np.empty(0, HEAD)

    @property
    def values(self) -> NDArray[np.float64]:
        """The numbers [n, width] of the messages."""
        return np.array(self.numbers).reshape(len(self), self.width)

    def frame(self, index: int = 0) -> str:
        """The frame of a message's header."""
        return list(self.frames)[self.heads["frame"][index]] if len(self) else ""

    @cached_property
    def stamps(self) -> NDArray[np.int64]:
        """[n] [ns] of the headers, of reception where these have none."""
        stamps = self.heads["stamp"]
        return stamps if stamps.any() else self.heads["received"]

    @cached_property
    def unset(self) -> NDArray[np.bool_]:
        """[n] which stamps of headers are none: 0, but for a first one that the others follow."""
        unset = np.asarray(self.heads["stamp"] == 0)
        later = np.sort(self.stamps[~unset])
        if not len(later):
            return ~unset
        if unset.sum() == 1 and later[0] <= _GAP * (np.median(np.diff(later)) if len(later) > 1 else np.inf):
            unset[:] = False
        return unset

    @property
    def cuts(self) -> list[int]:
        """The rows before which the clock was set."""
        rows = np.flatnonzero(~self.unset)
        return [int(rows[cut]) for cut in clock_cuts(seconds(self.stamps[rows]), BACK)]


class Bag:
    """A bag; messages are read from its files whenever they are asked for."""

    def __init__(self, path: Path) -> None:
        self.path, self.issues = path, list[Issue]()
        self._files = open_files(path, self, self.issues)
        channels = [each for file in self._files for each in file.channels.values()]
        encodings = {each.encoding for each in channels} & {"cdr", "ros1"}
        if len(encodings) > 1:
            raise InputError("messages of ROS 1 and of ROS 2, expected one of them", file=path)
        self.ros1 = encodings == {"ros1"}
        parts: dict[tuple[str, str, str], list[tuple[int, int]]] = {}
        for number, file in enumerate(self._files):
            if file.damage:
                text = f"{file.path.name}: {file.damage}; what can be read is used"
                self.issues.append(Issue("damaged-bag", text))
            for own, channel in file.channels.items():
                if channel.encoding in encodings:
                    name = "/" + "/".join(part for part in channel.topic[:4096].split("/") if part)
                    parts.setdefault((name, channel.kind[:4096], channel.digest), []).append((number, own))
        totals = [file.totals() for file in self._files]
        self.topics = [
            Topic(*key, sum(totals[number].get(own, 0) for number, own in found), frozenset(found))
            for key, found in parts.items()
        ]
        if (total := sum(topic.count for topic in self.topics)) > MAX_MESSAGES:
            raise InputError(f"{total} messages, expected at most {MAX_MESSAGES}", file=path)

    def tell(self, code: str, topic: Topic | str, what: str, count: int = 1) -> None:
        """Add an issue about a topic."""
        name = topic if isinstance(topic, str) else topic.name
        self.issues.append(Issue(code, f"{self.path.name}: {name}: {what}", count))

    def of_kind(self, *kinds: str) -> list[Topic]:
        """The topics of these types that have messages and are read here, those with most first, then by name."""
        found = [topic for topic in self.topics if topic.kind in kinds and topic.count and is_readable(topic)]
        return sorted(found, key=lambda topic: (-topic.count, topic.name))

    def sweep(self, topics: Collection[Topic]) -> Iterator[tuple[Topic, int, tuple[int, int, int, int], bytes]]:
        """The messages of some topics: when they were received [ns], where they lie, and their bytes."""
        for number, file in enumerate(self._files):
            known = {own: topic for topic in topics for at, own in topic.channels if at == number}
            for channel, received, place, data in file.messages(known.keys()) if known else ():
                yield known[channel], received, (number, *place), self._plain(number, data)

    def messages(self, table: Table, rows: Rows) -> Iterator[Any]:
        """Some messages of a table, decoded."""
        places = table.heads["place"][rows].tolist()
        for number, found in groupby(places, key=lambda place: place[0]):
            for data in self._files[number].payloads([(*place,) for _, *place in found]):
                try:
                    yield self.decode(table.topic, self._plain(number, data))
                except ValueError as error:
                    problem = f"a message is broken: {error}"
                    raise InputError(problem, file=self.path, field=table.topic.name) from error

    def _plain(self, number: int, data: bytes) -> bytes:
        if not self._files[number].packed:
            return data
        with damage_in_one_line(self._files[number].path):
            return unpack(data, "zstd", MAX_CHUNK)

    def decode(self, topic: Topic, data: bytes) -> Any:
        """A message; a ValueError where it is not what its type says."""
        return decoder(ros1=self.ros1)(data, topic.kind)

    def fill(self, tables: Mapping[Topic, Table], others: Mapping[Topic, Callable[[Any, int], None]]) -> int:
        """Go through the bag once: every message of a table's topic is a row, those of the others are handed on.

        Returns:
            how many of the others' are broken.
        """
        broken, order = 0, -1
        decode = decoder(ros1=self.ros1)
        for order, (topic, received, place, data) in enumerate(self.sweep([*tables, *others])):
            table = tables.get(topic)
            try:
                message = decode(data, topic.kind)
                if table is None:
                    others[topic](message, order)
                    continue
                numbers = table.take(message)
                header = message.header
                stamp = int(header.stamp.sec) * SECOND + int(header.stamp.nanosec)
                frame = table.frames.setdefault(frame_name(header.frame_id), len(table.frames))
                table.child = table.child or frame_name(getattr(message, "child_frame_id", ""))
                mark = hash(data[12:4096])  # behind the number and stamp
                row = array("q", (stamp, received, order, *place, mark, frame))
            except (ValueError, OverflowError):
                if table is None:
                    broken += 1
                else:
                    table.broken += 1
                continue
            table.flat.extend(row)
            table.numbers.extend(numbers)
        if (lost := sum(topic.count for topic in (*tables, *others)) - order - 1) > 0:
            text = f"{counted(lost, 'message')} of its index cannot be found; what can be read is used"
            self.issues.append(Issue("damaged-bag", f"{self.path.name}: {text}", lost))
        return broken

    def choose_session(self, tables: Sequence[Table], session: str | int | None) -> None:
        """Settle which messages of all tables, the lidar's first, are read: those of one session of the clock.

        Where the clock was set back (a simulator reset, a log played in a loop) or ahead by more than a day, the
        recording is cut, and one session is used, from 1 on, the longest if it is None: two runs are never sorted into
        each other.
        """
        tables = [table for table in tables if len(table)]
        for table in tables:
            if not table.heads["stamp"].any():
                what = "no stamps in the headers, the times of reception are taken"
                self.tell("no-header-stamps", table.topic, what, len(table))
        cuts = [table.cuts for table in tables]
        leader = max(range(len(tables)), key=lambda k: len(cuts[k]), default=None)
        edges = [] if leader is None else tables[leader].heads["order"][cuts[leader]].tolist()
        count = len(edges) + 1
        if session is not None and str(session) not in map(str, range(1, count + 1)):
            problem = f"{str(session)[:20]!r}, expected {f'1 to {count}' if count > 1 else 'the one session, 1'}"
            raise InputError(problem, file=self.path, field="sequence")
        parts = [_parts(table, found, edges) for table, found in zip(tables, cuts, strict=True)]
        used = 0
        if count > 1:
            first = tables[0].stamps
            spans = [np.ptp(first[rows]) / SECOND if len(rows) else 0.0 for rows in parts[0]]
            used = int(np.argmax(spans)) if session is None else int(session) - 1
            lengths = ", ".join(f"{index} ({span:.1f} s)" for index, span in enumerate(spans[:8], 1))
            text = f"the clock was set {counted(len(edges), 'time')} in between: the sessions are {lengths}; session "
            text += f"{used + 1} is read{', the longest' if session is None else ''}"
            self.issues.append(Issue("sessions", f"{self.path.name}: {text}", len(edges)))
        for table, rows in zip(tables, parts, strict=True):
            table.rows = rows[used]

    def has(self, table: Table | None) -> TypeGuard[Table]:
        """Whether there is anything of a table in the session that is read; where there is not, an issue says so."""
        if table is None:
            return False
        if not len(table) or len(table.rows):
            return True  # if all of it is broken, `used` says so
        self.tell("sessions", table.topic, "no message in the session that is read")
        return False

    def used(self, table: Table, good: NDArray[np.bool_] | None = None) -> tuple[Rows, Stamps]:
        """Which messages of a table are used, in the order of their stamps, and these [s]; ``good`` [n] are what their
        type says, all if None.
        """
        topic, total = table.topic, len(table) + table.broken
        good = np.ones(len(table), np.bool_) if good is None else good
        bad = total - int(good.sum())
        if bad == total or bad > max(MAX_DROPPED, total // 10):
            problem = f"{bad} of {counted(total, 'message')} broken, expected those of a {topic.kind}"
            raise InputError(problem, file=self.path, field=topic.name)
        rows = table.rows
        unset = int(table.unset[rows].sum())
        rows = rows[(good & ~table.unset)[rows]]
        if not len(rows):
            raise InputError("no message in this session, expected some", file=self.path, field=topic.name)
        doubles = _doubles(table.stamps[rows], table.heads["mark"][rows])
        for code, count, what in (
            ("broken-messages", bad, "broken: dropped"),
            ("unset-stamps", unset, "without a stamp (0) dropped"),
            ("doubles", int(doubles.sum()), "recorded twice: the second is dropped"),
        ):
            if count:
                self.tell(code, topic, f"{counted(count, 'message')} {what}", count)
        rows = rows[~doubles]
        times = seconds(table.stamps[rows])
        order, found = stamp_order(times, file=self.path, field=topic.name)
        self.issues.extend(found)
        return (rows, times) if order is None else (rows[order], times[order])


def _parts(table: Table, cuts: list[int], edges: list[int]) -> list[Rows]:
    """The rows of each session: a table's own cuts where it has them near, else where the bag is cut."""
    order, borders = table.heads["order"], cuts
    if len(cuts) != len(edges):
        borders = []
        for edge in edges:
            near = [cut for cut in cuts if min(edges, key=lambda other: abs(other - order[cut])) == edge]
            borders.append(near[0] if near else int(np.searchsorted(order, edge)))
    return np.split(np.arange(len(order)), borders)


def _doubles(stamps: NDArray[np.int64], marks: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which messages [n] were there before: of the same stamp and content."""
    order = np.lexsort((marks, stamps))
    again = (np.diff(stamps[order]) == 0) & (np.diff(marks[order]) == 0)
    found = np.zeros(len(stamps), np.bool_)
    found[order[1:][again]] = True
    return found


@cache
def is_readable(topic: Topic) -> bool:
    """Whether a topic's messages are of the definition that is read here, as far as the bag says."""
    known, name = store(ros1=True), full_name(topic.kind)
    return topic.digest in ("", "*") or (name in known.types and topic.digest == known.generate_msgdef(name)[1])
