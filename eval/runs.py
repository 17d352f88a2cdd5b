"""Runs with their figures, read from sweeps and result folders alike, grouped, and summed up."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from moteslam.errors import ConfigError, InputError
from moteslam.eval.metrics.registry import metric
from moteslam.eval.statistics import Better, Summary
from moteslam.eval.sweep.plan import PlannedRun
from moteslam.eval.sweep.store import Key, Row, opened, within
from moteslam.robot.files import read_text
from moteslam.robot.tables import first_complaint

MAX_BYTES = 50_000_000
"""No file of a result folder that is read here is larger."""
SETTINGS = ("scenario", "platform", "noise")
"""Columns that say where a run was made."""
G = TypeVar("G", bound=Hashable)
M = TypeVar("M", bound=BaseModel)


class _Score(BaseModel):
    value: float | None = None
    unit: str = ""
    absent: str = ""


class _Scores(BaseModel):
    metrics: dict[str, _Score]


class _Warning(BaseModel):
    message: str


class _About(BaseModel):
    """What is read of ``run.json``."""

    scenario: str | None = None
    recording: str | None = None
    seed: int = 0
    warnings: tuple[_Warning, ...] = ()
    versions: dict[str, Any] = {}
    hardware: dict[str, Any] = {}


def is_result_folder(folder: Path) -> bool:
    """Whether a folder holds the two files that ``read_result_folder`` reads."""
    return all((folder / name).is_file() for name in ("metrics.json", "run.json"))


def read_result_folder(folder: Path) -> Row:
    """Read ``metrics.json`` and ``run.json``; the configuration is named by the folder."""
    scores = _read(_Scores, folder / "metrics.json").metrics
    about = _read(_About, folder / "run.json")
    run = PlannedRun(
        scenario=about.scenario or about.recording or folder.absolute().name,
        seed=about.seed,
        configuration=str(folder),
    )
    return Row(
        run,
        "ok",
        "",
        values={name: one.value for name, one in scores.items()},
        units={name: one.unit for name, one in scores.items() if one.value is not None},
        absent={name: one.absent for name, one in scores.items() if one.value is None},
        issues=tuple(one.model_dump() for one in about.warnings),
        succeeded=within({name: one.value for name, one in scores.items()}),
        folder=folder,
        facts={
            title: {name: str(value) for name, value in getattr(about, title).items()}
            for title in ("versions", "hardware")
        },
    )


def _read(model: type[M], file: Path) -> M:
    try:
        return model.model_validate_json(read_text(file, "a file of a result folder", limit=MAX_BYTES))
    except ValidationError as error:
        field, problem = first_complaint(error)
        raise InputError(problem, file=file, field=field or None) from error


def read_runs(paths: Sequence[Path]) -> list[Row]:
    """The runs of sweeps and result folders, those not made yet too."""
    found: list[Row] = []
    for path in paths:
        if path.is_dir():
            found.append(read_result_folder(path))
        else:
            with opened(path) as store:
                found += [row.renamed(prefix_of(path, paths) + row.run.configuration) for row in store.rows()]
    return found


def prefix_of(path: Path, paths: Sequence[Path]) -> str:
    """What the names of a sweep's configurations begin with among several: its name, its path where two are alike."""
    if len(paths) == 1:
        return ""
    alike = sum(other.stem == path.stem for other in paths) > 1
    return f"{path if alike else path.stem}: "


def grouped(rows: Iterable[Row], by: Callable[[Row], G]) -> dict[G, list[Row]]:
    """Runs by what they have in common, in the order of the first ones."""
    groups: dict[G, list[Row]] = {}
    for row in rows:
        groups.setdefault(by(row), []).append(row)
    return groups


def by_configuration(rows: Iterable[Row]) -> dict[str, list[Row]]:
    """Runs by their configuration, with what varies."""
    return grouped(rows, lambda row: row.run.configured)


def better(name: str) -> Better:
    """Which values of a metric are better; lower of one where neither is."""
    try:
        return metric(name).better or "lower"
    except ConfigError:  # scans, distance, or of a plug-in that is not here
        return "lower"


def unit_of(name: str) -> str:
    """Of a metric; empty for what is none."""
    try:
        return metric(name).unit
    except ConfigError:
        return ""


def values_of(rows: Iterable[Row], name: str) -> dict[Key, float | None]:
    """One metric's by case, None of runs that failed; runs of which it is absent are left out."""
    return {
        row.case: row.known[name] if row.status == "ok" else None
        for row in rows
        if row.status != "ok" or name in row.known
    }


def summary_of(rows: Iterable[Row], name: str) -> Summary:
    """The values of a metric over runs; those that failed count as the worst."""
    rows = list(rows)
    good = [row for row in rows if row.status == "ok"]
    return Summary.of([row.known.get(name) for row in good], len(rows) - len(good), better=better(name))


@dataclass(frozen=True)
class Line:
    """The runs of one scenario and configuration, by their values of a column.

    Attributes:
        where, how: what sets the line apart from the others: its scenario, robot and noise; all else.
        name: all that it is, in words.
        groups: its runs by value.
    """

    where: tuple[str, ...]
    how: tuple[str, ...]
    name: str
    groups: Mapping[Any, Sequence[Row]]

    @property
    def label(self) -> str:
        """What sets it apart, in words; empty of a single line."""
        return ", ".join((*self.where, *self.how))


def lines_over(rows: Iterable[Row], column: str) -> list[Line]:
    """The lines of a chart over a column of ``Row.about``; runs without it are left out."""
    members: dict[tuple[tuple[str, str], ...], list[Row]] = grouped(
        (row for row in rows if column in row.about),
        lambda row: tuple((key, _words(key, value)) for key, value in row.about.items() if key != column),
    )
    common = set.intersection(*map(set, members)) if members else set()
    lines = []
    for parts, runs in members.items():
        apart = [part for part in parts if part not in common and part[1]]
        where = tuple(words for key, words in apart if key in SETTINGS)
        how = tuple(words for key, words in apart if key not in SETTINGS)
        name = ", ".join(words for _, words in parts if words)
        lines.append(Line(where, how, name, grouped(runs, lambda row: row.about[column])))
    return lines


def _words(key: str, value: Any) -> str:
    if key in (*SETTINGS, "configuration") or value == "":
        return str(value)
    return f"{key}={value}"


def varying(groups: Sequence[Mapping[str, Any]]) -> list[str]:
    """The columns in which some of the groups have something."""
    keys = dict.fromkeys(key for group in groups for key in group)
    return [key for key in keys if any(group.get(key, "") != "" for group in groups)]
