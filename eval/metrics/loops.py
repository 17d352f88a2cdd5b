"""Precision and recall of loops against the truth (``docs/theory/loops.md``)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from moteslam.errors import InputError
from moteslam.eval.metrics.association import Flags, Indices, covered, evenly, placed_scans, travelled, tree_of
from moteslam.eval.metrics.ate import PoseErrors
from moteslam.robot import se2
from moteslam.robot.recording import Recording
from moteslam.robot.se2 import Array
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import Issue, expect_type
from moteslam.slam.backend.protocol import LoopCandidate
from moteslam.slam.inputs.scans import Scans

MAX_TRANSLATION, MAX_ROTATION = 0.3, np.deg2rad(3.0)
"""A loop whose relative pose is farther from the true one than either, [m] and [rad], is false."""
SPACING, MAX_KEY_SCANS = 0.5, 3000
"""Key scans are the first within each such length of path [m], a turn by a radian counts as a metre; of more than so
many an even choice is looked at."""
MIN_PATH, MAX_DISTANCE = 15.0, 2.0
"""A loop is possible between scans more than this far apart along the path, and at most this far in truth [m] ..."""
MIN_SHARED, SAME_PLACE, MAX_ENDPOINTS = 0.5, 0.2, 100
"""... where at least this share of the later scan's endpoints, or of an even choice of so many, is shared with the
earlier one: closer than this to one of it [m]."""
BOUND_PATH = 2.5
"""A loop binds the scans up to this far before and after its own along the path [m]."""


@dataclass(frozen=True, eq=False, repr=False)
class LoopResult(PoseErrors):
    """The accepted loops [n] of a run whose scans, at the stamps [n, 2], the truth covers, against it.

    Attributes:
        possible, bound: how many later key scans have a possible loop, None without a recording, and how many of those
            a loop binds that was accepted and is not false.
        overruled, overruled_false: how many loops were edges of the graph, but not confirmed by the final path, and how
            many of these are false.
        issues: why precision or recall cannot be had.
    """

    rotation_errors: Array
    possible: int | None
    bound: int
    overruled: int = 0
    overruled_false: int = 0
    issues: tuple[Issue, ...] = ()

    @property
    def is_false(self) -> Flags:
        return np.asarray((self.errors > MAX_TRANSLATION) | (self.rotation_errors > MAX_ROTATION))

    @property
    def false(self) -> int:
        return int(self.is_false.sum())

    @property
    def accepted(self) -> int:
        return self.pairs

    @property
    def precision(self) -> float | None:
        """Share of the accepted loops that are not false, if there are any."""
        return 1 - self.false / self.pairs if self.pairs else None

    @property
    def recall(self) -> float | None:
        """Share of the key scans with a possible loop that are bound, if there are any."""
        return self.bound / self.possible if self.possible else None

    def as_dict(self) -> dict[str, Any]:
        """Fit for JSON: metres and degrees, shares from 0 to 1."""
        names = ("precision", "accepted", "false", "recall", "possible", "bound", "overruled", "overruled_false")
        errors = super().as_dict() if self.pairs else {"translation_m": None, "rotation_deg": None}
        warnings = [issue.as_dict() for issue in self.issues]
        return {**{name: getattr(self, name) for name in names}, **errors, "warnings": warnings}

    def _summary(self) -> str:
        return f"{self.pairs} accepted, {self.false} false, {self.bound} of {self.possible} possible ones bound"


def score_loops(
    loops: Sequence[LoopCandidate], truth: Trajectory, recording: Recording | None = None, *, scans: Scans | None = None
) -> LoopResult:
    """Score the loops that a back end accepted: how many are false, and how many of the possible ones they bind.

    A key scan with a possible loop (``possible_loops``) is bound by a loop that was accepted and is not false, whose
    later scan is at most ``BOUND_PATH`` of path from the key scan, and whose earlier scan is at most as far from one of
    the key scan's partners. Loops outside of the truth, on the clock of the recording, are left out. Without the
    recording, whose endpoints show which loops are possible, there is no recall.
    """
    expect_type(truth, Trajectory, "truth", "read_trajectory(path) reads one")
    if not len(truth):
        raise InputError("a trajectory without poses, expected the true ones", field="truth")
    accepted = [loop for loop in loops if loop.accepted]
    overruled = LoopResult(*_errors([loop for loop in loops if loop.verdict == "overruled"], truth), None, 0)
    found = LoopResult(*_errors(accepted, truth), None, 0)
    issues: tuple[Issue, ...] = ()
    if not found.pairs:
        why = "no loop was accepted" if not accepted else "the truth covers no accepted loop"
        issues = (Issue("no-loop-precision", f"no precision of the loops: {why}"),)
    possible, bound, why = None, 0, "there is no recording whose endpoints show which loops are possible"
    try:
        if recording is not None:
            pairs, places, stamps, path = possible_loops(recording, truth, scans=scans)
            why, later = "no key scan has a possible loop", pairs[:, 1]
            possible, right = len(np.unique(later)), found.stamps[~found.is_false]
            loops_right = tree_of(np.interp(right, stamps, path))
            apart = loops_right.query(places, p=np.inf)[0]  # the larger of the distances along the path
            bound = len(np.unique(later[apart <= BOUND_PATH]))
    except InputError as error:
        if error.field != "trajectory":
            raise
        why = error.problem
    if not possible:
        issues += (Issue("no-loop-recall", f"no recall of the loops: {why}"),)
    found = replace(found, possible=possible, bound=bound, issues=issues)
    return replace(found, overruled=overruled.pairs, overruled_false=overruled.false)


def _errors(loops: Sequence[LoopCandidate], truth: Trajectory) -> tuple[Array, Array, Array]:
    """Of the loops that the truth covers: stamps [a, 2], errors of translation [a] and of rotation [a]."""
    stamps = np.array([loop.stamps for loop in loops]).reshape(-1, 2)
    there = covered(stamps, truth.stamps).all(axis=1)
    stamps, found = stamps[there], np.array([loop.found for loop in loops]).reshape(-1, 3)[there]
    earlier, later = (se2.interpolate(truth.stamps, truth.poses, column) for column in stamps.T)
    true = se2.between(earlier, later)
    return stamps, np.hypot(*(found - true)[:, :2].T), np.abs(se2.wrap(found[:, 2] - true[:, 2]))


def possible_loops(
    recording: Recording, truth: Trajectory, *, scans: Scans | None = None
) -> tuple[Indices, Array, Array, Array]:
    """The loops that a search could have found, pairs of scans [p, 2] by their indices, and the path driven up to both
    [p, 2] [m]; of all scans that the truth covers the stamps [n] [s] and the path up to each [n].

    Key scans are the first within each ``SPACING`` of true path or turn, whatever the run took for its own. A loop is
    possible between two of them that are more than ``MIN_PATH`` of path apart, at most ``MAX_DISTANCE`` apart, and
    share at least ``MIN_SHARED`` of their endpoints, laid at the true poses. Arguments are as of ``score_loops``.
    ``InputError`` of the field ``trajectory``: fewer than two scans with a true pose.
    """
    lidar, index, poses, scans = placed_scans(recording, truth, scans)
    path, turned = travelled(poses)
    keys = evenly(np.unique(np.floor((path + turned) / SPACING), return_index=True)[1], MAX_KEY_SCANS)
    pairs = keys[tree_of(poses[keys, :2]).query_pairs(MAX_DISTANCE, output_type="ndarray")]
    pairs = pairs[path[pairs[:, 1]] - path[pairs[:, 0]] > MIN_PATH]
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    seen = ((scan, scans.points(int(index[scan]))) for scan in np.unique(pairs).tolist())
    clouds = {scan: se2.transform_points(poses[scan], points) for scan, points in seen}
    few = {scan: cloud[evenly(np.arange(len(cloud)), MAX_ENDPOINTS)] for scan, cloud in clouds.items()}
    shared = np.zeros(len(pairs))
    for earlier in np.unique(pairs[:, 0]).tolist():
        some = pairs[:, 0] == earlier
        shared[some] = _shared(clouds[earlier], [few[scan] for scan in pairs[some, 1].tolist()])
    pairs = pairs[shared >= MIN_SHARED]
    return index[pairs], path[pairs], lidar.stamps[index], path


def _shared(cloud: Array, others: list[Array]) -> Array:
    """The share [n] of each scan's endpoints, n arrays [k, 2], that is next to one of ``cloud`` [m, 2]; 0 of none."""
    counts = np.array([len(other) for other in others])
    distances = tree_of(cloud).query(np.concatenate(others), distance_upper_bound=SAME_PLACE)[0]
    scan = np.repeat(np.arange(len(others)), counts)
    return np.asarray(np.bincount(scan[np.isfinite(distances)], minlength=len(others)) / np.maximum(counts, 1))
