"""A trajectory scored as a value: against another one, relations or positions, or by the scans of its recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np

from moteslam.errors import ConfigError, InputError
from moteslam.eval.comparison_issues import few_matched, of_reading, of_shape, said
from moteslam.eval.metrics.association import MAX_DIFFERENCE
from moteslam.eval.metrics.ate import AteResult, absolute_trajectory_error
from moteslam.eval.metrics.clock import clock_offset
from moteslam.eval.metrics.evidence import FINAL, Evidence, oriented
from moteslam.eval.metrics.positions import PositionResult, position_error
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
from moteslam.eval.metrics.rpe import RpeResult, relative_pose_error
from moteslam.eval.metrics.space import in_plane, space_issues, spatial
from moteslam.robot.formats.map_server import read_map
from moteslam.robot.platform import Platform
from moteslam.robot.recording import Recording
from moteslam.robot.se2 import compose
from moteslam.robot.trajectories import read_trajectory
from moteslam.robot.trajectories.rows import is_positions, read_positions
from moteslam.robot.trajectory import TILT, Positions, Trajectory, tilt_of
from moteslam.robot.values import Issue
from moteslam.slam.inputs.scans import Scans

ACCURACY_OF_MAPS = ("map_precision", "map_recall", "map_f1", "map_distance", "map_free_iou", "map_known")
"""Metrics that compare a map with the true one."""


@dataclass(frozen=True, eq=False)
class AgainstTrajectory:
    """A trajectory against another one.

    Attributes:
        ate: the absolute error.
        aligned: whether after rigid alignment.
        scaled: whether the alignment fitted the scale, too.
        rpe: the relative error; None where it cannot be had.
        issues: why it cannot be had; that few poses have a partner; how they were read and compared; that the clocks
            differ.
    """

    ate: AteResult
    aligned: bool
    scaled: bool
    rpe: RpeResult | None
    issues: tuple[Issue, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """The statistics as they go into JSON."""
        return {
            "kind": "trajectory",
            "aligned": self.aligned,
            "scaled": self.scaled,
            "oriented": self.ate.rotation is not None,
            "ate": self.ate.as_dict(),
            "rpe": None if self.rpe is None else self.rpe.as_dict(),
            "warnings": [issue.as_dict() for issue in self.issues],
        }

    def errors(self) -> dict[str, Any]:
        """The error at every stamp, as it goes into JSON."""
        turns = self.ate.rotation_errors
        return {
            "stamps": self.ate.stamps.tolist(),
            "translation_m": self.ate.errors.tolist(),
            "rotation_rad": None if turns is None else turns.tolist(),
        }


@dataclass(frozen=True, eq=False)
class AgainstRelations:
    """A trajectory against hand-checked relations."""

    result: RelationResult

    def as_dict(self) -> dict[str, Any]:
        """The statistics as they go into JSON."""
        return {"kind": "relations", **self.result.as_dict()}

    def errors(self) -> dict[str, Any]:
        """The error of every relation that was used, as it goes into JSON."""
        return {
            "stamps": self.result.stamps.tolist(),
            "translation_m": self.result.errors.tolist(),
            "rotation_rad": self.result.rotation_errors.tolist(),
        }


@dataclass(frozen=True, eq=False)
class AgainstPositions:
    """A trajectory against measured positions of the lidar.

    Attributes:
        ate: the absolute error of the lidar's position.
        aligned: whether after rigid alignment.
        scaled: whether the alignment fitted the scale, too.
        issues: that the lidar's place on the robot is not known; that few positions have a pose.
    """

    ate: PositionResult
    aligned: bool
    scaled: bool
    issues: tuple[Issue, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """The statistics as they go into JSON."""
        return {
            "kind": "positions",
            "aligned": self.aligned,
            "scaled": self.scaled,
            "ate": self.ate.as_dict(),
            "warnings": [issue.as_dict() for issue in self.issues],
        }

    def errors(self) -> dict[str, Any]:
        """The error at every stamp, as it goes into JSON."""
        return {"stamps": self.ate.stamps.tolist(), "translation_m": self.ate.errors.tolist()}


@dataclass(frozen=True, eq=False)
class UnderRecording:
    """The scans of a recording under a trajectory.

    Attributes:
        result: their residuals.
        issues: that few poses have a scan.
    """

    result: ResidualResult
    issues: tuple[Issue, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """The statistics as they go into JSON."""
        return {**self.result.as_dict(), "warnings": [issue.as_dict() for issue in self.issues]}

    def errors(self) -> dict[str, Any]:
        """The median residual of every scan that was compared, as it goes into JSON; null for a scan without any."""
        return {
            "stamps": self.result.stamps.tolist(),
            "median_m": [None if isnan(median) else median for median in self.result.medians.tolist()],
        }


@dataclass(frozen=True, eq=False)
class Evaluated:
    """What a trajectory was scored by: a reference, the scans of its recording, or both; None where it was not."""

    against: AgainstTrajectory | AgainstRelations | AgainstPositions | None = None
    under: UnderRecording | None = None


def read_reference(path: Path) -> Trajectory | Relations | Positions:
    """What to score by: relations, positions or a trajectory, by the content of a file.

    Raises:
        InputError: it is none of them, or broken.
    """
    if is_relations(path):
        return read_relations(path)
    return read_positions(path) if is_positions(path) else read_trajectory(path)


def against_trajectory(
    estimate: Trajectory,
    reference: Trajectory,
    *,
    align: bool = True,
    scale: bool = False,
    delta: float = 1.0,
    unit: str = "m",
    all_pairs: bool = False,
    max_difference: float | None = None,
) -> AgainstTrajectory:
    """Score a trajectory by another one.

    Args:
        estimate, reference: the trajectories.
        align: lay the estimate on the reference first.
        scale: multiply it by the scale of least squares, too.
        delta, unit, all_pairs: of the relative error, as in ``relative_pose_error``.
        max_difference: between stamps that belong together [s].

    Raises:
        InputError: no stamps in common, or an option out of bounds. A trajectory shorter than ``delta`` has no
            relative error, and the rest all the same.
    """
    apart = MAX_DIFFERENCE if max_difference is None else max_difference
    try:
        ate = absolute_trajectory_error(estimate, reference, align=align, scale=scale, max_difference=apart)
    except InputError as error:
        offset = clock_offset(estimate, reference)
        if offset is None:
            raise
        raise InputError(f"{error.problem}; {said(offset)}", file=error.file, field=error.field) from error
    issues = of_reading(estimate, reference) + space_issues(estimate, reference) + of_shape(ate)
    issues += few_matched(
        len(ate.stamps), min(len(estimate), len(reference)), "poses", "are these the same drive, on the same clock?"
    )
    if align and (offset := clock_offset(estimate, reference)) is not None:
        moved = replace(estimate, stamps=estimate.stamps + offset.seconds)
        after = absolute_trajectory_error(moved, reference, scale=scale, max_difference=apart)
        issues += (Issue("clocks-differ", said(replace(offset, rmse=after.rmse, before=ate.rmse))),)
    rpe: RpeResult | None = None
    try:
        rpe = relative_pose_error(
            estimate,
            reference,
            delta=delta,
            unit=unit,  # type: ignore[arg-type]  # checked there
            all_pairs=all_pairs,
            max_difference=apart,
        )
    except InputError as error:
        if error.field != "pairs":
            raise
        issues += (Issue("no-relative-error", f"no relative error: {error.problem}"),)
    return AgainstTrajectory(ate, align, align and scale, rpe, issues)


def against_relations(
    estimate: Trajectory, relations: Relations, *, interpolate: bool = True, tolerance: float | None = None
) -> AgainstRelations:
    """Score a trajectory by relations; arguments and errors as in ``evaluate_relations``."""
    tolerance = TOLERANCE if tolerance is None else tolerance
    return AgainstRelations(evaluate_relations(estimate, relations, interpolate=interpolate, tolerance=tolerance))


def against_positions(
    estimate: Trajectory,
    positions: Positions,
    *,
    robot: Platform | None = None,
    align: bool = True,
    scale: bool = False,
    max_difference: float | None = None,
) -> AgainstPositions:
    """Score a trajectory by measured positions of the lidar; arguments and errors as in ``position_error``.

    Args:
        estimate, positions, align, scale, max_difference: as there.
        robot: that the lidar stands on; at its origin where it is not known, which an issue says.
    """
    apart = MAX_DIFFERENCE if max_difference is None else max_difference
    mount = (0.0, 0.0, 0.0) if robot is None else robot.lidar.pose
    if not estimate.oriented and any(mount):
        raise InputError("an estimate without orientation, expected headings: the lidar is not at the robot's origin")
    heads = np.column_stack((positions.points, np.zeros(len(positions))))
    measured_at = Trajectory(positions.stamps, heads, oriented=False)
    there = replace(estimate, poses=compose(estimate.poses, mount), space=None)
    try:
        ate = position_error(estimate, positions, mount=mount, align=align, scale=scale, max_difference=apart)
    except InputError as error:
        if (offset := clock_offset(there, measured_at)) is None:
            raise
        raise InputError(f"{error.problem}; {said(offset)}", file=error.file, field=error.field) from error
    question = "are these of the same drive, on the same clock?"
    issues = few_matched(len(ate.stamps), min(len(estimate), len(positions)), "positions", question)
    if robot is None:
        text = "the positions are the lidar's, whose place on the robot only the recording says: taken for its origin"
        issues = (Issue("unknown-mount", text), *issues)
    if align and (offset := clock_offset(there, measured_at)) is not None:
        issues += (Issue("clocks-differ", said(offset)),)
    return AgainstPositions(ate, align, align and scale, issues)


def under_recording(estimate: Trajectory, recording: Recording, *, scans: Scans | None = None) -> UnderRecording:
    """Score a trajectory by the scans of its recording; arguments and errors as in ``scan_residuals``."""
    oriented(estimate)
    result = scan_residuals(recording, estimate, scans=scans)
    assert recording.lidar is not None  # or there would be no residuals
    shorter = min(len(estimate), len(recording.lidar))
    question = "is this its recording, on the same clock?"
    return UnderRecording(result, few_matched(result.matched, shorter, "scans or poses", question))


def measured(
    estimate: Trajectory,
    reference: Trajectory | Relations | Positions | None,
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

    Raises:
        ConfigError: a name that is no metric's.
        InputError: a map that cannot be read, or no stamps in common.
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
    try:
        return measure(evidence, dict.fromkeys([*(ACCURACY_OF_MAPS if true_map is not None else ()), *(names or ())]))
    except ConfigError as error:
        raise ConfigError(error.problem, file=error.file, field="--metric") from error
