"""Scores: of a run of ours as one dict of figures; of anyone's trajectory by another one, relations, or its scans."""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError, MoteslamWarning
from moteslam.eval.metrics.association import MAX_DIFFERENCE, few_matched, in_plane, match, oriented, spatial
from moteslam.eval.metrics.ate import AteResult, PoseErrors, absolute_trajectory_error
from moteslam.eval.metrics.clocks import clock_offset
from moteslam.eval.metrics.doubts import doubts
from moteslam.eval.metrics.evidence import DEAD_RECKONING, FINAL, ONLINE, TRACKS, Certainty, Evidence
from moteslam.eval.metrics.localisation import state_counts
from moteslam.eval.metrics.registry import Value, measure
from moteslam.eval.metrics.relations import (
    RelationResult,
    Relations,
    evaluate_relations,
    is_relations,
    read_relations,
    relation_doubts,
)
from moteslam.eval.metrics.residuals import scan_residuals
from moteslam.eval.metrics.rpe import Unit, relative_pose_error
from moteslam.robot import se2
from moteslam.robot.formats.map_server import OCCUPIED, UNKNOWN, read_map, trinary
from moteslam.robot.raster import Raster
from moteslam.robot.recording import Recording
from moteslam.robot.se2 import Array
from moteslam.robot.trajectories.text import read_tum
from moteslam.robot.trajectory import TILT, Space, Trajectory, tilt_of
from moteslam.robot.values import Issue, expect_type
from moteslam.slam.backend.protocol import LoopCandidate
from moteslam.slam.estimate import Estimate
from moteslam.slam.filter.certainty import LocalisationState
from moteslam.slam.inputs.scans import Scans

Figures = dict[str, Any]
"""Of a run, fit for JSON: what ``metrics.json`` holds (``docs/reference/formats.md``)."""
Reference = Trajectory | Relations
Truth = Trajectory | None

ACCURACY_OF_MAPS = ("map_precision", "map_recall", "map_f1", "map_distance", "map_free_iou", "map_known")
"""Metrics that compare a map with the true one."""
OF_LOOPS = ("loops_precision", "loops_recall", "loops_false")
OUTSIDE, ASTRAY, ALIKE = 2, 10.0, 0.5
"""A value for beyond the edges of a map; fewer per cent of a robot's path than the second are there or in walls, and
more are known; and of two maps of one place more than the third of one's walls are at those of the other."""


def placed_in_map(states: NDArray[Any], method: str) -> NDArray[np.bool_]:
    """[n] whether online poses of these states are places in the map: in a known one not while the robot is lost."""
    return np.asarray((states < LocalisationState.LOST) | (method != "known_map"))


def evidence_of(
    estimate: Estimate,
    truth: Truth = None,
    *,
    recording: Recording | None = None,
    true_map: Raster | None = None,
    relations: Relations | None = None,
) -> Evidence:
    """What is known of a run of ours when it is scored; arguments as of ``score_estimate``.

    Online poses of a robot that is lost in a known map are none, and not scored; nor is one that is found nowhere.
    """
    tracks = {FINAL: estimate.trajectory_final, DEAD_RECKONING: estimate.dead_reckoning}
    placed, certainty = placed_in_map(estimate.diagnostics["state"], estimate.config.method), None
    if placed.any():
        tracks[ONLINE] = estimate.trajectory if placed.all() else estimate.trajectory.take(placed)
        states, updated, n_eff = (estimate.diagnostics[name][placed] for name in ("state", "updated", "n_eff"))
        spread = estimate.particle_spread[placed[estimate.diagnostics["updated"] > 0]]
        corrections = estimate.corrections if placed.all() else ()
        certainty = Certainty(estimate.covariances[placed], states, updated, n_eff, spread, corrections)
    backend = estimate.config.backend  # looks for loops, unless they are switched off
    looks = backend.method != "none" and getattr(getattr(backend, "loops", None), "enabled", True)
    return Evidence(
        trajectories={name: tracks[name] for name in TRACKS if name in tracks},
        truth=truth if placed.any() else None,
        relations=relations if placed.any() else None,
        occupancy=replace(estimate.map, values=trinary(estimate.map.values)),
        true_map=true_map,
        recording=recording,
        certainty=certainty,
        loops=estimate.loops if looks else None,
    )


