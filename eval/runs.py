"""Runs with their figures, read from sweeps and result folders alike, grouped, summed up, and told apart."""

import re
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple, TypeVar

from pydantic import BaseModel, ValidationError

from moteslam.errors import ConfigError, InputError
from moteslam.eval.metrics.evidence import DEAD_RECKONING
from moteslam.eval.metrics.registry import Metric, chosen, metric, split, title_of
from moteslam.eval.statistics import Better, Comparison, Proportion, Summary, compare
from moteslam.eval.sweep.plan import ALONE, PlannedRun
from moteslam.eval.sweep.spec import PREFIXES
from moteslam.eval.sweep.store import Key, Row, opened, within
from moteslam.eval.tables import fitting, number
from moteslam.files import read_text
from moteslam.robot.values import first_complaint, interval

MAX_BYTES = 50_000_000  # No file of a result folder that is read here is larger
SETTINGS = ("scenario", "platform", "noise")  # Columns that say where a run was made
CONFIGURATION = "configuration"
NUMBERS = re.compile(r"[0-9]+(\.[0-9]+)?")
MOST_NAMED, UNLIKE = 6, 1.2
"""Metrics that are shown unasked, and from which ratio on robots have driven other distances."""
G = TypeVar("G", bound=Hashable)
M = TypeVar("M", bound=BaseModel)
R = TypeVar("R")


class _Score(BaseModel):
    value: float | None = None
    unit: str | None = None
    absent: str | None = None


class _Scores(BaseModel):
    metrics: dict[str, _Score]
    scans: int | None = None


class _About(BaseModel):
    scenario: str | None = None
    platform: str = ""
    recording: str | None = None
    seed: int = 0
    warnings: tuple[dict[str, Any], ...] = ()
    versions: dict[str, Any] = {}
    hardware: dict[str, Any] = {}


def read_result_folder(folder: Path) -> Row:
    """Read ``metrics.json`` and ``run.json``; the configuration is named by the folder."""
    found = _read(_Scores, folder / "metrics.json")
    about = _read(_About, folder / "run.json")
    name = about.scenario or about.recording or folder.absolute().name
    run = PlannedRun(scenario=name, platform=about.platform, seed=about.seed, configuration=str(folder))
    scores = {name: one.model_dump(exclude_none=True) for name, one in found.metrics.items()}
    scores |= {} if found.scans is None else {"scans": {"value": found.scans}}
    tables = {"versions": about.versions, "hardware": about.hardware}
    facts = {title: {name: str(value) for name, value in table.items()} for title, table in tables.items()}
    return Row(run, "ok", "", scores, about.warnings, within(scores), folder, facts)


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


def grouped(rows: Iterable[R], by: Callable[[R], G]) -> dict[G, list[R]]:
    """Runs by what they have in common, in the order of the first ones."""
    groups: dict[G, list[R]] = {}
    for row in rows:
        groups.setdefault(by(row), []).append(row)
    return groups


def axis_of(rows: Sequence[Row], given: str | None = None, baseline: str | None = None) -> str:
    """The column that runs are compared by: the configuration, with what varies, or of one alone robot or noise.

    Configurations that are asked for, or that the baseline is one of, are compared at equal values of what varies,
    unless it varies of some alone: a program has no keys of SLAM.
    """
    if given == CONFIGURATION or given is None:
        varied = {tuple(key for key, _ in row.run.varied) for row in rows}
        if len(varied) == 1 and any(varied) and (given or baseline in {row.run.configuration for row in rows}):
            return ALONE
    several = [key for key in (CONFIGURATION, *SETTINGS[1:]) if len({_value(row, key) for row in rows}) > 1]
    if given is None:
        return next(iter(several), CONFIGURATION)
    known = varying([row.about for row in rows])
    if given not in known:
        raise ConfigError(f"{given!r}, expected one of {', '.join(known)}", field="--by")
    return given


def compared(rows: Iterable[Row], axis: str = CONFIGURATION, baseline: str | None = None) -> dict[str, list[Row]]:
    """Runs by their value of an axis, in the order of the specification; the baseline, if given, is one of these."""
    found = grouped(rows, lambda row: str(_value(row, axis)) or f"without {axis}")
    if baseline is not None and baseline not in found:
        raise ConfigError(f"{baseline!r}, expected one of {', '.join(map(repr, found))}", field="--baseline")
    return found


def _value(row: Row, axis: str, *but: str) -> Any:
    if axis == CONFIGURATION:
        return row.run.configured(*but)
    return row.run.configuration if axis == ALONE else row.about.get(axis, "")


def _settings(row: Row) -> Sequence[str]:
    return SETTINGS if row.folder is None else ("scenario", "noise")


def apart(rows: Sequence[Row], *but: str) -> list[str]:
    """What sets runs apart of scenario, robot, noise and configuration, some left out."""
    keys = [key for key in (*SETTINGS, CONFIGURATION) if key not in but]
    return [key for key in keys if len({_value(row, key, *but) for row in rows}) > 1]


