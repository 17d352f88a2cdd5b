"""What is known after every scan, and what is kept of it: pose and motion, how sure the filter was, what it cost."""

from dataclasses import dataclass
from itertools import zip_longest

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.se2 import Array
from moteslam.robot.values import Issue, Summarised, counted
from moteslam.slam.filter.certainty import LocalisationState, state_of
from moteslam.slam.rows import Rows

DIAGNOSTICS = (
    "particles", "n_eff", "score", "updated", "resampled", "seconds", "degenerate", "wrong", "state", "corrected",
)  # fmt: skip
"""What is kept of every step: see ``Estimate.diagnostics``."""


@dataclass(frozen=True, eq=False, repr=False)
class Update(Summarised):
    """What is known after a scan.

    Attributes:
        index, stamp: of the scan; stamp in s.
        pose: [3] estimate at the scan.
        poses, weights: [N, 3] and [N] of the particles, at the last scan that the filter updated them with; of `paper`
            before they were resampled, as ``n_eff`` is.
        n_eff, score, updated, resampled: see ``StepResult``.
        seconds: spent on it.
        corrected: how far the back end then moved the robot, with the map [m]; 0 where it did not. The next pose is
            the first after it.
        covariance, degenerate, wrong: how sure the filter is of the pose, see ``Certainty``.
    """

    index: int
    stamp: float
    pose: Array
    poses: Array
    weights: Array
    n_eff: float
    score: float
    updated: bool
    resampled: bool
    seconds: float
    corrected: float
    covariance: Array
    degenerate: float
    wrong: float

    @property
    def particles(self) -> int:
        """How many there are."""
        return len(self.poses)

    @property
    def state(self) -> LocalisationState:
        """The probability ``wrong`` in a word."""
        return state_of(self.wrong)

    def _summary(self) -> str:
        return f"{super()._summary()}, state={self.state.name}"


class ScanRecords:
    """A row a scan, in the order of the scans."""

    def __init__(self) -> None:
        self._rows = Rows(6 + 9 + len(DIAGNOSTICS))  # pose, motion, covariance, diagnostics
        self.last_sure = -1  # index of the latest scan at which the filter was sure of the pose; -1 without one

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, update: Update, motion: Array) -> None:
        """Record the next scan, and the motion [3] to it."""
        if update.state == LocalisationState.SURE:
            self.last_sure = len(self)
        diagnostics = [float(getattr(update, name)) for name in DIAGNOSTICS]
        self._rows.add(np.concatenate((update.pose, motion, update.covariance, diagnostics), axis=None)[None])

    def add_to_last(self, *, seconds: float, corrected: float) -> None:
        """What the latest scan cost, and was corrected by, beyond what is recorded of it."""
        diagnostics = self._rows.values[-1, 15:]
        diagnostics[DIAGNOSTICS.index("seconds")] += seconds
        diagnostics[DIAGNOSTICS.index("corrected")] += corrected

    @property
    def poses(self) -> Array:
        """The filter's pose [k, 3] at each recorded scan."""
        return self._rows.values[:, :3].copy()

    @property
    def motions(self) -> Array:
        """The motion [k, 3] from the scan before to each, in that one's frame."""
        return self._rows.values[:, 3:6].copy()

    @property
    def covariances(self) -> Array:
        """Of the poses, [k, 3, 3]."""
        return self._rows.values[:, 6:15].reshape(-1, 3, 3)

    @property
    def diagnostics(self) -> dict[str, Array]:
        """By the names of `DIAGNOSTICS`, [k] each."""
        columns = np.ascontiguousarray(self._rows.values[:, 15:].T)
        return dict(zip(DIAGNOSTICS, columns, strict=True))


class Losses:
    """Takes note of a run's losses."""

    def __init__(self) -> None:
        self._stamps: list[float] = []  # when it was lost and found, in turns [s]
        self._parts: list[tuple[int, int]] = []  # the first scan that did not fit, and the first in the map apart

    def note(self, lost: bool, stamp: float, *, doubted_from: int, scan: int) -> None:
        """Take in an update with a scan, at a stamp [s]; ``doubted_from``: the first scan since the pose was sure."""
        if lost is (len(self._stamps) % 2 == 1):
            return
        self._stamps.append(stamp)
        if lost:
            self._parts.append((doubted_from, scan))

    def drawn(self, updates: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Of which updates, with scans of these indices [u], the map is drawn, while the robot is lost: of the longer
        part.

        Where the two lie relative to each other is not known, and one would be drawn over the other.
        """
        if len(self._stamps) % 2 == 0:
            return np.ones(len(updates), np.bool_)
        apart = updates >= self._parts[-1][1]
        return np.asarray(apart == (apart.mean() > 0.5))

    def parted(self, poses: Array, updates: NDArray[np.intp], driven: Array) -> Array:
        """Poses [n, 3] of all scans without the bridge from a part of the path to the next.

        What no longer fitted the map before belongs to what follows, what did to what was before. Poses between those
        of the updates, with scans of indices [u], are as if it were one path; those ``driven`` [n, 3] are by the motion
        from scan to scan alone.
        """
        for first, begun in self._parts:
            last = int(updates[updates < first][-1])
            poses[last:first] = se2.compose(poses[last], se2.between(driven[last], driven[last:first]))
            poses[first:begun] = se2.compose(poses[begun], se2.between(driven[begun], driven[first:begun]))
        return poses

    def issues(self, states: Array) -> tuple[Issue, ...]:
        """Each loss with its times; or that most scans, of these states [k], are lost where no map apart was begun."""
        lost, issues = int((states == LocalisationState.LOST).sum()), []
        if not self._stamps and 2 * lost > len(states):
            text = f"at {lost} of {counted(len(states), 'scan')} the pose is more likely wrong than right (lost): the "
            issues.append(Issue("lost", f"{text}scans do not say where in its map the robot is", lost))
        for begin, end in zip_longest(self._stamps[::2], self._stamps[1::2]):
            text = f"from {begin:.2f} s on the scans do not say where in its map the robot is: it is lost, and a map "
            until = "to the end: how the two lie is a prediction; the map is that of the longer part"
            if end is not None:
                until = f"until it is found in the one before at {end:.2f} s"
            issues.append(Issue("lost", f"{text}apart is drawn, {until}"))
        return tuple(issues)
