"""A trajectory scored: against another one or relations, or by the scans of its recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, isnan
from pathlib import Path
from typing import Any

from moteslam.errors import InputError
from moteslam.eval.metrics.association import MAX_DIFFERENCE, in_plane, oriented, spatial
from moteslam.eval.metrics.ate import AteResult, absolute_trajectory_error
from moteslam.eval.metrics.doubts import clock_offset, doubts, few_matched, in_words, lever_arm, on_another_clock
from moteslam.eval.metrics.evidence import FINAL, Evidence
from moteslam.eval.metrics.registry import Value, measure
from moteslam.eval.metrics.relations import (
    TOLERANCE,
    RelationResult,
    Relations,
    evaluate_relations,
    is_relations,
    read_relations,
)
from moteslam.eval.metrics.residuals import ResidualResult, scan_residuals
from moteslam.eval.metrics.rpe import Unit, relative_pose_error
from moteslam.robot.formats.map_server import read_map
from moteslam.robot.recording import Recording
from moteslam.robot.trajectories import read_trajectory
from moteslam.robot.trajectory import TILT, Trajectory, tilt_of
from moteslam.robot.values import Issue
from moteslam.slam.inputs.scans import Scans

Reference = Trajectory | Relations

ACCURACY_OF_MAPS = ("map_precision", "map_recall", "map_f1", "map_distance", "map_free_iou", "map_known")
"""Metrics that compare a map with the true one."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """How a trajectory does: figures, with what is doubtful in ``warnings``, and errors by stamp, both fit for JSON."""

    figures: dict[str, Any]
    errors: dict[str, Any]
    result: AteResult | RelationResult | ResidualResult


def read_reference(path: Path) -> Reference:
    """What to score by: relations or a trajectory, by the content of a file."""
    return read_relations(path) if is_relations(path) else read_trajectory(path)


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
    interpolate: bool = True,
) -> Evaluation:
    """Score a trajectory by another one or by relations; arguments that are not of that kind change nothing.

    Args:
        estimate, reference: what is scored, and by what.
        align, scale: of the absolute error, as in ``absolute_trajectory_error``.
        delta, unit, all_pairs: of the relative error, as in ``relative_pose_error``; an estimate that is shorter than
            ``delta`` has none, which a warning says.
        max_difference: between stamps that belong together [s].
        interpolate: relations between poses.
    """
    if isinstance(reference, Relations):
        tolerance = TOLERANCE if max_difference is None else max_difference
        return _against_relations(estimate, reference, tolerance, interpolate=interpolate)
    apart = MAX_DIFFERENCE if max_difference is None else max_difference
    try:
        ate = absolute_trajectory_error(estimate, reference, align=align, scale=scale, max_difference=apart)
    except InputError as error:
        raise on_another_clock(error, clock_offset(estimate, reference)) from None
    issues = doubts(estimate, reference, ate)
    question = "are these the same drive, on the same clock?"
    issues += few_matched(len(ate.stamps), min(len(estimate), len(reference)), "poses", question)
    if align:
        issues += _explained(estimate, reference, ate, scale=scale, max_difference=apart)
    rpe = None
    try:
        rpe = relative_pose_error(
            estimate, reference, delta=delta, unit=unit, all_pairs=all_pairs, max_difference=apart
        ).as_dict()
    except InputError as error:
        if error.field != "pairs":
            raise
        issues += (Issue("no-relative-error", f"no relative error: {error.problem}"),)
    figures = {
        "kind": "trajectory",
        "aligned": align,
        "scaled": align and scale,
        "oriented": ate.rotation is not None,
        "ate": ate.as_dict(),
        "rpe": rpe,
        "warnings": [issue.as_dict() for issue in issues],
    }
    turns = None if ate.rotation_errors is None else ate.rotation_errors.tolist()
    errors = {"stamps": ate.stamps.tolist(), "translation_m": ate.errors.tolist(), "rotation_rad": turns}
    return Evaluation(figures, errors, ate)


def _against_relations(
    estimate: Trajectory, relations: Relations, tolerance: float, *, interpolate: bool
) -> Evaluation:
    result = evaluate_relations(estimate, relations, interpolate=interpolate, tolerance=tolerance)
    errors = {
        "stamps": result.stamps.tolist(),
        "translation_m": result.errors.tolist(),
        "rotation_rad": result.rotation_errors.tolist(),
    }
    return Evaluation({"kind": "relations", **result.as_dict()}, errors, result)


def _explained(
    estimate: Trajectory, reference: Trajectory, ate: AteResult, *, scale: bool, max_difference: float
) -> tuple[Issue, ...]:
    """The issue that an offset of the clocks, or one on the robot, explains the error, whichever leaves less of it."""
    arm, after = lever_arm(ate), inf
    if (offset := clock_offset(estimate, reference)) is not None:
        moved = replace(estimate, stamps=estimate.stamps + offset.seconds)
        after = absolute_trajectory_error(moved, reference, scale=scale, max_difference=max_difference).rmse
    if arm is not None and arm.rmse < after:
        text = f"an offset of x {arm.x:.3f} m, y {arm.y:.3f} m on the robot explains the ATE but for {arm.rmse:.4f} m: "
        return (Issue("lever-arm", f"{text}the two are paths of different points of it, of lidar and base, say"),)
    if offset is None:
        return ()
    return (Issue("clocks-differ", in_words(replace(offset, rmse=after, before=ate.rmse))),)


def under_recording(estimate: Trajectory, recording: Recording, *, scans: Scans | None = None) -> Evaluation:
    """Score a trajectory by the scans of its recording; arguments and errors as in ``scan_residuals``."""
    oriented(estimate)
    result = scan_residuals(recording, estimate, scans=scans)
    assert recording.lidar is not None  # or there would be no residuals
    question = "is this its recording, on the same clock?"
    issues = few_matched(result.matched, min(len(estimate), len(recording.lidar)), "scans or poses", question)
    figures = {**result.as_dict(), "warnings": [issue.as_dict() for issue in issues]}
    medians = [None if isnan(median) else median for median in result.medians.tolist()]
    return Evaluation(figures, {"stamps": result.stamps.tolist(), "median_m": medians}, result)


def measured(
    estimate: Trajectory,
    reference: Reference | None,
    *,
    recording: Recording | None = None,
    occupancy: Path | None = None,
    true_map: Path | None = None,
    names: Sequence[str] | None = None,
) -> dict[str, Value]:
    """Metrics of a trajectory of any SLAM, by name; those that need what is not there are absent, with the reason.

    Args:
        estimate: the trajectory.
        reference: a trajectory or relations.
        recording: of its drive.
        occupancy, true_map: map_server ``.yaml`` files of its map, in the frame of the estimate, and of the true one.
        names: of the metrics; with a true map its accuracy is measured, too.
    """
    truth = reference if isinstance(reference, Trajectory) else None
    if truth is not None and any(tilt_of(spatial(one).positions) > TILT for one in (estimate, truth)):
        if occupancy is not None:
            raise InputError("a map in x and y, expected none of a motion in another plane", file=occupancy)
        motion = absolute_trajectory_error(estimate, truth).motion
        assert motion is not None  # in space
        estimate, truth = in_plane(estimate, truth, *motion)
    evidence = Evidence(
        {FINAL: estimate},
        truth=truth,
        relations=reference if isinstance(reference, Relations) else None,
        recording=recording,
        occupancy=None if occupancy is None else read_map(occupancy),
        true_map=None if true_map is None else read_map(true_map),
    )
    return measure(evidence, dict.fromkeys([*(ACCURACY_OF_MAPS if true_map is not None else ()), *(names or ())]))