def score_estimate(
    estimate: Estimate, truth: Truth = None, *, recording: Recording | None = None, true_map: Raster | None = None
) -> Figures:
    """Score a run by a truth on the clock of its recording.

    The recording's scans show which loops are possible, and which walls were seen. Without a true map, trinary and in
    the frame of the truth, the map is not scored.
    """
    expect_type(estimate, Estimate, "estimate", "run_slam(recording) makes one")
    return figures_of(estimate, evidence_of(estimate, truth, recording=recording, true_map=true_map))


def figures_of(estimate: Estimate, run: Evidence) -> Figures:
    """The same of a run whose evidence is at hand; ``InputError``: a truth on another clock."""
    stamps, diagnostics = estimate.trajectory.stamps, estimate.diagnostics
    if run.truth is not None:
        match(estimate.trajectory, run.truth)  # a truth on another clock is an error, not an absent figure
    lost = np.flatnonzero(diagnostics["state"] == LocalisationState.LOST)
    figures: Figures = {
        "scans": len(stamps),
        "duration_s": float(stamps[-1] - stamps[0]),
        **dict(zip(("distance_m", "distance_by"), run.driven, strict=True)),
        "updates": int(diagnostics["updated"].sum()),
        "resampled": int(diagnostics["resampled"].sum()),
        "mean_particles": float(diagnostics["particles"].mean()),
        "localisation": {
            "states": state_counts(diagnostics["state"]),
            "first_lost_stamp": float(stamps[lost[0]]) if len(lost) else None,
            "compared": None,
        },
        "metrics": {name: value.as_dict() for name, value in measure(run).items()},
    }
    with suppress(InputError):  # what cannot be had never costs the run
        found = run.localisation.as_dict()
        names = ("scans", "wrong", "states", "doubtful_or_lost")
        figures["localisation"]["compared"] = {name: found[name] for name in names}
    return figures


def number(figures: Figures, name: str) -> float | None:
    """The value of a metric, if there is one."""
    found = figures["metrics"].get(name, {}).get("value")
    return None if found is None else float(found)


def beside(recording: Path, name: str) -> Path | None:
    """A file in a recording's folder, or beside a log, if it is there; in its name ``{}`` stands for the log's."""
    folder = recording if recording.is_dir() else recording.parent
    file = folder / name.format(recording.name.partition(".")[0])
    return file if file.exists() else None


def truth_file(recording: Path) -> Path | None:
    """The truth of a recording, or the reference of a log."""
    return beside(recording, "{}.reference.tum") or beside(recording, "truth.tum")


def truth_beside(recording: Path, stamps: Array) -> tuple[Trajectory | None, tuple[Issue, ...]]:
    """The same if it is on the clock of these stamps [s], and what is doubtful in it; if not, why."""
    if (file := truth_file(recording)) is None:
        return None, ()
    truth = read_tum(file)
    try:
        match(Trajectory(stamps, np.zeros((len(stamps), 3))), truth)
    except InputError as error:
        return None, (Issue("not-scored", f"{file}: {error.problem}; not scored"),)
    return truth, truth.warnings


def relations_beside(recording: Path) -> Relations | None:
    """The hand-checked relations of a log."""
    file = beside(recording, "{}.relations")
    return None if file is None or not is_relations(file) else read_relations(file)


def true_map_beside(recording: Path) -> Raster | None:
    """The true map of a recording."""
    file = beside(recording, "truth_map.yaml")
    return None if file is None else read_map(file)


