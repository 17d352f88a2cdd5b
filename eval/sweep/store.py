"""The runs of a sweep and what became of them, in one SQLite file that one process writes."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from moteslam.errors import InputError, OutputError
from moteslam.eval.metrics.catalogue import COSTS
from moteslam.eval.sweep.plan import PlannedRun
from moteslam.eval.sweep.workers import Outcome

VERSION = 1
SCHEMA = """
CREATE TABLE about (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE runs (
    id TEXT PRIMARY KEY, number INTEGER NOT NULL, run TEXT NOT NULL,
    status TEXT, error TEXT, issues TEXT
);
CREATE TABLE results (
    run TEXT NOT NULL REFERENCES runs (id), name TEXT NOT NULL, value REAL, unit TEXT NOT NULL, absent TEXT,
    PRIMARY KEY (run, name)
) WITHOUT ROWID;
CREATE TABLE costs (
    run TEXT NOT NULL REFERENCES runs (id), name TEXT NOT NULL, value REAL, unit TEXT NOT NULL,
    PRIMARY KEY (run, name)
) WITHOUT ROWID;
"""


@dataclass(frozen=True)
class Row:
    """A run of a sweep as it is recorded.

    Attributes:
        run: which.
        status: ``ok``, ``failed``, ``crashed`` or ``timed out``; empty of one that was not made yet.
        error: why it is not ok.
        values: by metric; None where one is absent.
        units: by metric.
        absent: reasons, by metric.
        costs: times and memory, by metric, where they were measured.
        issues: of recording and run.
    """

    run: PlannedRun
    status: str
    error: str
    values: dict[str, float | None]
    units: dict[str, str]
    absent: dict[str, str]
    costs: dict[str, float]
    issues: tuple[dict[str, Any], ...] = ()


class Store:
    """An open file of a sweep; see ``opened``."""

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self.path, self._connection = path, connection

    @property
    def spec(self) -> str:
        """The specification of the sweep, as JSON."""
        return self._about("spec")

    @property
    def part(self) -> str:
        """Which part of the sweep it holds, ``2/8``; ``1/1`` of a whole one."""
        return self._about("part")

    @property
    def digest(self) -> str:
        """What identifies all runs of the sweep (see ``bundled.digest``); empty where it was not recorded."""
        return self._about("digest", "")

    @property
    def environment(self) -> dict[str, dict[str, str]]:
        """Versions and hardware of the computer that made the file; empty where they were not recorded."""
        found: dict[str, dict[str, str]] = json.loads(self._about("environment", "{}"))
        return found

    def pending(self) -> list[PlannedRun]:
        """The runs that were not made yet, in their order."""
        found = self._connection.execute("SELECT run FROM runs WHERE status IS NULL ORDER BY number")
        return [PlannedRun.of(json.loads(text)) for (text,) in found]

    def counts(self) -> dict[str, int]:
        """How many runs have each status; ``""`` are those not made yet."""
        return dict(self._connection.execute("SELECT coalesce(status, ''), count(*) FROM runs GROUP BY 1 ORDER BY 1"))

    def record(self, outcome: Outcome) -> None:
        """Record what became of a run; after this it is on the disk."""
        result, run = outcome.result, outcome.run.id
        with self._connection:
            self._connection.execute(
                "UPDATE runs SET status = ?, error = ?, issues = ? WHERE id = ?",
                (outcome.status, outcome.error, json.dumps(result.get("issues", [])), run),
            )
            for name, value in result.get("values", {}).items():
                number, unit, absent = value.get("value"), value.get("unit", ""), value.get("absent")
                if name not in COSTS:
                    self._connection.execute(
                        "INSERT INTO results VALUES (?, ?, ?, ?, ?)", (run, name, number, unit, absent)
                    )
                elif number is not None:
                    self._connection.execute("INSERT INTO costs VALUES (?, ?, ?, ?)", (run, name, number, unit))

    def rows(self) -> Iterator[Row]:
        """All runs, in their order."""
        columns = "id, run, coalesce(status, ''), coalesce(error, ''), coalesce(issues, '[]')"
        query = f"SELECT {columns} FROM runs ORDER BY number"
        for run, text, status, error, issues in self._connection.execute(query):
            found = self._connection.execute("SELECT name, value, unit, absent FROM results WHERE run = ?", (run,))
            results = found.fetchall()
            yield Row(
                PlannedRun.of(json.loads(text)),
                status,
                error,
                {name: value for name, value, _, _ in results},
                {name: unit for name, value, unit, _ in results if value is not None},
                {name: absent for name, _, _, absent in results if absent is not None},
                dict(self._connection.execute("SELECT name, value FROM costs WHERE run = ?", (run,))),
                tuple(json.loads(issues)),
            )

    def take(self, other: Store) -> int:
        """Take over what another file of the same sweep has and this one has not; how many runs those were.

        Raises:
            InputError: it is of another sweep, or both have a run with different results.
        """
        if other.spec != self.spec:
            raise InputError("of another sweep, expected shards of one", file=other.path)
        mine = {row.run.id: row for row in self.rows() if row.status}
        taken = 0
        for row in other.rows():
            if not row.status:
                continue
            known = mine.get(row.run.id)
            if known is None:
                self.record(_as_outcome(row))
                taken += 1
            elif (known.status, known.values) != (row.status, row.values):
                raise InputError(f"another result of {row.run.name}, expected the same", file=other.path)
        return taken

    def _about(self, key: str, default: str | None = None) -> str:
        (value,) = self._connection.execute("SELECT value FROM about WHERE key = ?", (key,)).fetchone() or (default,)
        return str(value)


@contextmanager
def opened(path: str | PathLike[str], *, write: bool = False) -> Iterator[Store]:
    """Open a file of a sweep, alone if it is to be written.

    Raises:
        InputError: it is none, or of another version.
        OutputError: another process writes it.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError("there is no such file, expected one that `moteslam sweep` made", file=path)
    if path.stat().st_size == 0:
        raise InputError("is empty, expected what `moteslam sweep` made", file=path)
    with _alone(path, write=write):
        # for reading, too: where a process was killed amid a transaction, only one that may write can roll it back
        connection = sqlite3.connect(f"file:{_quoted(path)}?mode=rw", uri=True)
        try:
            try:
                if not write:
                    connection.execute("PRAGMA query_only = ON")
                (version,) = connection.execute("SELECT value FROM about WHERE key = 'version'").fetchone() or ("",)
            except sqlite3.DatabaseError as error:
                raise InputError(f"no file of a sweep: {error}", file=path) from error
            if version != str(VERSION):
                raise InputError(f"version {version!r}, expected {VERSION}", file=path)
            yield Store(path, connection)
        finally:
            connection.close()


def create(
    path: str | PathLike[str],
    spec: str,
    runs: Iterable[PlannedRun],
    *,
    part: str = "1/1",
    digest: str = "",
    environment: Mapping[str, Mapping[str, str]] | None = None,
) -> None:
    """Make the file of a sweep, complete or not at all.

    Args:
        path: a new file.
        spec: as JSON.
        runs: of the sweep, in their order.
        part: of the sweep that these are.
        digest: of all runs of the sweep.
        environment: versions and hardware, by name.

    Raises:
        OutputError: it cannot be made.
    """
    path = Path(path)
    partial = path.with_name(f".{path.name}.partial")
    try:
        partial.unlink(missing_ok=True)
        connection = sqlite3.connect(partial)
        try:
            with connection:
                connection.executescript(SCHEMA)
                about = {"version": str(VERSION), "spec": spec, "part": part, "digest": digest}
                about["environment"] = json.dumps(environment or {})
                connection.executemany("INSERT INTO about VALUES (?, ?)", about.items())
                rows = ((run.id, number, json.dumps(run.as_dict())) for number, run in enumerate(runs))
                connection.executemany("INSERT INTO runs (id, number, run) VALUES (?, ?, ?)", rows)
        finally:
            connection.close()
        partial.replace(path)
    except (OSError, sqlite3.Error) as error:
        raise OutputError(f"cannot be made: {error}", file=path) from error


def _as_outcome(row: Row) -> Outcome:
    values: dict[str, Any] = {
        name: {"value": value, "unit": row.units.get(name, ""), "absent": row.absent.get(name)}
        for name, value in row.values.items()
    }
    values |= {name: {"value": value} for name, value in row.costs.items()}
    return Outcome(row.run, row.status, row.error, {"values": values, "issues": row.issues})


def _quoted(path: Path) -> str:
    from urllib.parse import quote

    return quote(str(path.absolute()))


@contextmanager
def _alone(path: Path, *, write: bool) -> Iterator[None]:
    """While the block lasts no other process writes the file."""
    if not write:
        yield
        return
    # SQLite's own locks are of another kind, and are lost where the file is closed: it stays open beyond the connection
    with path.open("rb") as file:
        try:
            import fcntl

            fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise OutputError("another sweep writes it, expected another file", file=path) from None
        except (ImportError, OSError):  # a system or a file system without locks
            pass
        yield