def name_of(row: Row, keys: Iterable[str], *but: str) -> str:
    """The values of a run in some columns, for people; without what varies of a column that is left out."""
    return ", ".join(str(value) for key in keys if (value := _value(row, key, *but)) != "")


def comparisons(rows: Sequence[Row], name: str, axis: str, first: str) -> dict[str, dict[str, Comparison]]:
    """Each value of an axis against the first, in pairs: by scenario, robot and whatever else sets runs apart.

    Where there are several such places a last comparison is of all of them; its differences, which may be centimetres
    of one and metres of another, have no common median.
    """
    known = (*_settings(rows[0]), CONFIGURATION) if axis == CONFIGURATION else (*SETTINGS, CONFIGURATION)
    settings = [key for key in known if key in SETTINGS and key != axis]
    keys = [key for key in apart(rows, axis) if key in known] or settings
    places = grouped(rows, lambda row: name_of(row, keys, axis))
    found: dict[str, dict[str, Comparison]] = {}
    for other in compared(rows, axis):
        if other == first:
            continue
        each = {}
        for place, some in (*places.items(), ("", rows)):
            both = ([row for row in some if str(_value(row, axis)) == one] for one in (first, other))
            each[place] = compare(*(values_of(one, name, axis) for one in both), better=better(name))
        whole = replace(each.pop(""), median=None, low=None, high=None)
        each = {place: one for place, one in each.items() if one.pairs}
        found[other] = each if len(each) < 2 else {**each, f"{len(each)} places together": whole}
    return found


def known_metric(name: str) -> Metric:
    """The metric of that name; without unit and words of scans, of distance, or of a plug-in that is not here."""
    try:
        return metric(name)
    except ConfigError:
        return Metric("", "", "", of_run=lambda _: None)


def better(name: str) -> Better:
    """Which values of a metric are better; lower of one where neither is."""
    return known_metric(name).better or "lower"


class Shown(NamedTuple):
    """A metric as tables and charts show it: words with the unit, ``final ATE [mm]``, and the factor to that."""

    name: str
    title: str
    factor: float = 1.0

    @property
    def ways(self) -> tuple[str, str]:
        """What a smaller and a larger value than the other's is called, or, of a metric that knows it, a better one."""
        return ("better", "worse") if known_metric(self.name).better else ("lower", "higher")

    def text(self, value: float | None, *, sign: bool = False) -> str:
        return number(None if value is None else self.factor * value, sign=sign)

    def median(self, one: Mapping[str, Any], *, sign: bool = False) -> tuple[str, str]:
        """That of a summary or a comparison, and its interval."""
        middle, low, high = (self.text(one[end], sign=sign) for end in ("median", "low", "high"))
        return middle, interval(low, high)


def headings(rows: Sequence[Row], names: Sequence[str]) -> dict[str, Shown]:
    """How metrics are shown, in every table of the same runs, with the units that were recorded.

    It fits the median over the runs; one metric of several trajectories has one, which its median and maximum share.
    """
    units = {name: unit for row in rows for name, one in row.scores.items() if (unit := one.get("unit"))}
    groups = list(grouped(rows, lambda row: tuple(row.about.items())).values())
    there, found = dict.fromkeys((*names, *(name for row in rows for name in row.scores))), {}
    for name in names:
        short = split(name)[1]
        whole = short.removesuffix("_median").removesuffix("_max")
        alike = [one for one in there if split(one)[1] == whole] or [one for one in there if split(one)[1] == short]
        medians = [summary_of(some, one).median for one in alike for some in groups]
        unit, factor = fitting(units.get(name) or known_metric(name).unit, medians)
        found[name] = Shown(name, f"{title_of(name)} [{unit}]" if unit else title_of(name), factor)
    return found


def driven(rows: Iterable[Row]) -> float | None:
    """The median of the distances driven [m], where these are known."""
    metres = [row.known["distance"] for row in rows if "distance" in row.known]
    return median(metres) if metres else None


def driven_by(rows: Iterable[Row]) -> str:
    """By what the distances are known: the truth, SLAM's path, or these in turn."""
    by = {row.scores["distance"].get("by", "SLAM's path") for row in rows if "distance" in row.known}
    return " or ".join(sorted(by)) or "truth"


def warnings_of(rows: Iterable[Row]) -> list[str]:
    """What is doubtful in runs: of each configuration the first of those that differ in numbers alone, and how many."""
    each = ((row, str(issue.get("message"))) for row in rows for issue in row.issues)
    alike = grouped(each, lambda one: (one[0].run.configured(), NUMBERS.sub("0", one[1])))
    lines = []
    for message, kinds in grouped(alike.values(), lambda some: some[0][1]).items():
        first, others = kinds[0][0][0], sum(map(len, kinds)) - 1
        of = list(dict.fromkeys(some[0][0].run.configured() for some in kinds))
        names = "; ".join(of[:MOST_NAMED]) + (f" and {len(of) - MOST_NAMED} more" if of[MOST_NAMED:] else "")
        more = f" ({others} more such)" if others else ""
        lines.append(f"{first.name}, {names}: {message}{more}")
    return lines


