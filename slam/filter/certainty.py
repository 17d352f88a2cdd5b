"""How sure a filter is of its pose at a scan: a covariance, the degenerate direction, and a state in one word.

All of it is relative to the map around the robot, the scans taken within ``NEIGHBOURHOOD`` of it: a map that bends
slowly over a building makes nobody lost (``docs/theory/am-i-lost.md``).
"""

import math
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.se2 import Array, Pose
from moteslam.slam.filter.covariance import Symmetric, as_array, largest_deviation
from moteslam.slam.mapping.config import LOST_DISTANCE, LOST_ROTATION, RESOLVED

NEIGHBOURHOOD = 5.0  # The map around the robot was made from poses up to this distance from it [m]
FLOOR = RESOLVED[0] ** 2, RESOLVED[1] ** 2  # Variances that no pose falls below [m^2], [rad^2]
DOUBTFUL_FROM, LOST_FROM = 0.05, 0.5  # Probability of a wrong pose from which on it is doubtful, and lost


class LocalisationState(IntEnum):
    """Whether the pose is right within ``LOST_DISTANCE`` and ``LOST_ROTATION`` of the map around the robot."""

    SURE = 0  # nothing speaks against it
    DOUBTFUL = 1  # it may be wrong
    LOST = 2  # it is more likely wrong than right

    def __str__(self) -> str:
        return self.name

    __format__ = Enum.__format__  # by __str__


class Certainty(NamedTuple):
    """How sure a filter is of the pose at one scan."""

    # [3, 3] of the pose's error relative to the map around the robot, in the robot's frame: x forward and y left
    # [m], theta [rad].
    covariance: Array
    # heading of the direction in the plane about which the scan carries less information than the odometry, in
    # the robot's frame, -pi/2 to pi/2 [rad]; NaN without one.
    degenerate: float
    wrong: float  # probability that the pose is wrong, by its covariance and by how the scans fit the map


def state_of(wrong: float) -> LocalisationState:
    """The state by the probability of a wrong pose."""
    if wrong < DOUBTFUL_FROM:
        return LocalisationState.SURE
    return LocalisationState.DOUBTFUL if wrong < LOST_FROM else LocalisationState.LOST


def wrong_by_spread(position: float, heading: float) -> float:
    """The probability of a wrong pose by standard deviations alone, if errors are normal; 1 at most.

    The first is the largest of the position in any direction [m], the other of the heading [rad].
    """
    return min(_beyond(LOST_DISTANCE, position) + _beyond(LOST_ROTATION, heading), 1.0)


def certainty_of(covariance: Symmetric, degenerate: float, misfit: float) -> Certainty:
    """As of ``Certainty``, with the probability of a wrong pose by how the scans fit the map."""
    spread = wrong_by_spread(largest_deviation(covariance), math.sqrt(covariance[5]))
    return Certainty(as_array(covariance), degenerate, 1 - (1 - spread) * (1 - misfit))


def certainty_of_particles(poses: Array, weights: Array, pose: Array) -> Certainty:
    """What the spread of particles [N, 3] of weights [N], sum 1, about an estimate [3] shows.

    For filters that measure no more themselves.
    """
    off = se2.between(pose, poses)
    covariance = (off * weights[:, None]).T @ off + np.diag((FLOOR[0], *FLOOR))
    position = math.sqrt(float(np.linalg.eigvalsh(covariance[:2, :2])[1]))
    return Certainty(covariance, math.nan, wrong_by_spread(position, math.sqrt(covariance[2, 2])))


def _beyond(limit: float, deviation: float) -> float:
    """The probability that a normal error is beyond a limit to either side."""
    return math.erfc(limit / (math.sqrt(2) * deviation)) if deviation > 0 else 0.0


