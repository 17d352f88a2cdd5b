"""The metrics by name, the bundled ones and those of other packages, and the values of a run.

The bundled ones stand in ``bundled.csv``: name, title, unit, which values are better, source, meaning, and where it is
found in a ``Track`` or in ``Evidence``, unless one of ``FIGURES`` computes it. Other packages bring theirs as entry
points ``moteslam.metrics``. A metric that cannot be had of a run is absent with its reason, never zero.
"""

import csv
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from math import isfinite
from operator import attrgetter
from pathlib import Path
from typing import Any, get_args

import numpy as np

from moteslam.errors import ConfigError, InputError
from moteslam.eval.metrics.ate import PoseErrors, absolute_trajectory_error
from moteslam.eval.metrics.evidence import FINAL, Evidence, Track, needed
from moteslam.eval.metrics.residuals import scan_residuals
from moteslam.eval.metrics.rpe import Unit, drift, loop_closing_error, relative_pose_error
from moteslam.eval.statistics import Better, Statistics
from moteslam.plugins import Plugins
from moteslam.slam.filter.certainty import LocalisationState

Found = float | None | tuple[float | None, Mapping[str, Any]]
"""What a metric returns: a number, or a number and further figures of the same errors."""
MOVED = 0.05  # Positions spread by less [m] say nothing of heading and scale

RPE = re.compile(r"rpe_(?P<delta>[0-9]+(?:\.[0-9]+)?)(?P<unit>m|s|frames)(?P<rotation>_rotation)?")
"""Names of relative errors over any length, time or number of poses."""


@dataclass(frozen=True)
class Metric:
    """A metric: of each trajectory of a run, or of the run.

    Attributes:
        unit: of the value: ``m``, ``deg``, ...; empty for shares and counts.
        meaning, source: what it measures, one sentence, and where its definition comes from.
        of_trajectory, of_run: computes it; one of the two. ``InputError`` where it cannot be had.
        better: which values are better; None where neither is.
        costly: takes seconds: measured when asked for by name.
    """

    unit: str
    meaning: str
    source: str
    of_trajectory: Callable[[Track], Found] | None = None
    of_run: Callable[[Evidence], Found] | None = None
    better: Better | None = "lower"
    costly: bool = False

    def __post_init__(self) -> None:
        if (self.of_trajectory is None) == (self.of_run is None):
            raise ConfigError("expected either of_trajectory or of_run", field="metric")


def _others(errors: Statistics, *but: str) -> dict[str, Any]:
    """All statistics but the RMSE, which is the value, and some."""
    return {name: value for name, value in errors.as_dict().items() if name not in ("rmse", *but)}


def _rotation(errors: PoseErrors) -> tuple[float, dict[str, Any]]:
    angle = needed(errors.rotation, "orientation").rmse
    return float(np.rad2deg(angle)), _others(needed(errors.rotation_deg, "orientation"))


def _moved(track: Track) -> Track:
    """The track, if the robot moved: else the alignment leaves heading and scale open."""
    spread = track.ate.reference[:, :2].std(axis=0)
    if float(np.hypot(*spread)) < MOVED:
        raise InputError(f"the robot stood still, expected positions that spread by {MOVED:g} m")
    return track


def _nees(run: Evidence) -> Found:
    found = run.localisation.as_dict()["nees"]
    return None if found is None else (found["mean"], {"median": found["median"]})


def _quantile(run: Evidence, share: float) -> float | None:
    times = run.time_taken.per_scan
    return 1e3 * float(np.quantile(times, share)) if times else None


def _of_loops(run: Evidence, name: str, *more: str) -> Found:
    found = run.loop_result
    if (share := getattr(found, name)) is None:
        raise InputError(next(issue.message for issue in found.issues if issue.code == f"no-loop-{name}"))
    return share, {each: getattr(found, each) for each in more}