def unlike(distances: Iterable[float | None]) -> bool:
    """Whether so different distances were driven that errors say little of which is better."""
    known = [each for each in distances if each is not None]
    return bool(known) and max(known) > UNLIKE * min(known)


def also_of(columns: Mapping[str, Sequence[Row]], axis: str) -> str:
    """What differs, too, where whole robots are compared, with the distances driven where these are unlike."""
    far = {name: driven(rows) for name, rows in columns.items()}
    text = "wheels, gyro and speed of a platform may differ, too"
    if unlike(far.values()):
        by = driven_by(row for rows in columns.values() for row in rows)
        ways = [f"{name} {number(metres)} m" for name, metres in far.items() if metres]
        text += f"; way driven, by {by}: {', '.join(ways)}"
    return text if axis == "platform" else ""


def metric_names(given: list[str] | None, rows: Sequence[Row] = ()) -> list[str]:
    """The metrics that are asked for, without a trajectory of each but dead reckoning; one that is unknown, or that no
    run has, is refused. Else the first of those that sweeps name and have measured, else ``final.ate``, or what there
    is.
    """
    chosen(given or ())
    there = dict.fromkeys(name for row in rows for name in row.known)
    named = dict.fromkeys(name for row in rows for name in row.run.metrics)
    # dead reckoning is the same in all configurations
    shown = {one: "" if split(one)[0] == DEAD_RECKONING else split(one)[1] for one in there}
    usual = [name for name in dict.fromkeys(("final.ate", *there)) if name in there.keys() - {"scans", "distance"}]
    if given and usual:
        if missing := [name for name in given if name not in {*usual, *shown.values()}]:
            expected = ", ".join(usual)
            raise ConfigError(f"{missing[0]!r}, which no run has; expected one of {expected}", field="--metric")
        return list(dict.fromkeys(one for name in given for one in usual if name in (one, shown[one])))
    found = dict.fromkeys(one for name in named for one, short in shown.items() if name in (one, short))
    return given or [*found][:MOST_NAMED] or usual[:1] or ["final.ate"]


def missing_of(rows: Iterable[Row]) -> dict[str, str]:
    """Of the metrics that sweeps name those that no run has which ended well, and why, as the first of these says."""
    good = [row for row in rows if row.status == "ok"]
    found = {}
    for name in dict.fromkeys(name for row in good for name in row.run.metrics):
        scores = [one for row in good for key, one in row.scores.items() if name in (key, split(key)[1])]
        if all(one.get("value") is None for one in scores):
            found[name] = next((str(one["absent"]) for one in scores if "absent" in one), "not measured")
    return found


def success_of(rows: Sequence[Row]) -> Proportion | None:
    """How many runs succeeded; None where that was not measured of some."""
    found = [row.succeeded for row in rows]
    return None if None in found else Proportion(found.count(True), len(found))


def success_words(limits: Mapping[str, float]) -> str:
    """When a run succeeds: ``final ATE at most 0.5 m``."""
    each = ((title_of(name), f"{most:g} {known_metric(name).unit}".strip()) for name, most in limits.items())
    return ", ".join(f"{title} at most {most}" for title, most in each)


def values_of(rows: Iterable[Row], name: str, axis: str = CONFIGURATION) -> dict[Key, float | None]:
    """One metric's, None of runs that failed; runs of which it is absent are left out.

    By what two runs of a pair have in common: all but the axis; of result folders the robot may differ.
    """

    def pair(row: Row) -> Key:
        keys = row.about if axis != CONFIGURATION else _settings(row)
        of_axis = (CONFIGURATION, "version") if axis == ALONE else (axis,)  # a configuration has one version
        return (*(row.about[key] for key in keys if key not in of_axis), row.run.duration, row.run.seed)

    having = (row for row in rows if row.status != "ok" or name in row.known)
    return {pair(row): row.known[name] if row.status == "ok" else None for row in having}


def summary_of(rows: Iterable[Row], name: str) -> Summary:
    """The values of a metric over runs; those that failed count as the worst."""
    rows = list(rows)
    good = [row for row in rows if row.status == "ok"]
    return Summary.of([row.known.get(name) for row in good], len(rows) - len(good), better=better(name))


def key_words(key: str) -> str:
    """A column in words: ``slam.tracking.window`` as ``tracking window``."""
    return (key.partition(".")[2] if key.startswith(PREFIXES) else key).replace(".", " ").replace("_", " ")


def varying(groups: Sequence[Mapping[str, Any]]) -> list[str]:
    """The columns in which some of the groups have something."""
    keys = dict.fromkeys(key for group in groups for key in group)
    return [key for key in keys if any(group.get(key, "") != "" for group in groups)]
