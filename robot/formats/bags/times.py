"""When messages were, and which of them are used: sessions of a clock that was set, broken ones, doubles, the order."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.formats.bags.bag import SECOND, Table
from moteslam.robot.formats.stamps import MAX_DROPPED, Stamps, clock_cuts, stamp_order
from moteslam.robot.values import Issue, counted

BACK = 1.0
"""A stamp further behind the latest before it [s], with all that follow, is of a clock that was set back: what waits
in a queue is less late, or is followed by others that are not."""
_GAP = 10
"""A first stamp of 0 this many times the usual step before the next one is no time."""

Rows = NDArray[np.intp]


def seconds(nanoseconds: NDArray[np.int64]) -> Stamps:
    """Stamps [s], each the float64 nearest to it but for one rounding more."""
    return nanoseconds // SECOND + (nanoseconds % SECOND) / SECOND


def nanoseconds(stamps: Stamps) -> NDArray[np.int64]:
    """Stamps [s] as whole nanoseconds, rounded half to even.

    From 2^23 s on (97 days: all of Unix time) float64 is coarser than a nanosecond, and ``seconds`` gives the same
    stamps back, bit for bit; below it they come back to within half a nanosecond.
    """
    whole = np.floor(stamps)
    return whole.astype(np.int64) * SECOND + np.rint((stamps - whole) * SECOND).astype(np.int64)


class Times:
    """The times of a bag's tables, of one session of its clock.

    Where the clock was set back (a simulator reset, a log played in a loop) or ahead by more than a day, the recording
    is cut, and one session is used: two runs are never sorted into each other.

    Args:
        path: of the bag.
        tables: of all its streams, the lidar's first.
        session: which is used, from 1 on; the longest if None.
        issues: what was dropped or left aside is added.
    """

    def __init__(self, path: Path, tables: Sequence[Table], session: str | int | None, issues: list[Issue]) -> None:
        self._path, self._issues = path, issues
        tables = [table for table in tables if len(table.stamps)]
        self._stamps = {id(table): self._stamps_of(table) for table in tables}
        self._rows = {id(table): np.arange(len(table.stamps)) for table in tables}
        cuts = {id(table): self._cuts(table) for table in tables}
        leader = max(tables, key=lambda table: len(cuts[id(table)]), default=None)
        edges = [] if leader is None else [leader.order[cut] for cut in cuts[id(leader)]]
        count = len(edges) + 1
        if session is not None and str(session) not in map(str, range(1, count + 1)):
            problem = f"{str(session)[:20]!r}, expected {f'1 to {count}' if count > 1 else 'the one session, 1'}"
            raise InputError(problem, file=path, field="sequence")
        if count == 1:
            return
        parts = {id(table): _parts(table, cuts[id(table)], edges) for table in tables}
        first = self._stamps[id(tables[0])][0]
        spans = [np.ptp(first[rows]) / SECOND if len(rows) else 0.0 for rows in parts[id(tables[0])]]
        used = int(np.argmax(spans)) if session is None else int(session) - 1
        lengths = ", ".join(f"{index} ({span:.1f} s)" for index, span in enumerate(spans[:8], 1))
        text = f"{path.name}: the clock was set {counted(len(edges), 'time')} in between: the sessions are {lengths}"
        text += f"; session {used + 1} is read{', the longest' if session is None else ''}"
        issues.append(Issue("sessions", text, len(edges)))
        self._rows = {key: rows[used] for key, rows in parts.items()}

    def _stamps_of(self, table: Table) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """The stamps [n] [ns] of the headers, of reception where these have none, and which of them are none."""
        stamps = np.array(table.stamps, np.int64)
        if not stamps.any():
            text = f"{self._path.name}: {table.topic.name}: no stamps in the headers, the times of reception are taken"
            self._issues.append(Issue("no-header-stamps", text, len(stamps)))
            return np.array(table.received, np.int64), np.zeros(len(stamps), np.bool_)
        unset = stamps == 0
        later = np.sort(stamps[~unset])
        if unset.sum() == 1 and later[0] <= _GAP * (np.median(np.diff(later)) if len(later) > 1 else np.inf):
            unset[:] = False
        return stamps, unset

    def _cuts(self, table: Table) -> list[int]:
        """The rows before which the clock was set."""
        stamps, unset = self._stamps[id(table)]
        rows = np.flatnonzero(~unset)
        return [int(rows[cut]) for cut in clock_cuts(seconds(stamps[rows]), BACK)]

    def has(self, table: Table) -> bool:
        """Whether there is anything of a table in the session that is read; where there is not, an issue says so."""
        if not len(table.stamps) or len(self._rows[id(table)]):
            return True  # or all of it is broken, which `used` says
        text = f"{self._path.name}: {table.topic.name}: no message in the session that is read"
        self._issues.append(Issue("sessions", text))
        return False

    def used(self, table: Table, good: NDArray[np.bool_] | None = None) -> tuple[Rows, Stamps]:
        """Which messages of a table are used, in the order of their stamps, and these [s].

        Args:
            table: of a topic.
            good: [n] which of them are what their type says; all if None.
        """
        name, total = table.topic.name, len(table.stamps) + table.broken
        good = np.ones(len(table.stamps), np.bool_) if good is None else good
        bad = total - int(good.sum())
        if bad == total or bad > max(MAX_DROPPED, total // 10):
            problem = f"{bad} of {counted(total, 'message')} broken, expected those of a {table.topic.kind}"
            raise InputError(problem, file=self._path, field=name)
        (stamps, unset), rows = self._stamps[id(table)], self._rows[id(table)]
        self._tell("broken-messages", table, bad, "broken: dropped")
        self._tell("unset-stamps", table, int(unset[rows].sum()), "without a stamp (0) dropped")
        rows = rows[(good & ~unset)[rows]]
        if not len(rows):
            raise InputError("no message in this session, expected some", file=self._path, field=name)
        doubles = _doubles(stamps[rows], np.array(table.marks, np.int64)[rows])
        self._tell("doubles", table, int(doubles.sum()), "recorded twice: the second is dropped")
        rows = rows[~doubles]
        times = seconds(stamps[rows])
        order, found = stamp_order(times, file=self._path, field=name)
        self._issues.extend(found)
        return (rows, times) if order is None else (rows[order], times[order])

    def _tell(self, code: str, table: Table, count: int, what: str) -> None:
        if count:
            text = f"{self._path.name}: {table.topic.name}: {counted(count, 'message')} {what}"
            self._issues.append(Issue(code, text, count))


def _parts(table: Table, cuts: list[int], edges: list[int]) -> list[Rows]:
    """The rows of each session: a table's own cuts where it has them near, else where the bag is cut."""
    order, borders = np.array(table.order), cuts
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