def against(
    estimate: Trajectory,
    reference: Reference,
    *,
    align: bool = True,
    scale: bool = False,
    delta: float = 1.0,
    unit: Unit = "m",
    all_pairs: bool = False,
    max_difference: float | None = None,
    nearest: bool = False,
) -> tuple[AteResult | RelationResult, Figures, Figures]:
    """Score a trajectory by another one or by relations; arguments that are not of that kind change nothing.

    The errors, their figures with what is doubtful in ``warnings``, and the errors by stamp, both fit for JSON.

    ``align`` and ``scale`` are those of the absolute error, ``delta``, ``unit`` and ``all_pairs`` of the relative one:
    an estimate that is shorter than ``delta`` has none, which a warning says. Stamps that belong together differ by at
    most ``max_difference`` [s]; ``nearest`` takes the poses at these in place of interpolated ones, as evo does.
    """
    if isinstance(reference, Relations):
        how: dict[str, Any] = {} if max_difference is None else {"tolerance": max_difference}
        missed = evaluate_relations(estimate, reference, **how)
        told = relation_doubts(estimate, missed)
        figures = {"kind": "relations", **missed.as_dict(), "warnings": [issue.as_dict() for issue in told]}
        return missed, figures, _by_stamp(missed)
    apart = MAX_DIFFERENCE if max_difference is None else max_difference
    which: dict[str, Any] = {"max_difference": apart, "interpolate": False if nearest else None}
    try:
        ate = absolute_trajectory_error(estimate, reference, align=align, scale=scale, **which)
    except InputError as error:
        causes = [one.message for one in (*estimate.warnings, *reference.warnings) if one.code == "equal-stamps"]
        if not causes and (offset := clock_offset(estimate, reference)) is not None:
            causes = [offset[1]]
        raise InputError("; ".join((error.problem, *causes)), file=error.file, field=error.field) from None
    issues = doubts(estimate, reference, ate, align=align, apart=apart)
    rpe = None
    try:
        found = relative_pose_error(estimate, reference, delta=delta, unit=unit, all_pairs=all_pairs, **which)
        rpe = found.as_dict()
    except InputError as error:
        if error.field != "pairs":
            raise
        issues += (Issue("no-relative-error", f"no relative error: {error.problem}"),)
    figures = {"kind": "trajectory", "aligned": align, "scaled": align and scale, "nearest": nearest}
    figures |= {"oriented": ate.rotation is not None, "ate": ate.as_dict(), "rpe": rpe}
    figures |= {"warnings": [issue.as_dict() for issue in issues]}
    return ate, figures, _by_stamp(ate)


def doubted(run: Evidence) -> list[dict[str, Any]]:
    """What ``against`` doubts of the final trajectory of a run, or why it cannot be scored."""
    found: list[dict[str, Any]] = []
    given: tuple[Reference | None, ...] = run.truth, run.relations
    for reference in (one for one in given if one is not None):
        try:
            found += against(run.trajectories[FINAL], reference)[1]["warnings"]
        except InputError as error:
            found.append(Issue("not-scored", f"{error.problem}; not scored").as_dict())
    return found


def _by_stamp(errors: PoseErrors) -> dict[str, Any]:
    turns = None if errors.rotation_errors is None else errors.rotation_errors.tolist()
    return {"stamps": errors.stamps.tolist(), "translation_m": errors.errors.tolist(), "rotation_rad": turns}


def carried(trajectory: Trajectory, offset: Sequence[float]) -> Trajectory:
    """The path of another point of the robot, at a pose x, y [m], theta [rad] seen from the one whose path this is."""
    moved = replace(trajectory, poses=se2.compose(trajectory.poses, np.array(offset)))
    if (space := trajectory.space) is None:
        return moved
    turn = spatial(Trajectory(np.zeros(1), np.array([offset]))).rotations[0]
    there = space.positions + space.rotations @ np.array((*offset[:2], 0.0))
    return replace(moved, space=Space(there, space.rotations @ turn))


