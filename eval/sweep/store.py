"""The runs of a sweep and what became of them, in one SQLite file that one process writes."""

from __future__ import annotations

import fcntl
import json
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any
from urllib.parse import quote

from moteslam.errors import ConfigError, InputError, OutputError
from moteslam.eval.metrics.catalogue import COSTS
from moteslam.eval.sweep import bundled
from moteslam.eval.sweep.plan import PlannedRun, plan, shard
from moteslam.eval.sweep.spec import SweepSpec
from moteslam.eval.sweep.workers import Outcome

VERSION = 1
WHOLE = "1/1"
"""The part of a sweep that is all of it."""
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
        values: by metric; None if absent.
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

    @property
    def known(self) -> dict[str, float]:
        """Values and costs that are not absent."""
        return {name: value for name, value in (self.values | self.costs).items() if value is not None}


class Store:
    """An open file of a sweep; see ``opened``.

    Attributes:
        path: of the file.
        spec: the specification of the sweep, as JSON.
        part: which part of the sweep it holds, such as ``2/8``.
        digest: what identifies all runs of the sweep (see ``bundled.digest``); empty where it was not recorded.
        environment: versions and hardware of the computer that made the file; empty where they were not recorded.
    """

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        about = dict(connection.execute("SELECT key, value FROM about"))
        if about.get("version") != str(VERSION):
            raise InputError(f"version {about.get('version', '')!r}, expected {VERSION}", file=path)
        self.path, self._connection = path, connection
        self.spec, self.part, self.digest = str(about["spec"]), str(about["part"]), str(about.get("digest", ""))
        self.environment: dict[str, dict[str, str]] = json.loads(about.get("environment", "{}"))

    def pending(self) -> list[PlannedRun]:
        """The runs that were not made yet, in their order."""
        found = self._connection.execute("SELECT run FROM runs WHERE status IS NULL ORDER BY number")
        return [PlannedRun.of(json.loads(text)) for (text,) in found]

    def counts(self) -> dict[str, int]:
        """How many runs have each status; ``""`` are those not made yet."""
        return dict(self._connection.execute("SELECT coalesce(status, ''), count(*) FROM runs GROUP BY 1 ORDER BY 1"))

    def record(self, outcome: Outcome[PlannedRun]) -> None:
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

    def take(self, other: Store) -> None:
        """Take over what another part of the same sweep has and this one has not.

        Raises:
            InputError: it is of another sweep, or both have a run with different results.
        """
        if (other.spec, other.digest) != (self.spec, self.digest):
            raise InputError("of another sweep, expected parts of one", file=other.path)
        mine = {row.run.id: row for row in self.rows() if row.status}
        for row in other.rows():
            known = mine.get(row.run.id)
            if not row.status:
                continue
            if known is None:
                values: dict[str, Any] = {
                    name: {"value": value, "unit": row.units.get(name, ""), "absent": row.absent.get(name)}
                    for name, value in row.values.items()
                }
                values |= {name: {"value": value} for name, value in row.costs.items()}
                self.record(Outcome(row.run, row.status, row.error, {"values": values, "issues": row.issues}))
            elif (known.status, known.values) != (row.status, row.values):
                raise InputError(f"another result of {row.run.name}, expected the same", file=other.path)


@contextmanager
def opened(path: str | PathLike[str], *, write: bool = False) -> Iterator[Store]:
    """Open a file of a sweep, alone if it is to be written.

    Raises:
        InputError: not a file of a sweep, or of another version.
        OutputError: another process writes it.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError("there is no such file, expected one that `moteslam sweep` made", file=path)
    if path.stat().st_size == 0:
        raise InputError("is empty, expected what `moteslam sweep` made", file=path)
    # SQLite's own locks are of another kind, and are lost where the file is closed: it stays open beyond the connection
    with path.open("rb") as file:
        if write:
            try:
                fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise OutputError("another sweep writes it, expected another file", file=path) from None
            except OSError:  # a file system without locks
                pass
        # for reading, too: where a process was killed amid a transaction, only one that may write can roll it back
        connection = sqlite3.connect(f"file:{quote(str(path.absolute()))}?mode=rw", uri=True)
        try:
            try:
                if not write:
                    connection.execute("PRAGMA query_only = ON")
                store = Store(path, connection)
            except sqlite3.DatabaseError as error:
                raise InputError(f"no file of a sweep: {error}", file=path) from error
            yield store
        finally:
            connection.close()


def create(
    path: str | PathLike[str],
    spec: str,
    runs: Iterable[PlannedRun],
    *,
    part: str = WHOLE,
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
    about = {"version": str(VERSION), "spec": spec, "part": part, "digest": digest}
    about["environment"] = json.dumps(environment or {})
    rows = ((run.id, number, json.dumps(run.as_dict())) for number, run in enumerate(runs))
    try:
        partial.unlink(missing_ok=True)
        connection = sqlite3.connect(partial)
        try:
            with connection:
                connection.executescript(SCHEMA)
                connection.executemany("INSERT INTO about VALUES (?, ?)", about.items())
                connection.executemany("INSERT INTO runs (id, number, run) VALUES (?, ?, ?)", rows)
        finally:
            connection.close()
        partial.replace(path)
    except (OSError, sqlite3.Error) as error:
        raise OutputError(f"cannot be made: {error}", file=path) from error


def begin(
    target: Path, file: Path, spec: SweepSpec, part: str, environment: Mapping[str, Mapping[str, str]] | None = None
) -> None:
    """Make the file of a sweep, or of a part of it, unless it exists.

    Args:
        target: the file.
        file: of the specification.
        spec: that it holds.
        part: such as ``2/8``.
        environment: versions and hardware, by name.

    Raises:
        ConfigError: the specification names something unknown, or the part is malformed.
        OutputError: the file exists, of another specification or part, or of other scenarios or robots.
    """
    text = spec.model_dump_json(exclude_defaults=True, exclude={"description"})
    number, _, of = part.partition("/")
    if not (number.isdecimal() and of.isdecimal() and 1 <= int(number) <= int(of)):
        raise ConfigError(f"{part!r}, expected a part and how many there are, such as 2/8", field="--shard")
    if target.exists():
        with opened(target) as store:
            if store.spec != text:
                raise OutputError("is of another specification, expected another --out", file=target)
            if store.part != part:
                raise OutputError(f"holds part {store.part}, not {part}, expected another --out", file=target)
            if store.digest and store.digest != bundled.digest(plan(spec, check=False)):
                problem = "has runs of other scenarios or robots of these names, expected another --out"
                raise OutputError(problem, file=target)
        return
    try:
        runs = plan(spec)
    except ConfigError as error:
        raise ConfigError(error.problem, file=error.file or file, field=error.field) from error
    mine = shard(runs, int(number), int(of))
    create(target, text, mine, part=part, digest=bundled.digest(runs), environment=environment)


def merge(files: Sequence[Path], out: Path) -> dict[str, int]:
    """Put the parts of a sweep together in a new file; how many of its runs have each status.

    Raises:
        InputError: they are parts of different sweeps, or have different results of a run.
        OutputError: the file exists.
    """
    if out.exists():
        raise OutputError("exists already, expected a new file", file=out)
    partial = out.with_name(f".{out.name}.merging")
    with opened(files[0]) as first:
        runs = plan(SweepSpec.model_validate_json(first.spec), check=False)
        create(partial, first.spec, runs, digest=first.digest, environment=first.environment)
    try:
        with opened(partial, write=True) as store:
            for file in files:
                with opened(file) as other:
                    store.take(other)
            counts = store.counts()
        partial.replace(out)
    finally:
        partial.unlink(missing_ok=True)
    return counts
