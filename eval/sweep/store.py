"""The runs of a sweep and what became of them, in one SQLite file that one process writes; and tables of them all."""

import csv
import fcntl
import json
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self
from urllib.parse import quote

from moteslam.errors import ConfigError, InputError, OutputError, in_file
from moteslam.eval.metrics.registry import COSTS
from moteslam.eval.sweep.plan import PlannedRun, digest, plan, shard
from moteslam.eval.sweep.spec import PREFIXES, SUCCESS, SweepSpec
from moteslam.eval.sweep.workers import Outcome
from moteslam.eval.tables import comma_separated, literal
from moteslam.files import read_text, staged_file, write_atomically

VERSION = "2"
WHOLE = "1/1"  # The part of a sweep that is all of it
SCHEMA = """
CREATE TABLE about (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE runs (
    id TEXT PRIMARY KEY, number INTEGER NOT NULL, run TEXT NOT NULL, status TEXT, error TEXT, result TEXT
);
"""
MAX_TABLE = 1_000_000_000  # No exported table is larger
ABOUT = ("id", "scenario", "recording", "platform", "noise", "seed", "configuration")
"""Columns that say which run a row is, beside those with a point that vary."""
Environment = Mapping[str, Mapping[str, str]]  # Versions and hardware, by name
Facts = Environment | None
Key = tuple[Any, ...]
Table = dict[str, dict[str, str]]  # Of each run, by its id, every column as text


@dataclass(frozen=True)
class Row:
    """A run of a sweep as it is recorded, or of a result folder.

    Attributes:
        status: as of ``Outcome``; empty of one that was not made yet.
        scores: by metric, as of ``Value.as_dict``.
        issues: of recording and run.
        succeeded: whether it ended well, with each metric of ``SweepSpec.success`` present and within its limit; None
            where it ended well and one of them was not measured.
        folder: of its result, if it has one.
        facts: versions and hardware of a result folder.
    """

    run: PlannedRun
    status: str
    error: str = ""
    scores: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    issues: tuple[dict[str, Any], ...] = ()
    succeeded: bool | None = False
    folder: Path | None = None
    facts: Environment = field(default_factory=dict)

    @cached_property
    def known(self) -> dict[str, float]:
        """The values that are not absent, by metric."""
        return {name: float(value) for name, one in self.scores.items() if (value := one.get("value")) is not None}

    @property
    def values(self) -> dict[str, float | None]:
        """By metric, None if absent, without the costs."""
        return {name: self.known.get(name) for name in self.scores if name not in COSTS}

    @property
    def costs(self) -> dict[str, float]:
        return {name: value for name, value in self.known.items() if name in COSTS}

    @cached_property
    def about(self) -> dict[str, Any]:
        """What a run has in common with those of other seeds, by column."""
        run = self.run
        place = run.scenario or Path(run.recording).name
        return {
            "scenario": Path(place).stem if place.endswith(".toml") else place,
            "platform": Path(run.platform).stem,
            "noise": run.noise,
            "configuration": run.configuration,
            "version": run.version,
            **dict(run.varied),
        }

    @property
    def name(self) -> str:
        place = filter(None, (str(self.about[key]) for key in ("scenario", "platform", "noise")))
        return ", ".join((*place, f"seed {self.run.seed}"))

    def renamed(self, configuration: str) -> Self:
        return replace(self, run=self.run.model_copy(update={"configuration": configuration}))


def within(scores: Mapping[str, Mapping[str, Any]], limits: Mapping[str, float] = SUCCESS) -> bool | None:
    """Whether each of some metrics is present and within its limit; None where one was not measured."""
    if not scores.keys() >= limits.keys():
        return None
    values = {name: scores.get(name, {}).get("value") for name in limits}
    return all(value is not None and value <= limits[name] for name, value in values.items())


