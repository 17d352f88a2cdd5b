"""The metrics of this package: name, unit, meaning and source of each; what computes them are the modules beside it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from moteslam.errors import InputError
from moteslam.eval.metrics.ate import absolute_trajectory_error
from moteslam.eval.metrics.consistency import share_within_spread
from moteslam.eval.metrics.evidence import FINAL, ONLINE, Cost, Evidence, Track, needed, oriented
from moteslam.eval.metrics.map_accuracy import MapAccuracy
from moteslam.eval.metrics.registry import Metric
from moteslam.eval.metrics.rpe import Unit
from moteslam.eval.statistics.summary import Better
from moteslam.robot.se2 import between, compose, inverse
from moteslam.slam.filter.certainty import LocalisationState

STURM = "Sturm et al. 2012"
GEIGER = "Geiger, Lenz and Urtasun 2012"
KUEMMERLE = "Kuemmerle et al. 2009"
BAR_SHALOM = "Bar-Shalom, Li and Kirubarajan 2001"
OURS = "moteslam"


def _degrees(angle: float) -> float:
    return float(np.rad2deg(angle))


MOVED = 0.05
"""Positions spread by less [m] say nothing of heading and scale."""


def _moved(track: Track) -> Track:
    """The track, if the robot moved: else the alignment leaves heading and scale open."""
    spread = track.ate.reference[:, :2].std(axis=0)
    if float(np.hypot(*spread)) < MOVED:
        raise InputError(f"the robot stood still, expected positions that spread by {MOVED:g} m")
    return track


ATE = Metric("m", "RMSE of the positions after rigid alignment.", STURM, of_trajectory=lambda track: track.ate.rmse)
ATE_MEDIAN = Metric("m", "Median error of the positions after rigid alignment.", STURM, lambda track: track.ate.median)
ATE_MAX = Metric("m", "Largest error of a position after rigid alignment.", STURM, lambda track: track.ate.max)
ATE_SCALED = Metric(
    "m",
    "RMSE of the positions after an alignment that fits the scale, too: ranges or wheels may be off.",
    STURM,
    lambda track: absolute_trajectory_error(_moved(track).trajectory, track.truth, scale=True).rmse,
)
ATE_FROM_START = Metric(
    "m",
    "RMSE of the positions where the first poses are laid on each other.",
    STURM,
    lambda track: absolute_trajectory_error(track.trajectory, track.truth, from_start=True).rmse,
)
HEADING = Metric(
    "deg",
    "RMSE of the headings after rigid alignment.",
    STURM,
    lambda track: _degrees(needed(_moved(track).ate.rotation, "orientation").rmse),
)


def relative_error(delta: float, unit: Unit, *, rotation: bool = False) -> Metric:
    """The relative error over a distance [m], a time [s], or a number of poses."""
    over = {"m": f"{delta:g} m of path", "s": f"{delta:g} s", "frames": f"{delta:g} poses"}[unit]
    if rotation:
        return Metric(
            "deg",
            f"RMSE of the rotation between poses {over} apart.",
            STURM,
            lambda track: _degrees(needed(track.rpe(delta, unit).rotation, "orientation").rmse),
        )
    return Metric(
        "m", f"RMSE of the motion between poses {over} apart.", STURM, lambda track: track.rpe(delta, unit).rmse
    )


RPE_1M, RPE_1M_ROTATION = relative_error(1.0, "m"), relative_error(1.0, "m", rotation=True)
RPE_10M, RPE_10M_ROTATION = relative_error(10.0, "m"), relative_error(10.0, "m", rotation=True)
RPE_1S, RPE_1S_ROTATION = relative_error(1.0, "s"), relative_error(1.0, "s", rotation=True)

DRIFT = Metric(
    "m/m",
    "Error of the position per metre of path, mean over parts of 5 to 100 m.",
    GEIGER,
    lambda track: float(track.drift.translation.mean()),
)
DRIFT_ROTATION = Metric(
    "deg/m",
    "Error of the heading per metre of path, mean over parts of 5 to 100 m.",
    GEIGER,
    lambda track: _degrees(track.drift.rotation.mean()),
)
LOOP_CLOSING = Metric(
    "m",
    "RMSE of where a place lies when the robot comes back to it, seen from the first visit.",
    OURS,
    lambda track: track.returns.translation.rmse,
)
LOOP_CLOSING_ROTATION = Metric(
    "deg",
    "RMSE of the heading when the robot comes back to a place, seen from the first visit.",
    OURS,
    lambda track: _degrees(track.returns.rotation.rmse),
)
RELATIONS = Metric(
    "m",
    "Mean error of the translation of hand-checked relations.",
    KUEMMERLE,
    lambda track: track.relations.all.translation.mean,
)
RELATIONS_ROTATION = Metric(
    "deg",
    "Mean error of the rotation of hand-checked relations.",
    KUEMMERLE,
    lambda track: track.relations.all.rotation.mean,
)
RESIDUAL = Metric(
    "m",
    "Median distance of endpoints to the lines of scans less than 2 m of path away; no truth needed.",
    "Censi 2008",
    lambda track: track.residuals.median,
    costly=True,
)
MAP_CELLS = Metric(
    "",
    "Cells of 5 cm that hold an endpoint: fewer are sharper; no truth needed.",
    OURS,
    lambda track: track.consistency.cells,
    costly=True,
)
MAP_CELLS_PER_METRE = Metric(
    "1/m",
    "The same per metre of wall that was seen; no truth needed.",
    OURS,
    lambda track: track.consistency.cells_per_metre,
    costly=True,
)
MAP_NEAR = Metric(
    "m",
    "Mean distance of endpoints to the nearest one of scans less than 6 m of path away; no truth needed.",
    OURS,
    lambda track: track.consistency.near,
    costly=True,
)
MAP_FAR = Metric(
    "m",
    "Mean distance of endpoints to the nearest one of scans more than 15 m of path away; no truth needed.",
    OURS,
    lambda track: track.consistency.far,
    costly=True,
)
MAP_THICKNESS = Metric(
    "m",
    "Median standard deviation of endpoints across their wall; no truth needed.",
    OURS,
    lambda track: track.consistency.thickness,
    costly=True,
)
MAP_TWICE = Metric(
    "",
    "Share of the walls seen again after 15 m of path that are drawn twice, more than 10 cm apart; no truth needed.",
    OURS,
    lambda track: track.consistency.twice,
    costly=True,
)


def _of_map(meaning: str, value: Callable[[MapAccuracy], float], unit: str = "", better: Better = "higher") -> Metric:
    return Metric(unit, meaning, OURS, of_run=lambda run: value(run.map_accuracy), better=better)


MAP_PRECISION = _of_map("Share of the map's wall cells within 10 cm of a true wall.", lambda found: found.precision)
MAP_RECALL = _of_map(
    "Share of the true walls that were seen within 10 cm of a wall of the map.", lambda found: found.recall
)
MAP_F1 = _of_map("Harmonic mean of map_precision and map_recall.", lambda found: found.f1)
MAP_DISTANCE = _of_map(
    "Mean distance between walls of the map and true ones that were seen, both ways, each at most 1 m.",
    lambda found: found.distance,
    unit="m",
    better="lower",
)
MAP_FREE_IOU = _of_map(
    "Intersection over union of free space, among the cells that both maps know.", lambda found: found.free_iou
)
MAP_KNOWN = _of_map("Share of the true free space that the map knows.", lambda found: found.known)


def _nees(run: Evidence) -> float | None:
    result = run.localisation
    right = result.nees[~result.wrong]
    return float(right.mean()) if len(right) else None


def _within_95(run: Evidence) -> float | None:
    found = run.localisation.as_dict()["nees"]
    return None if found is None else float(found["within_95"])


def _within_spread(run: Evidence) -> float:
    known = needed(run.certainty, "spread of the particles")
    spread, updated = needed(known.spread, "spread of the particles"), known.updated > 0
    poses, truth = oriented(run.track(ONLINE).trajectory, needed(run.truth, "truth"))
    true = truth.at(poses.stamps).poses
    laid = compose(compose(true[0], inverse(poses.poses[0])), poses.poses)
    return share_within_spread(np.asarray(between(true, laid))[updated], spread)


NEES = Metric(
    "",
    "Mean NEES of the online poses relative to the map around the robot; 3 if the covariances are right.",
    BAR_SHALOM,
    of_run=_nees,
    better=None,
)
NEES_WITHIN_95 = Metric(
    "", "Share of these poses within their 95 % ellipsoid; 0.95 is right.", BAR_SHALOM, of_run=_within_95, better=None
)
NEES_FROM_START = Metric(
    "",
    "Mean NEES of the online poses anchored at the start; 3 if the covariances are right and hold what has drifted.",
    BAR_SHALOM,
    of_run=lambda run: run.nees_from_start.mean,
    better=None,
)
NEES_END = Metric(
    "",
    "NEES of the last online pose, anchored at the start: in 95 of 100 runs from 0.22 to 9.35.",
    BAR_SHALOM,
    of_run=lambda run: run.nees_from_start.end,
    better=None,
)
WITHIN_SPREAD = Metric(
    "",
    "Share of the updates at which the true pose, anchored at the start, lies in the particles' 95 % ellipsoid.",
    OURS,
    of_run=_within_spread,
    better="higher",
)
EFFECTIVE_PARTICLES = Metric(
    "",
    "Mean effective number of particles over the scans.",
    "Thrun, Burgard and Fox 2005",
    of_run=lambda run: float(needed(run.certainty, "diagnostics").effective.mean()),
    better=None,
)
LOST_PRECISION = Metric(
    "",
    "Share of the scans called lost whose pose is wrong.",
    OURS,
    of_run=lambda run: run.localisation.precision(LocalisationState.LOST),
    better="higher",
)
LOST_RECALL = Metric(
    "",
    "Share of the scans with a wrong pose that are called lost.",
    OURS,
    of_run=lambda run: run.localisation.recall(LocalisationState.LOST),
    better="higher",
)
LOOPS_PRECISION = Metric(
    "",
    "Share of the accepted loops that are right.",
    OURS,
    of_run=lambda run: run.loop_result.precision,
    better="higher",
)
LOOPS_RECALL = Metric(
    "",
    "Share of the scans that see a place again which a loop binds.",
    OURS,
    of_run=lambda run: run.loop_result.recall,
    better="higher",
)
LOOPS_FALSE = Metric("", "Accepted loops that are wrong.", OURS, of_run=lambda run: run.loop_result.false)


def _cost(what: Callable[[Cost, Evidence], float | None]) -> Callable[[Evidence], float | None]:
    return lambda run: what(needed(run.cost, "time was measured"), run)


def _scans(run: Evidence) -> int:
    return len(run.track(FINAL).trajectory)


def _driven(run: Evidence) -> float:
    stamps = run.track(FINAL).trajectory.stamps
    return float(stamps[-1] - stamps[0])


def _quantile(cost: Cost, share: float) -> float | None:
    return 1e3 * float(np.quantile(cost.per_scan, share)) if cost.per_scan else None


CPU_PER_SCAN = Metric(
    "ms",
    "Processor time of filter and back end, a scan.",
    OURS,
    of_run=_cost(lambda cost, run: 1e3 * cost.cpu_seconds / _scans(run)),
)
WALL_PER_SCAN = Metric(
    "ms",
    "Time of filter and back end by the clock, a scan.",
    OURS,
    of_run=_cost(lambda cost, run: 1e3 * cost.wall_seconds / _scans(run)),
)
WALL_PER_SCAN_MEDIAN = Metric(
    "ms", "Median time of a scan by the clock.", OURS, of_run=_cost(lambda cost, run: _quantile(cost, 0.5))
)
WALL_PER_SCAN_99 = Metric(
    "ms",
    "Time by the clock that 99 of 100 scans stay below.",
    OURS,
    of_run=_cost(lambda cost, run: _quantile(cost, 0.99)),
)
REAL_TIME_FACTOR = Metric(
    "",
    "Seconds of the recording that a second of filter and back end gets through.",
    OURS,
    of_run=_cost(lambda cost, run: _driven(run) / cost.wall_seconds),
    better="higher",
)
MEMORY = Metric("MB", "Most memory of the process.", OURS, of_run=_cost(lambda cost, run: cost.memory / 1e6))