def under_recording(estimate: Trajectory, recording: Recording, scans: Scans | None = None) -> tuple[Figures, Figures]:
    """Score a trajectory by the scans of its recording: figures and residuals by stamp, as of ``against``."""
    oriented(estimate)
    result = scan_residuals(recording, estimate, scans=scans)
    assert recording.lidar is not None  # or there would be no residuals
    question = "is this its recording, on the same clock?"
    issues = few_matched(result.matched, min(len(estimate), len(recording.lidar)), "scans or poses", question)
    figures = {**result.as_dict(), "warnings": [issue.as_dict() for issue in issues]}
    medians = [None if isnan(median) else median for median in result.medians.tolist()]
    return figures, {"stamps": result.stamps.tolist(), "median_m": medians}


def measured(
    estimate: Trajectory,
    reference: Reference | None,
    names: Sequence[str] | None = None,
    *,
    recording: Recording | None = None,
    occupancy: Path | None = None,
    true_map: Path | None = None,
    loops: Sequence[LoopCandidate] | None = None,
) -> dict[str, Value]:
    """Metrics of a trajectory of any SLAM, by name; those that need what is not there are absent, with the reason.

    ``occupancy`` and ``true_map`` are map_server ``.yaml`` files of its map, in the frame of the estimate, and of the
    true one; with a true map its accuracy is measured, too, and with the candidates of its back end those of loops.
    """
    truth = reference if isinstance(reference, Trajectory) else None
    if truth is not None and any(tilt_of(spatial(one).positions) > TILT for one in (estimate, truth)):
        if occupancy is not None:
            raise InputError("a map in x and y, expected none of a motion in another plane", file=occupancy)
        motion = absolute_trajectory_error(estimate, truth).motion
        assert motion is not None  # in space
        estimate, truth = in_plane(estimate, truth, *motion)
    maps = [None if file is None else read_map(file) for file in (occupancy, true_map)]
    relations = reference if isinstance(reference, Relations) else None
    evidence = Evidence({FINAL: estimate}, truth, relations, maps[0], maps[1], recording, loops=loops)
    asked = [*(ACCURACY_OF_MAPS if true_map is not None else ()), *(() if loops is None else OF_LOOPS), *(names or ())]
    found = measure(evidence, dict.fromkeys(asked))
    for issue in doubted_maps(evidence, found, str(occupancy), str(true_map)):
        warnings.warn(MoteslamWarning(issue.message), stacklevel=2)
    return found


def doubted_maps(
    run: Evidence, found: Mapping[str, Value], name: str = "its map", of_truth: str = "the true map"
) -> Iterator[Issue]:
    """What is doubtful in a map of any SLAM, and in the true one, by the paths in them and by what was measured."""
    for raster, file, one in (run.occupancy, name, run.trajectories[FINAL]), (run.true_map, of_truth, run.truth):
        if run.occupancy is not None and raster is not None and one is not None:
            there = raster.values_at(one.poses[:, :2], outside=OUTSIDE)
            walls, unknown, outside = (100 * float((there == value).mean()) for value in (OCCUPIED, UNKNOWN, OUTSIDE))
            if walls + outside > ASTRAY or unknown > 100 - ASTRAY:
                shares = f"{walls:.0f} % in its walls, {unknown:.0f} % where it is unknown, {outside:.0f} % outside"
                why = "of another building, or its resolution, origin, turn, rows or sign of greys are other ones"
                yield Issue("unlike", f"{file}: of the path {shares}: {why}; its scores mean nothing")
    compared = any(name in found and found[name].number is not None for name in ACCURACY_OF_MAPS)
    if compared and (alike := run.map_accuracy.alike) < ALIKE:
        text = f"{of_truth}: {100 * alike:.0f} % of the walls of {name} are at its walls: "
        yield Issue("unlike", f"{text}another building or frame, a flipped image, or a map that is wrong")