class Store:
    """An open file of a sweep, or of a part such as ``2/8``: its specification as JSON, the digest of all of its runs,
    and the versions and hardware of the computer that made it, empty where these were not recorded.
    """

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        about = dict(connection.execute("SELECT key, value FROM about"))
        if about.get("version") != VERSION:
            raise InputError(f"version {about.get('version', '')!r}, expected {VERSION}", file=path)
        self.path, self._connection = path, connection
        self.spec, self.part, self.digest = str(about["spec"]), str(about["part"]), str(about.get("digest", ""))
        self.environment: dict[str, dict[str, str]] = json.loads(about.get("environment", "{}"))
        self.success: dict[str, float] = json.loads(self.spec).get("success", SUCCESS)

    def pending(self, *, again: bool = False) -> list[PlannedRun]:
        """The runs that were not made yet, in their order, and after them those that did not end well, if ``again``."""
        which = "status IS NULL" + " OR status != 'ok'" * again
        found = self._connection.execute(f"SELECT run FROM runs WHERE {which} ORDER BY status IS NOT NULL, number")
        return [PlannedRun.model_validate_json(text) for (text,) in found]

    def counts(self) -> dict[str, int]:
        """How many runs have each status; ``""`` are those not made yet."""
        return dict(self._connection.execute("SELECT coalesce(status, ''), count(*) FROM runs GROUP BY 1 ORDER BY 1"))

    def record(self, outcome: Outcome[PlannedRun]) -> None:
        result = json.dumps(outcome.result)
        with self._connection as connection:
            about = (outcome.status, outcome.error, result, outcome.run.id)
            connection.execute("UPDATE runs SET status = ?, error = ?, result = ? WHERE id = ?", about)

    def rows(self) -> Iterator[Row]:
        columns = "run, coalesce(status, ''), coalesce(error, ''), coalesce(result, '{}')"
        for text, status, error, result in self._connection.execute(f"SELECT {columns} FROM runs ORDER BY number"):
            found = json.loads(result)
            scores, issues = dict(sorted(found.get("values", {}).items())), tuple(found.get("issues", ()))
            succeeded = status == "ok" and within(scores, self.success)
            yield Row(PlannedRun.model_validate_json(text), status, error, scores, issues, succeeded)

    def extend(self, runs: Sequence[PlannedRun], spec: str) -> None:
        """Add the runs that are new in a specification of more seeds."""
        if not {row.run.id for row in self.rows()} <= {run.id for run in runs}:
            raise OutputError("has other seeds, expected them and more, or another --out", file=self.path)
        added = ((run.id, number, run.model_dump_json()) for number, run in enumerate(runs))
        place = "ON CONFLICT (id) DO UPDATE SET number = excluded.number"
        with self._connection as connection:
            connection.executemany(f"INSERT INTO runs (id, number, run) VALUES (?, ?, ?) {place}", added)
            about = (spec, "spec"), (digest(runs), "digest")
            connection.executemany("UPDATE about SET value = ? WHERE key = ?", about)

    def take(self, other: Self) -> None:
        """Take over what another part of the same sweep has and this one has not."""
        if (other.spec, other.digest) != (self.spec, self.digest):
            raise InputError("of another sweep, expected parts of one", file=other.path)
        mine = {row.run.id: row for row in self.rows() if row.status}
        for row in (row for row in other.rows() if row.status):
            known = mine.get(row.run.id)
            if known is None:
                self.record(Outcome(row.run, row.status, row.error, {"values": row.scores, "issues": row.issues}))
            elif (known.status, known.values) != (row.status, row.values):
                raise InputError(f"another result of {row.run.name}, expected the same", file=other.path)


@contextmanager
def opened(path: Path, *, write: bool = False) -> Iterator[Store]:
    """Open a file of a sweep, alone if it is to be written."""
    if path.is_dir():
        problem = "is a folder, expected a file that `moteslam sweep` made; `moteslam compare` takes folders of runs"
        raise InputError(problem, file=path)
    if not path.is_file():
        raise InputError("there is no such file or folder, expected a .sweep file or a result folder", file=path)
    if path.suffix == ".toml":
        raise InputError(f"is a specification, expected the file that `moteslam sweep {path.name}` makes", file=path)
    if path.stat().st_size == 0:
        raise InputError("is empty, expected what `moteslam sweep` made", file=path)
    # SQLite's own locks are of another kind, and are lost where the file is closed: it stays open beyond the connection
    with path.open("rb") as file:
        if write:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise OutputError("another sweep writes it, expected another file", file=path) from None
            except OSError:  # a file system without locks
                pass
        # for reading, too: where a process was killed amid a transaction, only one that may write can roll it back
        with closing(sqlite3.connect(f"file:{quote(str(path.absolute()))}?mode=rw", uri=True)) as connection:
            try:
                if not write:
                    connection.execute("PRAGMA query_only = ON")
                store = Store(path, connection)
            except sqlite3.DatabaseError as error:
                raise InputError(f"no file of a sweep: {error}", file=path) from error
            yield store


def create(
    path: Path, spec: str, runs: Iterable[PlannedRun], *, part: str = WHOLE, digest: str = "", environment: Facts = None
) -> None:
    """Make the file of a sweep, complete or not at all; the specification is JSON."""
    facts = json.dumps(environment or {})
    about = {"version": VERSION, "spec": spec, "part": part, "digest": digest, "environment": facts}
    rows = ((run.id, number, run.model_dump_json()) for number, run in enumerate(runs))
    try:
        with staged_file(path) as partial, closing(sqlite3.connect(partial)) as connection, connection:
            connection.executescript(SCHEMA)
            connection.executemany("INSERT INTO about VALUES (?, ?)", about.items())
            connection.executemany("INSERT INTO runs (id, number, run) VALUES (?, ?, ?)", rows)
    except sqlite3.Error as error:
        raise OutputError(f"cannot be made: {error}", file=path) from error


