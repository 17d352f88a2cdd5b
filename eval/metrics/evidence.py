"""What is known of a run when it is scored, and what several metrics take from it, computed once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from moteslam.errors import InputError
from moteslam.eval.metrics import localisation as filters
from moteslam.eval.metrics.association import covered, evenly, oriented
from moteslam.eval.metrics.ate import AteResult, absolute_trajectory_error
from moteslam.eval.metrics.loops import LoopResult, score_loops
from moteslam.eval.metrics.map_quality import MapAccuracy, MapConsistency, map_accuracy, map_consistency
from moteslam.eval.metrics.relations import RelationResult, Relations, evaluate_relations
from moteslam.robot import se2
from moteslam.robot.raster import Raster
from moteslam.robot.recording import Recording
from moteslam.robot.se2 import Array
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import Summarised
from moteslam.slam.backend.protocol import LoopCandidate
from moteslam.slam.estimate import Correction
from moteslam.slam.inputs.scans import Scans
from moteslam.slam.inputs.synchronise import synchronise

T = TypeVar("T")

FINAL, ONLINE, DEAD_RECKONING = TRACKS = "final", "online", "dead_reckoning"
"""Names of the trajectories of a run of ours."""

COVERED = 0.9  # A truth at this share of the scans has all of the way driven
MAX_SEEN = 3000  # At most this many scans, spread evenly over the drive, show which walls were seen


@dataclass(frozen=True, eq=False, repr=False)
class Certainty(Summarised):
    """What a filter knew of itself at every scan of the online trajectory: as of ``score_localisation``, the effective
    number of particles [n], and the standard deviation of the particles at every update [u, 3], along, across [m],
    heading [rad].
    """

    covariances: Array
    states: Array
    updated: Array
    effective: Array
    spread: Array | None = None
    corrections: Sequence[Correction] = ()


@dataclass(frozen=True)
class Cost:
    """What a run took: seconds in filter and back end, of all threads and by the clock, for each scan by the clock, and
    the most memory of the process [bytes].
    """

    cpu_seconds: float
    wall_seconds: float
    memory: int
    per_scan: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Evidence:
    """What is known of a run; metrics that need what is None cannot be had.

    ``FINAL`` is the trajectory that the map was drawn along; truth and relations are on the clock of the recording,
    both maps trinary, the true one in the frame of the truth; ``loops`` are the candidates of a back end that looks for
    some.
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
    def _tracks(self) -> dict[str, Track]:
        return {name: Track(trajectory, self) for name, trajectory in self.trajectories.items()}

    def track(self, name: str) -> Track:
        """The trajectory of that name, with what is known about it; ``InputError`` without."""
        return needed(self._tracks.get(name), f"{name} trajectory")

    @cached_property
    def driven(self) -> tuple[float, str]:
        """The way driven [m] and by what: the same for every SLAM by the ``truth``, if that covers the scans."""
        final = self.trajectories[FINAL]
        stamps = final.stamps if self.recording is None or self.recording.lidar is None else self.recording.lidar.stamps
        if self.truth is None or covered(stamps, self.truth.stamps).mean() < COVERED:
            return final.length, "SLAM's path"
        there = (self.truth.stamps >= stamps[0]) & (self.truth.stamps <= stamps[-1])
        return Trajectory(self.truth.stamps[there], self.truth.poses[there]).length, "truth"

    @cached_property
    def scans(self) -> Scans:
        return synchronise(needed(self.recording, "recording")).scans

    def _known(self) -> tuple[Certainty, Trajectory, Trajectory]:
        """What the filter knew of itself, the online trajectory, and the truth, both with headings."""
        known, truth = needed(self.certainty, "covariances"), needed(self.truth, "truth")
        online, truth = oriented(self.track(ONLINE).trajectory, truth, field="truth")
        return known, online, truth

    @cached_property
    def localisation(self) -> filters.LocalisationResult:
        known, online, truth = self._known()
        said = known.covariances, known.states, known.updated
        return filters.score_localisation(online, *said, truth, corrections=known.corrections)

    @cached_property
    def nees_from_start(self) -> filters.NeesResult:
        known, online, truth = self._known()
        return filters.nees_from_start(online, known.covariances, truth)

    @property
    def time_taken(self) -> Cost:
        return needed(self.cost, "time was measured")

    @property
    def within_spread(self) -> float:
        """How often the true pose, anchored at the start, lies in the particles' 95 % ellipsoid at an update."""
        known, online, truth = self._known()
        true = truth.at(online.stamps).poses
        laid = se2.compose(se2.compose(true[0], se2.inverse(online.poses[0])), online.poses)
        spread = needed(known.spread, "spread of the particles")
        return filters.share_within_spread(se2.between(true, laid)[known.updated > 0], spread)

    @cached_property
    def loop_result(self) -> LoopResult:
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
        truth = needed(self.truth, "truth")
        if self.recording is None or self.recording.lidar is None or not truth.oriented:
            return None
        stamps = self.recording.lidar.stamps
        there = evenly(np.flatnonzero(covered(stamps, truth.stamps)), MAX_SEEN)
        poses = se2.interpolate(truth.stamps, truth.poses, stamps[there])
        scans = zip(there.tolist(), poses, strict=True)
        seen = [se2.transform_points(pose, self.scans.points(scan)) for scan, pose in scans]
        return np.vstack(seen) if seen else None


class Track:
    """A trajectory of a run with what is known about it; ``once`` computes a result once."""

    def __init__(self, trajectory: Trajectory, run: Evidence) -> None:
        self.trajectory, self.run = trajectory, run
        self._results: dict[Any, Any] = {}

    @property
    def truth(self) -> Trajectory:
        return needed(self.run.truth, "truth")

    def once(self, compare: Callable[..., T], **options: Any) -> T:
        """``compare(trajectory, truth, **options)``."""
        key = (compare, *options.items())
        if key not in self._results:
            self._results[key] = compare(self.trajectory, self.truth, **options)
        found: T = self._results[key]
        return found

    @property
    def ate(self) -> AteResult:
        return self.once(absolute_trajectory_error)

    @cached_property
    def relations(self) -> RelationResult:
        return evaluate_relations(oriented(self.trajectory)[0], needed(self.run.relations, "relations"))

    @cached_property
    def consistency(self) -> MapConsistency:
        return map_consistency(*self.under_scans(), scans=self.run.scans)

    def under_scans(self) -> tuple[Recording, Trajectory]:
        """The recording, and the trajectory with headings along which its scans are laid; ``InputError`` without."""
        return needed(self.run.recording, "recording"), oriented(self.trajectory)[0]


def needed(value: T | None, name: str) -> T:
    """The value; ``InputError`` if it is None."""
    if value is None:
        raise InputError(f"no {name}")
    return value
