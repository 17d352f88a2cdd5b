"""A trajectory scored: against another one, relations or positions, or by the scans of its recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np

from moteslam.errors import InputError
from moteslam.eval.metrics.association import MAX_DIFFERENCE
from moteslam.eval.metrics.ate import AteResult, absolute_trajectory_error, position_error
from moteslam.eval.metrics.doubts import clock_offset, doubts, few_matched, in_words, on_another_clock
from moteslam.eval.metrics.evidence import FINAL, Evidence, oriented
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
from moteslam.eval.metrics.space import in_plane, spatial
from moteslam.robot.formats.map_server import read_map
from moteslam.robot.platform import Platform
from moteslam.robot.recording import Recording
from moteslam.robot.se2 import compose
from moteslam.robot.trajectories import read_trajectory
from moteslam.robot.trajectories.columns import is_positions, read_positions
from moteslam.robot.trajectory import TILT, Positions, Trajectory, tilt_of
from moteslam.robot.values import Issue
from moteslam.slam.inputs.scans import Scans

Reference = Trajectory | Relations | Positions
Issues = tuple[Issue, ...]

QUESTION = "are these of the same drive, on the same clock?"
ACCURACY_OF_MAPS = ("map_precision", "map_recall", "map_f1", "map_distance", "map_free_iou", "map_known")
"""Metrics that compare a map with the true one."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """How a trajectory does: figures, with what is doubtful in ``warnings``, and errors by stamp, both fit for JSON."""

    figures: dict[str, Any]
    errors: dict[str, Any]
    result: AteResult | RelationResult | ResidualResult


def read_reference(path: Path) -> Reference:
    """What to score by: relations, positions or a trajectory, by the content of a file."""
    if is_relations(path):
        return read_relations(path)
    return read_positions(path) if is_positions(path) else read_trajectory(path)


def against(
    estimate: Trajectory,
    reference: Reference,
    *,
    robot: Platform | None = None,
    align: bool = True,
    scale: bool = False,
    delta: float = 1.0,
    unit: Unit = "m",
    all_pairs: bool = False,
    max_difference: float | None = None,
    interpolate: bool = True,
) -> Evaluation:
    """Score a trajectory by a reference of any kind; arguments that are not of its kind change nothing.

    Args:
        estimate, reference: what is scored, and by what.
        robot: whose lidar's positions were measured; at the robot's origin where it is not known, which a warning says.
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
    about: dict[str, Any]
    if isinstance(reference, Positions):
        kind = "positions"
        ate, issues = _against_positions(estimate, reference, robot, apart, align=align, scale=scale)
        about = {"ate": {name: value for name, value in ate.as_dict().items() if name != "rotation_deg"}}
    else:
        kind = "trajectory"
        ate, issues = _against_trajectory(estimate, reference, apart, align=align, scale=scale)
        rpe = None
        try:
            rpe = relative_pose_error(
                estimate,
                reference,
                delta=delta,
                unit=unit,
                all_pairs=all_pairs,
                max_difference=apart,
            ).as_dict()
        except InputError as error:
            if error.field != "pairs":
                raise
            issues += (Issue("no-relative-error", f"no relative error: {error.problem}"),)
        about = {"oriented": ate.rotation is not None, "ate": ate.as_dict(), "rpe": rpe}
    figures = {"kind": kind, "aligned": align, "scaled": align and scale, **about}
    errors = {"stamps": ate.stamps.tolist(), "translation_m": ate.errors.tolist()}
    if kind == "trajectory":
        errors["rotation_rad"] = None if ate.rotation_errors is None else ate.rotation_errors.tolist()
    return Evaluation(figures | {"warnings": [issue.as_dict() for issue in issues]}, errors, ate)


def _against_trajectory(
    estimate: Trajectory, reference: Trajectory, apart: float, *, align: bool, scale: bool
) -> tuple[AteResult, Issues]:
    def score(moved: Trajectory) -> AteResult:
        return absolute_trajectory_error(moved, reference, align=align, scale=scale, max_difference=apart)

    ate = _on_one_clock(lambda: score(estimate), estimate, reference)
    matched = len(ate.stamps), min(len(estimate), len(reference))
    issues = (*doubts(estimate, reference, ate), *few_matched(*matched, "poses", QUESTION))
    if align and (offset := clock_offset(estimate, reference)) is not None:
        after = score(replace(estimate, stamps=estimate.stamps + offset.seconds))
        issues += (Issue("clocks-differ", in_words(replace(offset, rmse=after.rmse, before=ate.rmse))),)
    return ate, issues


def _against_positions(
    estimate: Trajectory, positions: Positions, robot: Platform | None, apart: float, *, align: bool, scale: bool
) -> tuple[AteResult, Issues]:
    mount = (0.0, 0.0, 0.0) if robot is None else robot.lidar.pose
    if not estimate.oriented and any(mount):
        raise InputError("an estimate without orientation, expected headings: the lidar is not at the robot's origin")
    heads = np.column_stack((positions.points, np.zeros(len(positions))))
    measured_at = Trajectory(positions.stamps, heads, oriented=False)
    there = replace(estimate, poses=compose(estimate.poses, mount), space=None)
    ate = _on_one_clock(
        lambda: position_error(estimate, positions, mount=mount, align=align, scale=scale, max_difference=apart),
        there,
        measured_at,
    )
    issues = few_matched(len(ate.stamps), min(len(estimate), len(positions)), "positions", QUESTION)
    if robot is None:
        text = "the positions are the lidar's, whose place on the robot only the recording says: taken for its origin"
        issues = (Issue("unknown-mount", text), *issues)
    if align and (offset := clock_offset(there, measured_at)) is not None:
        issues += (Issue("clocks-differ", in_words(offset)),)
    return ate, issues


def _on_one_clock(score: Callable[[], AteResult], estimate: Trajectory, reference: Trajectory) -> AteResult:
    """The score; where that fails the error says whether the clocks differ."""
    try:
        return score()
    except InputError as error:
        raise on_another_clock(error, clock_offset(estimate, reference)) from None


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
        reference: a trajectory, relations or positions; by the last no metric is measured.
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