FIGURES: dict[str, Callable[[Any], Found]] = {
    "ate": lambda track: (
        track.ate.rmse,
        {**_others(track.ate.translation, "median", "max"), "transform": track.ate.transform.tolist()},
    ),
    "ate_scaled": lambda track: _moved(track).once(absolute_trajectory_error, scale=True).rmse,
    "ate_from_start": lambda track: track.once(absolute_trajectory_error, from_start=True).rmse,
    "heading": lambda track: _rotation(_moved(track).ate),
    "drift": lambda track: float(track.once(drift).translation.mean()),
    "drift_rotation": lambda track: float(np.rad2deg(track.once(drift).rotation.mean())),
    "loop_closing": lambda track: track.once(loop_closing_error).rmse,
    "loop_closing_rotation": lambda track: _rotation(track.once(loop_closing_error))[0],
    "relations": lambda track: (
        track.relations.translation.mean,
        {"used": track.relations.pairs, "total": track.relations.total},
    ),
    "residual": lambda track: scan_residuals(*track.under_scans(), scans=track.run.scans).median,
    "nees": _nees,
    "nees_within_95": lambda run: (run.localisation.as_dict()["nees"] or {}).get("within_95"),
    "effective_particles": lambda run: float(needed(run.certainty, "diagnostics").effective.mean()),
    "lost_precision": lambda run: run.localisation.precision(LocalisationState.LOST),
    "lost_recall": lambda run: run.localisation.recall(LocalisationState.LOST),
    "loops_precision": lambda run: _of_loops(run, "precision", "accepted", "overruled", "overruled_false"),
    "loops_recall": lambda run: _of_loops(run, "recall", "possible", "bound"),
    "cpu_per_scan": lambda run: 1e3 * run.time_taken.cpu_seconds / len(run.track(FINAL).trajectory),
    "wall_per_scan": lambda run: 1e3 * run.time_taken.wall_seconds / len(run.track(FINAL).trajectory),
    "wall_per_scan_median": lambda run: _quantile(run, 0.5),
    "wall_per_scan_99": lambda run: _quantile(run, 0.99),
    "real_time_factor": lambda run: float(np.ptp(run.track(FINAL).trajectory.stamps)) / run.time_taken.wall_seconds,
    "memory": lambda run: run.time_taken.memory / 1e6,
}
"""Of a ``Track`` or of ``Evidence``, by the name of the metric."""


def _relative_error(name: str) -> Metric | None:
    found = RPE.fullmatch(name)
    if found is None:
        return None
    delta, unit = float(found["delta"]), next(unit for unit in get_args(Unit) if unit == found["unit"])
    if not delta > 0 or (unit == "frames" and not delta.is_integer()):
        expected = "a whole number of poses from 1 on" if unit == "frames" else "a length above 0"
        raise ConfigError(f"{name!r}, expected {expected}", field="metrics")
    rotation = found["rotation"] is not None
    over = {"m": f"{delta:g} m of path", "s": f"{delta:g} s", "frames": f"{delta:g} poses"}[unit]
    meaning = f"RMSE of the {'rotation' if rotation else 'motion'} between poses {over} apart."

    def of_trajectory(track: Track) -> Found:
        errors = track.once(relative_pose_error, delta=delta, unit=unit)
        return _rotation(errors) if rotation else (errors.rmse, _others(errors.translation))

    return Metric("deg" if rotation else "m", meaning, "Sturm et al. 2012", of_trajectory)


def _bundled(row: dict[str, str]) -> Metric:
    find: Any = attrgetter(row["found"]) if row["found"] else FIGURES[row["name"]]
    of: dict[str, Any] = {"of_trajectory" if row["of"] == "trajectory" else "of_run": find}
    better = next((better for better in get_args(Better) if better == row["better"]), None)
    return Metric(row["unit"], row["meaning"], row["source"], **of, better=better, costly=bool(row["costly"]))


with (Path(__file__).parent / "bundled.csv").open(encoding="utf-8", newline="") as _file:
    _TABLE = {row["name"]: row for row in csv.DictReader(_file)}
BUNDLED = {name: _relative_error(name) or _bundled(row) for name, row in _TABLE.items()}
"""By name, in the order in which they are listed."""
COSTS = tuple(name for name, row in _TABLE.items() if row["of"] == "cost")
"""Names of the metrics that differ from run to run."""
METRICS: Plugins[Metric] = Plugins("moteslam.metrics", Metric, bundled=BUNDLED)  # By name


