"""What is known of a run when it is scored, and what several metrics take from it, computed once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.eval.metrics.association import covered, evenly
from moteslam.eval.metrics.ate import AteResult, absolute_trajectory_error
from moteslam.eval.metrics.consistency import NeesResult, nees_from_start
from moteslam.eval.metrics.localisation import LocalisationResult, score_localisation
from moteslam.eval.metrics.loops import LoopResult, score_loops
from moteslam.eval.metrics.map_accuracy import MapAccuracy, map_accuracy
from moteslam.eval.metrics.map_consistency import MapConsistency, map_consistency
from moteslam.eval.metrics.relations import RelationResult, Relations, evaluate_relations
from moteslam.eval.metrics.residuals import ResidualResult, scan_residuals
from moteslam.eval.metrics.rpe import (
    DriftResult,
    ReturnResult,
    RpeResult,
    Unit,
    drift,
    loop_closing_error,
    relative_pose_error,
)
from moteslam.robot import se2
from moteslam.robot.raster import Raster
from moteslam.robot.recording import Recording
from moteslam.robot.trajectory import Trajectory
from moteslam.slam.backend.ledger import LoopCandidate
from moteslam.slam.estimate import Correction
from moteslam.slam.inputs.scans import Scans
from moteslam.slam.inputs.synchronise import synchronise

Array = NDArray[np.float64]
T = TypeVar("T")

FINAL, ONLINE, DEAD_RECKONING = TRACKS = "final", "online", "dead_reckoning"
"""Names of the trajectories of a run of ours."""

MAX_SEEN = 3000
"""At most this many scans, spread evenly over the drive, show which walls were seen."""


@dataclass(frozen=True, eq=False)
class Certainty:
    """What a filter knew of itself at every scan of the online trajectory.

    Attributes:
        covariances: [n, 3, 3] of the online poses.
        states: [n] as of ``LocalisationState``.
        updated: [n] above 0 where the scan went into the map.
        effective: [n] effective number of particles.
        spread: [u, 3] standard deviation of the particles at every update, along, across [m], heading [rad]; None where
            it was not kept.
        corrections: of the path, by a back end while the robot drove.
    """

    covariances: Array
    states: Array
    updated: Array
    effective: Array
    spread: Array | None = None
    corrections: Sequence[Correction] = ()


@dataclass(frozen=True)
class Cost:
    """What a run took.

    Attributes:
        cpu_seconds: processor time of all threads, in filter and back end.
        wall_seconds: the same by the clock.
        memory: most memory of the process [bytes].
        per_scan: [n] by the clock, of each scan [s]; empty where it was not kept.
    """

    cpu_seconds: float
    wall_seconds: float
    memory: int
    per_scan: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Evidence:
    """What is known of a run; metrics that need what is None cannot be had.

    Attributes:
        trajectories: the estimates by name; ``FINAL`` is the one that the map was drawn along.
        truth: on the clock of the recording.
        relations: of the recording.
        occupancy: the map, trinary.
        true_map: in the frame of the truth, trinary.
        recording: what the sensors saw.
        certainty: of the online trajectory.
        loops: the candidates of the back end; None where it looks for none.
        cost: of the run.
    """

    trajectories: Mapping[str, Trajectory]
    truth: Trajectory | None = None
    relations: Relations | None = None
    occupancy: Raster | None = None
    true_map: Raster | None = None
    recording: Recording | None = None
    certainty: Certainty | None = None
    loops: Sequence[LoopCandidate] | None = None
    cost: Cost | None = None

    @cached_property
    def tracks(self) -> dict[str, Track]:
        """The trajectories, with what is known about them."""
        return {name: Track(trajectory, self) for name, trajectory in self.trajectories.items()}

    def track(self, name: str) -> Track:
        """One of them; ``InputError`` without."""
        return needed(self.tracks.get(name), f"{name} trajectory")

    @cached_property
    def scans(self) -> Scans:
        """The scans of the recording, synchronised once."""
        return synchronise(needed(self.recording, "recording")).scans

    @cached_property
    def localisation(self) -> LocalisationResult:
        """Covariances and states of the online trajectory against the truth."""
        known, truth = needed(self.certainty, "covariances"), needed(self.truth, "truth")
        online = oriented(self.track(ONLINE).trajectory, truth, field="truth")[0]
        return score_localisation(
            online, known.covariances, known.states, known.updated, truth, corrections=known.corrections
        )

    @cached_property
    def nees_from_start(self) -> NeesResult:
        """The NEES of the online trajectory, anchored at the start."""
        known, truth = needed(self.certainty, "covariances"), needed(self.truth, "truth")
        return nees_from_start(oriented(self.track(ONLINE).trajectory, truth)[0], known.covariances, truth)

    @cached_property
    def loop_result(self) -> LoopResult:
        """The accepted loops against the truth."""
        loops, truth = needed(self.loops, "back end that looks for loops"), needed(self.truth, "truth")
        scans = None if self.recording is None else self.scans
        return score_loops(loops, oriented(truth)[0], self.recording, scans=scans)

    @cached_property
    def map_accuracy(self) -> MapAccuracy:
        """The map against the true one, laid on it as the final trajectory is on the truth."""
        occupancy, true_map = needed(self.occupancy, "map"), needed(self.true_map, "true map")
        return map_accuracy(occupancy, true_map, transform=self.track(FINAL).ate.transform, seen=self._seen())

    def _seen(self) -> Array | None:
        """Endpoints [p, 2] of the recording's scans in the true frame."""
        if self.recording is None or self.recording.lidar is None:
            return None
        truth, stamps = needed(self.truth, "truth"), self.recording.lidar.stamps
        if not truth.oriented:
            return None
        there = evenly(np.flatnonzero(covered(stamps, truth.stamps)), MAX_SEEN)
        poses = se2.interpolate(truth.stamps, truth.poses, stamps[there])
        scans = zip(there.tolist(), poses, strict=True)
        seen = [se2.transform_points(pose, self.scans.points(scan)) for scan, pose in scans]
        return np.vstack(seen) if seen else None