def begin(target: Path, file: Path, spec: SweepSpec, part: str, environment: Facts = None) -> None:
    """Make the file of a sweep, or of a part such as ``2/8``; one that exists must be of the same, but for more seeds.

    ``file`` is that of the specification, for errors.
    """
    text = spec.model_dump_json(exclude_defaults=True, exclude={"description"})
    number, _, of = part.partition("/")
    if not (number.isdecimal() and of.isdecimal() and 1 <= int(number) <= int(of)):
        raise ConfigError(f"{part!r}, expected a part and how many there are, such as 2/8", field="--shard")
    if target.exists():
        with opened(target) as store:
            tables = (json.loads(one) for one in (text, store.spec))
            mine, theirs = ({key: json.dumps(value) for key, value in table.items()} for table in tables)
            differ = [key for key in {**mine, **theirs} if mine.get(key) != theirs.get(key)]
            more, problem = differ == ["seeds"] and part == WHOLE, ""
            if differ and not more:
                problem = f"differs in {', '.join(differ)} from what was run there"
            elif store.part != part:
                problem = f"holds part {store.part}, not {part}"
            elif store.digest not in ("", digest(plan(SweepSpec.model_validate_json(store.spec), check=False))):
                problem = "its scenarios, robots or plug-ins have changed since its runs"
            if problem:
                with in_file(file):
                    plan(spec)  # what is wrong with it comes first
                raise OutputError(f"{problem}, expected another --out", file=target)
        if more:
            with in_file(file), opened(target, write=True) as store:
                store.extend(plan(spec), text)
        return
    with in_file(file):
        runs = plan(spec)
    create(target, text, shard(runs, int(number), int(of)), part=part, digest=digest(runs), environment=environment)


def merge(files: Sequence[Path], out: Path) -> dict[str, int]:
    """Put the parts of a sweep together in a new file; how many of its runs have each status."""
    if out.exists():
        raise OutputError("exists already, expected a new file", file=out)
    with staged_file(out) as partial:
        with opened(files[0]) as first:
            runs = plan(SweepSpec.model_validate_json(first.spec), check=False)
            create(partial, first.spec, runs, digest=first.digest, environment=first.environment)
        with opened(partial, write=True) as store:
            for file in files:
                with opened(file) as other:
                    store.take(other)
            return store.counts()


def read_table(path: Path) -> Table:
    """The runs of a sweep, or of a table that ``sweep export`` wrote, those that were made."""
    if path.suffix == ".csv":
        rows = list(csv.DictReader(read_text(path, "a table of a sweep", limit=MAX_TABLE).splitlines()))
        if not rows or not set(rows[0]) >= {*ABOUT, "status", "error"}:
            raise InputError("expected a table that `moteslam sweep export` wrote", file=path)
    else:
        with opened(path) as store:
            rows = list(csv.DictReader(as_csv(list(store.rows())).splitlines()))
    return {row["id"]: {name: value or "" for name, value in row.items()} for row in rows if row["status"]}


def differences(first: Table, second: Table) -> list[dict[str, str]]:
    """The cells of the runs that both have which differ, times and memory left out, in the order of the first.

    Of each: ``run``, in words, ``column``, and what stands there in the ``first`` and the ``second``.
    """
    found = []
    for row, other in ((row, second[run]) for run, row in first.items() if run in second):
        place = row["scenario"] or Path(row["recording"]).name
        varied = (f"{key}={value}" for key, value in row.items() if key.startswith(PREFIXES))
        parts = (place, row["platform"], row["noise"], f"seed {row['seed']}", row["configuration"], *varied)
        for column in (name for name in dict.fromkeys((*row, *other)) if name not in COSTS):
            one, two = row.get(column, ""), other.get(column, "")
            if one != two:
                found.append({"run": ", ".join(filter(None, parts)), "column": column, "first": one, "second": two})
    return found


def columns(rows: Sequence[Row]) -> dict[str, list[Any]]:
    """Every run as a row: what it is, what became of it, its values, and its times at the end, by column."""

    def each(*mappings: Mapping[str, Any]) -> dict[str, list[Any]]:
        names = dict.fromkeys(name for one in mappings for name in one)
        return {name: [one.get(name) for one in mappings] for name in names}

    table: dict[str, list[Any]] = {name: [getattr(row.run, name) for row in rows] for name in ABOUT}
    if any(row.run.version for row in rows):
        table["version"] = [row.run.version for row in rows]
    table |= each(*(dict(row.run.varied) for row in rows))
    table |= {"status": [row.status for row in rows], "error": [literal(row.error) for row in rows]}
    return table | each(*(row.values for row in rows)) | each(*(row.costs for row in rows))


def as_csv(rows: Sequence[Row]) -> str:
    """The columns as CSV: numbers with the fewest digits that read back the same, empty for None."""
    table = columns(rows)
    return comma_separated([list(table), *zip(*table.values(), strict=True)]) + "\n"


def write_parquet(path: Path, rows: Sequence[Row]) -> None:
    """Write the columns as Parquet."""
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        raise OutputError("needs pyarrow, expected it installed: pip install 'moteslam[parquet]'", file=path) from error
    table = pyarrow.BufferOutputStream()
    parquet.write_table(pyarrow.table(columns(rows)), table)
    write_atomically(path, table.getvalue().to_pybytes())