@dataclass(frozen=True)
class Value:
    """The value of a metric: a finite number, or the reason why there is none.

    ``more`` has further figures of the same errors, such as their ``median``, ``max`` and ``count``.
    """

    number: float | None
    unit: str
    reason: str = ""
    more: Mapping[str, Any] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        if self.number is None:
            return {"absent": self.reason}
        return {"value": self.number, "unit": self.unit, **self.more}


def metric(name: str) -> Metric:
    """The metric of that name: one of ``METRICS``, or a relative error as ``rpe_2.5m`` or ``rpe_10frames_rotation``.

    With or without a trajectory, ``final.ate`` or ``ate``; ``ConfigError`` if there is none.
    """
    short = split(name)[1]
    found = METRICS[short] if short in METRICS.names() else _relative_error(short)
    if found is None:
        of, wanted = split(name.lower())
        names = METRICS.names()
        like = [wanted] if wanted in names else get_close_matches(wanted, names) or names
        near = ", ".join(f"{of}.{one}".removeprefix(".") for one in like)
        raise ConfigError(f"{name!r}, expected {'one of ' * (len(like) > 1)}{near}", field="metrics")
    return found


def title_of(name: str) -> str:
    """A metric in words, with its trajectory: ``final ATE``, ``online RPE over 2.5 m``."""
    track, short = split(name)
    title, error = _TABLE.get(short, {}).get("title"), RPE.fullmatch(short)
    if error is not None:
        over = f"{error['delta']} {'poses' if error['unit'] == 'frames' else error['unit']}"
        title = f"{'rotation ' if error['rotation'] else ''}RPE over {over}"
    return f"{track} {title or short}".strip().replace("_", " ")


def measure(evidence: Evidence, names: Iterable[str] | None = None) -> dict[str, Value]:
    """The values of a run by name, as ``final.ate`` and ``map_f1``, in the order of the names.

    By default all that are not costly. Metrics of trajectories are measured of each, and named by it: ``final.ate``;
    such a name measures it of that one alone. ``ConfigError``: a name that is no metric's.
    """
    values: dict[str, Value] = {}
    for name, one in chosen(names).items():
        track, short = split(name)
        if track and one.of_run is not None:
            raise ConfigError(f"{name!r}, expected {short!r}: a metric of the run", field="metrics")
        for which in [""] if one.of_run is not None else [track] if track else list(evidence.trajectories):
            values[f"{which}.{short}" if which else name] = _value(short, one, evidence, which)
    return values


def chosen(names: Iterable[str] | None) -> Mapping[str, Metric]:
    """The metrics of these names, by default all that are not costly; see ``measure``."""
    if names is None:
        return {name: one for name, one in METRICS.items() if not one.costly}
    return {name: metric(name) for name in names}


def split(name: str) -> tuple[str, str]:
    """The trajectory and the metric of a name such as ``final.rpe_2.5m``; no trajectory in ``rpe_2.5m``."""
    track, dot, short = name.partition(".")
    return (track, short) if dot and not RPE.fullmatch(name) else ("", name)


def _value(name: str, one: Metric, evidence: Evidence, track: str) -> Value:
    try:
        if one.of_trajectory is not None:
            found = one.of_trajectory(evidence.track(track))
        else:
            assert one.of_run is not None
            found = one.of_run(evidence)
        number, more = found if isinstance(found, tuple) else (found, {})
        if number is None or not isfinite(number):
            return Value(None, one.unit, "nothing to measure" if number is None else "not a finite number")
        return Value(float(number), one.unit, more=more)
    except InputError as error:
        return Value(None, one.unit, error.problem)
    except Exception as error:  # a plug-in's fault must not cost the run
        if name in BUNDLED or RPE.fullmatch(name):
            raise
        problem = f"{type(error).__name__}: {error}"
        METRICS.warn(name, problem)
        return Value(None, one.unit, problem)