class Track:
    """A trajectory with what is known about it; results are computed once.

    Args:
        trajectory: the estimate.
        run: what is known of its run.
    """

    def __init__(self, trajectory: Trajectory, run: Evidence) -> None:
        self.trajectory, self.run = trajectory, run
        self._rpe: dict[tuple[float, Unit], RpeResult] = {}

    @property
    def truth(self) -> Trajectory:
        """Of the run; ``InputError`` without."""
        return needed(self.run.truth, "truth")

    @cached_property
    def ate(self) -> AteResult:
        """After rigid alignment."""
        return absolute_trajectory_error(self.trajectory, self.truth)

    @cached_property
    def drift(self) -> DriftResult:
        """Per metre of path."""
        return drift(*oriented(self.trajectory, self.truth))

    @cached_property
    def returns(self) -> ReturnResult:
        """Where the robot comes back to a place."""
        return loop_closing_error(*oriented(self.trajectory, self.truth))

    @cached_property
    def relations(self) -> RelationResult:
        """Against hand-checked relations."""
        return evaluate_relations(oriented(self.trajectory)[0], needed(self.run.relations, "relations"))

    @cached_property
    def residuals(self) -> ResidualResult:
        """Of the recording's scans."""
        (trajectory,) = oriented(self.trajectory)
        return scan_residuals(needed(self.run.recording, "recording"), trajectory, scans=self.run.scans)

    @cached_property
    def consistency(self) -> MapConsistency:
        """Of the map that the recording's scans draw."""
        (trajectory,) = oriented(self.trajectory)
        return map_consistency(needed(self.run.recording, "recording"), trajectory, scans=self.run.scans)

    def rpe(self, delta: float, unit: Unit) -> RpeResult:
        """Over a distance, a time, or a number of poses."""
        key = delta, unit
        if key not in self._rpe:
            self._rpe[key] = relative_pose_error(self.trajectory, self.truth, delta=delta, unit=unit)
        return self._rpe[key]


def oriented(*trajectories: Trajectory, field: str | None = None) -> tuple[Trajectory, ...]:
    """The trajectories; ``InputError`` of the field if one of them has no headings."""
    if not all(trajectory.oriented for trajectory in trajectories):
        raise InputError("a trajectory without orientation, expected headings", field=field)
    return trajectories


def needed(value: T | None, name: str) -> T:
    """The value; ``InputError`` if it is None."""
    if value is None:
        raise InputError(f"no {name}")
    return value
