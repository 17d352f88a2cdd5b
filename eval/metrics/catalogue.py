"""The metrics of this package: name, unit, meaning and source of each; the modules beside this one compute them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from moteslam.errors import ConfigError, InputError
from moteslam.eval.metrics.ate import PoseErrors, absolute_trajectory_error
from moteslam.eval.metrics.evidence import FINAL, Cost, Evidence, Track, needed
from moteslam.eval.metrics.residuals import scan_residuals
from moteslam.eval.metrics.rpe import Unit, drift, loop_closing_error, relative_pose_error
from moteslam.eval.statistics import Better, Statistics
from moteslam.slam.filter.certainty import LocalisationState

Found = float | None | tuple[float | None, Mapping[str, Any]]
"""What a metric returns: a number, or a number and further figures of the same errors."""

STURM = "Sturm et al. 2012"
GEIGER = "Geiger, Lenz and Urtasun 2012"
KUEMMERLE = "Kuemmerle et al. 2009"
BAR_SHALOM = "Bar-Shalom, Li and Kirubarajan 2001"
OURS = "moteslam"

MOVED = 0.05
"""Positions spread by less [m] say nothing of heading and scale."""


@dataclass(frozen=True)
class Metric:
    """A metric: of each trajectory of a run, or of the run.

    Attributes:
        unit: of the value: ``m``, ``deg``, ...; empty for shares and counts.
        meaning: what it measures, one sentence.
        source: where its definition comes from.
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


def relative_error(delta: float, unit: Unit, *, rotation: bool = False) -> Metric:
    """The relative error over a distance [m], a time [s], or a number of poses."""
    over = {"m": f"{delta:g} m of path", "s": f"{delta:g} s", "frames": f"{delta:g} poses"}[unit]
    meaning = f"RMSE of the {'rotation' if rotation else 'motion'} between poses {over} apart."
    figure = _rotation if rotation else _translation
    return Metric(
        "deg" if rotation else "m",
        meaning,
        STURM,
        lambda track: figure(track.once(relative_pose_error, delta=delta, unit=unit)),
    )


def _translation(errors: PoseErrors) -> Found:
    return errors.rmse, _others(errors.translation)


def _rotation(errors: PoseErrors) -> Found:
    return _degrees(needed(errors.rotation, "orientation").rmse), _others(needed(errors.rotation_deg, "orientation"))


def _others(errors: Statistics) -> dict[str, Any]:
    """All statistics but the RMSE, which is the value."""
    return {name: value for name, value in errors.as_dict().items() if name != "rmse"}


def _degrees(angle: float) -> float:
    return float(np.rad2deg(angle))


def _ate(track: Track) -> Found:
    found = track.ate
    others = {name: value for name, value in _others(found.translation).items() if name not in ("median", "max")}
    return found.rmse, others | {"transform": found.transform.tolist()}


def _moved(track: Track) -> Track:
    """The track, if the robot moved: else the alignment leaves heading and scale open."""
    spread = track.ate.reference[:, :2].std(axis=0)
    if float(np.hypot(*spread)) < MOVED:
        raise InputError(f"the robot stood still, expected positions that spread by {MOVED:g} m")
    return track


def _nees(run: Evidence) -> Found:
    found = run.localisation.as_dict()["nees"]
    return None if found is None else (found["mean"], {"median": found["median"]})


def _within_95(run: Evidence) -> Found:
    found = run.localisation.as_dict()["nees"]
    return None if found is None else float(found["within_95"])


def _of_map(name: str, meaning: str, unit: str = "", better: Better = "higher") -> Metric:
    return Metric(unit, meaning, OURS, of_run=lambda run: getattr(run.map_accuracy, name), better=better)


def _consistency(name: str, unit: str, meaning: str) -> Metric:
    return Metric(
        unit, f"{meaning}; no truth needed.", OURS, lambda track: getattr(track.consistency, name), costly=True
    )


def _share(meaning: str, value: Callable[[Evidence], float | None]) -> Metric:
    return Metric("", meaning, OURS, of_run=value, better="higher")