def spread(poses: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """The weighted standard deviations [3] of particles [N, 3]: along and across the mean heading [m], of the heading
    [rad].
    """
    if len(poses) == 1:
        return np.zeros(3)
    x, y = weights @ poses[:, :2]
    heading = np.arctan2(weights @ np.sin(poses[:, 2]), weights @ np.cos(poses[:, 2]))
    deviations = se2.between(np.array((x, y, heading)), poses)
    return np.asarray(np.sqrt(weights @ np.square(deviations)))


DOUBTFUL_DROP, LOST_DROP = 3.5, 6.0
"""A scan whose score is below the mean by this many standard deviations is doubtful, or lost. Chosen on simulated
drives of seeds from 200 on, with and without robots that were carried off (docs/theory/am-i-lost.md)."""
LEAST_SPREAD = 0.05  # The least standard deviation, and the first, which counts like `FIRST_PATH` of path; likewise
FIRST_PATH = 10.0  # See `LEAST_SPREAD` [m]
WRONG_IF_DOUBTFUL, WRONG_IF_LOST = 0.3, 0.75
"""Probability of a wrong pose: of the scans called lost three of four were wrong, over all scenarios."""


class Scores:
    """What match scores are usual: their mean along the last ``NEIGHBOURHOOD`` of path, their spread along it all."""

    def __init__(self) -> None:
        self.mean = 0.0  # so far
        self._scans = 0  # that it is of
        self._variance, self._path = LEAST_SPREAD**2, FIRST_PATH  # of the scores about it, along all the path

    @property
    def spread(self) -> float:
        """Standard deviation of the scores about their mean."""
        return max(math.sqrt(self._variance), LEAST_SPREAD)

    def below(self, score: float) -> float:
        """How far a score is below the mean; 0 for the first."""
        return self.mean - score if self._scans else 0.0

    def take_in(self, driven: float, score: float) -> None:
        """Take in the next score, of a scan driven so far after the one before [m]."""
        step, below = min(driven, NEIGHBOURHOOD), self.below(score)
        self._path += step
        self._variance += step / self._path * (below * below - self._variance)
        self._scans += 1
        self.mean += max(1 / self._scans, step / NEIGHBOURHOOD) * (score - self.mean)


@dataclass
class _Drop:
    """A scan that did not fit, and how those since did."""

    usual: float  # mean score before, less a standard deviation: what counts as fitting again
    before: Array  # [u, 2] places of the updates before
    path: float = 0.0  # driven since [m]
    matched: float = 0.0  # part of that to scans that were used [m]
    fit: float = 0.0  # sum of their scores, each times the distance that it was driven over [m]

    def over(self, x: float, y: float) -> bool:
        """Whether the scans since fit as well as those before, or nothing around the robot is from before."""
        if self.path <= NEIGHBOURHOOD:
            return False
        if self.matched > 0 and self.fit >= self.usual * self.matched:
            return True
        return not (np.hypot(self.before[:, 0] - x, self.before[:, 1] - y) <= NEIGHBOURHOOD).any()


class Misfit:
    """Whether the scans still fit the map as they did: a robot that is lost sees another place than its map shows.

    The match score of a scan is compared with those along the path before, in their own standard deviations: what is
    usual in a calm room and among people differs. A sudden drop marks a place from which on the robot may be lost: soon
    after, the filter has written the new scans into its map, and they fit again, wherever they are. So a drop counts
    until the map around the robot holds nothing from before it, or the scans fit as well as before.
    """

    def __init__(self) -> None:
        self._scores = Scores()
        self._places: list[tuple[float, float]] = []  # of the updates
        self._lost: _Drop | None = None
        self._doubtful: float | None = None  # path since [m]

    @property
    def state(self) -> LocalisationState:
        if self._lost is not None:
            return LocalisationState.LOST
        return LocalisationState.SURE if self._doubtful is None else LocalisationState.DOUBTFUL

    @property
    def probability(self) -> float:
        """That the pose is wrong, by that state."""
        return (0.0, WRONG_IF_DOUBTFUL, WRONG_IF_LOST)[self.state]

    def observe(self, driven: float, score: float | None) -> None:
        """Take in a scan, driven so far after the one before [m].

        The score is a share of the points where the map is known; None if the scan was not matched.
        """
        if self._lost is not None:
            self._lost.path += driven
        if self._doubtful is not None:
            self._doubtful += driven
            if self._doubtful > NEIGHBOURHOOD:
                self._doubtful = None
        if score is not None:
            self._compare(driven, score)

    def update(self, pose: Pose) -> None:
        x, y, _ = pose
        self._places.append((x, y))
        if self._lost is not None and self._lost.over(x, y):
            self._lost = None

    def revise(self, poses: Array) -> None:
        """Take in corrected poses [u, 3] of all updates."""
        self._places = [(x, y) for x, y, _ in poses.tolist()]
        if self._lost is not None:
            self._lost.before = poses[: len(self._lost.before), :2].copy()

    def _compare(self, driven: float, score: float) -> None:
        """Compare a score with those before, and take it in among them."""
        spread, below = self._scores.spread, self._scores.below(score)
        if below > LOST_DROP * spread:
            usual = self._scores.mean - spread if self._lost is None else self._lost.usual
            self._lost = _Drop(usual, np.array(self._places).reshape(-1, 2))
        elif below > DOUBTFUL_DROP * spread:
            self._doubtful = 0.0
        self._scores.take_in(driven, score)
        if self._lost is not None:
            self._lost.matched += driven
            self._lost.fit += score * driven