def _of_filter(meaning: str, value: Callable[[Evidence], Found], source: str = BAR_SHALOM) -> Metric:
    """A figure of which neither higher nor lower values are better."""
    return Metric("", meaning, source, of_run=value, better=None)


def _cost(unit: str, meaning: str, value: Callable[[Cost, Evidence], float | None], better: Better = "lower") -> Metric:
    def of_run(run: Evidence) -> float | None:
        return value(needed(run.cost, "time was measured"), run)

    return Metric(unit, meaning, OURS, of_run=of_run, better=better)


def _scans(run: Evidence) -> int:
    return len(run.track(FINAL).trajectory)


def _driven(run: Evidence) -> float:
    stamps = run.track(FINAL).trajectory.stamps
    return float(stamps[-1] - stamps[0])


def _quantile(cost: Cost, share: float) -> float | None:
    return 1e3 * float(np.quantile(cost.per_scan, share)) if cost.per_scan else None


BUNDLED = {
    "ate": Metric("m", "RMSE of the positions after rigid alignment.", STURM, _ate),
    "ate_median": Metric(
        "m", "Median error of the positions after rigid alignment.", STURM, lambda track: track.ate.translation.median
    ),
    "ate_max": Metric(
        "m", "Largest error of a position after rigid alignment.", STURM, lambda track: track.ate.translation.max
    ),
    "ate_scaled": Metric(
        "m",
        "RMSE of the positions after an alignment that fits the scale, too: ranges or wheels may be off.",
        STURM,
        lambda track: _moved(track).once(absolute_trajectory_error, scale=True).rmse,
    ),
    "ate_from_start": Metric(
        "m",
        "RMSE of the positions where the first poses are laid on each other.",
        STURM,
        lambda track: track.once(absolute_trajectory_error, from_start=True).rmse,
    ),
    "heading": Metric(
        "deg", "RMSE of the headings after rigid alignment.", STURM, lambda track: _rotation(_moved(track).ate)
    ),
    "rpe_1m": relative_error(1.0, "m"),
    "rpe_1m_rotation": relative_error(1.0, "m", rotation=True),
    "rpe_10m": relative_error(10.0, "m"),
    "rpe_10m_rotation": relative_error(10.0, "m", rotation=True),
    "rpe_1s": relative_error(1.0, "s"),
    "rpe_1s_rotation": relative_error(1.0, "s", rotation=True),
    "drift": Metric(
        "m/m",
        "Error of the position per metre of path, mean over parts of 5 to 100 m.",
        GEIGER,
        lambda track: float(track.once(drift).translation.mean()),
    ),
    "drift_rotation": Metric(
        "deg/m",
        "Error of the heading per metre of path, mean over parts of 5 to 100 m.",
        GEIGER,
        lambda track: _degrees(track.once(drift).rotation.mean()),
    ),
    "loop_closing": Metric(
        "m",
        "RMSE of where a place lies when the robot comes back to it, seen from the first visit.",
        OURS,
        lambda track: track.once(loop_closing_error).rmse,
    ),
    "loop_closing_rotation": Metric(
        "deg",
        "RMSE of the heading when the robot comes back to a place, seen from the first visit.",
        OURS,
        lambda track: _degrees(needed(track.once(loop_closing_error).rotation, "orientation").rmse),
    ),
    "relations": Metric(
        "m",
        "Mean error of the translation of hand-checked relations.",
        KUEMMERLE,
        lambda track: track.relations.translation.mean,
    ),
    "relations_rotation": Metric(
        "deg",
        "Mean error of the rotation of hand-checked relations.",
        KUEMMERLE,
        lambda track: needed(track.relations.rotation_deg, "orientation").mean,
    ),
    "residual": Metric(
        "m",
        "Median distance of endpoints to the lines of scans less than 2 m of path away; no truth needed.",
        "Censi 2008",
        lambda track: scan_residuals(*track.under_scans(), scans=track.run.scans).median,
        costly=True,
    ),
    "map_cells": _consistency("cells", "", "Cells of 5 cm that hold an endpoint: fewer are sharper"),
    "map_cells_per_metre": _consistency("cells_per_metre", "1/m", "The same per metre of wall that was seen"),
    "map_near": _consistency(
        "near", "m", "Mean distance of endpoints to the nearest one of scans less than 6 m of path away"
    ),
    "map_far": _consistency(
        "far", "m", "Mean distance of endpoints to the nearest one of scans more than 15 m of path away"
    ),
    "map_thickness": _consistency("thickness", "m", "Median standard deviation of endpoints across their wall"),
    "map_twice": _consistency(
        "twice", "", "Share of the walls seen again after 15 m of path that are drawn twice, more than 10 cm apart"
    ),
    "map_precision": _of_map("precision", "Share of the map's wall cells within 10 cm of a true wall."),
    "map_recall": _of_map("recall", "Share of the true walls that were seen within 10 cm of a wall of the map."),
    "map_f1": _of_map("f1", "Harmonic mean of map_precision and map_recall."),
    "map_distance": _of_map(
        "distance",
        "Mean distance between walls of the map and true ones that were seen, both ways, each at most 1 m.",
        unit="m",
        better="lower",
    ),
    "map_free_iou": _of_map("free_iou", "Intersection over union of free space, among the cells that both maps know."),
    "map_known": _of_map("known", "Share of the true free space that the map knows."),
    "nees": _of_filter(
        "Mean NEES of the online poses relative to the map around the robot; 3 if the covariances are right.", _nees
    ),
    "nees_within_95": _of_filter("Share of these poses within their 95 % ellipsoid; 0.95 is right.", _within_95),
    "nees_from_start": _of_filter(
        "Mean NEES of the online poses anchored at the start; 3 if the covariances are right and hold what has "
        "drifted.",
        lambda run: run.nees_from_start.mean,
    ),
    "nees_end": _of_filter(
        "NEES of the last online pose, anchored at the start: in 95 of 100 runs from 0.22 to 9.35.",
        lambda run: run.nees_from_start.end,
    ),
    "within_spread": _share(
        "Share of the updates at which the true pose, anchored at the start, lies in the particles' 95 % ellipsoid.",
        lambda run: run.within_spread,
    ),
    "effective_particles": _of_filter(
        "Mean effective number of particles over the scans.",
        lambda run: float(needed(run.certainty, "diagnostics").effective.mean()),
        "Thrun, Burgard and Fox 2005",
    ),
    "lost_precision": _share(
        "Share of the scans called lost whose pose is wrong.",
        lambda run: run.localisation.precision(LocalisationState.LOST),
    ),
    "lost_recall": _share(
        "Share of the scans with a wrong pose that are called lost.",
        lambda run: run.localisation.recall(LocalisationState.LOST),
    ),
    "loops_precision": _share("Share of the accepted loops that are right.", lambda run: run.loop_result.precision),
    "loops_recall": _share(
        "Share of the scans that see a place again which a loop binds.", lambda run: run.loop_result.recall
    ),
    "loops_false": Metric("", "Accepted loops that are wrong.", OURS, of_run=lambda run: run.loop_result.false),
    "cpu_per_scan": _cost(
        "ms", "Processor time of filter and back end, a scan.", lambda cost, run: 1e3 * cost.cpu_seconds / _scans(run)
    ),
    "wall_per_scan": _cost(
        "ms",
        "Time of filter and back end by the clock, a scan.",
        lambda cost, run: 1e3 * cost.wall_seconds / _scans(run),
    ),
    "wall_per_scan_median": _cost("ms", "Median time of a scan by the clock.", lambda cost, _: _quantile(cost, 0.5)),
    "wall_per_scan_99": _cost(
        "ms", "Time by the clock that 99 of 100 scans stay below.", lambda cost, _: _quantile(cost, 0.99)
    ),
    "real_time_factor": _cost(
        "",
        "Seconds of the recording that a second of filter and back end gets through.",
        lambda cost, run: _driven(run) / cost.wall_seconds,
        better="higher",
    ),
    "memory": _cost("MB", "Most memory of the process.", lambda cost, _: cost.memory / 1e6),
}
"""By name, in the order in which they are listed."""

COSTS = ("cpu_per_scan", "wall_per_scan", "wall_per_scan_median", "wall_per_scan_99", "real_time_factor", "memory")
"""Names of the metrics that differ from run to run."""
