"""The paper's particle filter: one map shared by all particles, each moved to the best of its neighbourhood."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.kernels.matching import match_poses
from moteslam.robot import se2
from moteslam.robot.raster import Raster
from moteslam.robot.values import shortened
from moteslam.slam.filter.certainty import Certainty, certainty_of
from moteslam.slam.filter.history import History
from moteslam.slam.filter.misfit import Misfit
from moteslam.slam.filter.protocol import FilterDefaults, Scans, Step, StepResult
from moteslam.slam.filter.resampling import choose_parents
from moteslam.slam.filter.update_policy import Travelled, magnitude, update_due
from moteslam.slam.filter.weights import Weights
from moteslam.slam.mapping.occupancy import OccupancyGrid
from moteslam.slam.paper.config import PaperFilterConfig
from moteslam.slam.paper.prediction import ParticleCovariance, predict

Array = NDArray[np.float64]


class PaperFilter(FilterDefaults):
    """Section III.D of the paper: predict, match, weight, resample, map.

    Args:
        config: of the method ``paper``.

    Attributes:
        poses: [N, 3] of the particles at the last update.
        weights: of the particles.
        grid: the one shared map.
        history: the particles' poses at every update.
        best_particle: index into the last update's particles, before they were resampled.
    """

    def __init__(self, config: PaperFilterConfig, seed: int) -> None:
        self._config, self._seed = config, seed
        self._offsets_xy = np.array(config.search.offsets_xy)
        self._offsets_theta = np.array(config.search.offsets_theta)
        self.poses = np.zeros((config.particles, 3))
        self.weights = Weights.uniform(config.particles)
        self.grid = OccupancyGrid(config.map)
        self.history = History()
        self.best_particle = 0
        self._best = self.poses[0].copy()
        self._motion, self._travelled = np.zeros(3), Travelled()  # since the last update
        self._covariance, self._misfit = ParticleCovariance(config.motion, config.search), Misfit()

    def step(self, step: Step) -> StepResult:
        """Take in one scan and the motion since the scan before."""
        self._motion = se2.compose(self._motion, step.motion)
        motion = se2.as_pose(step.motion)
        self._travelled = self._travelled.plus(*magnitude(motion), step.dt)
        self._covariance.move(motion, step.dt, measured=step.measured)
        if len(self.history) and not update_due(self._config.update, self._travelled):
            pose = se2.compose(self._best, self._motion)
            return StepResult(pose, step.motion, self.weights.effective_number, 0, False, False, self._certainty())
        score, driven = 0, self._travelled.distance
        if len(self.history):
            self._predict(step)
            scores = self._match(step)
            self.weights = self.weights.times(self._checked(self.likelihood(scores), scores))
            self.best_particle = self.weights.best
            score = int(scores[self.best_particle])
            self._misfit.observe(driven, score / len(step.points) if len(step.points) else None)
        self._best = self.poses[self.best_particle].copy()
        self._covariance.update(self.poses, self.weights.values, self._best)
        self._misfit.update(self._best)
        n_eff = self.weights.effective_number
        resampled = self._resample(step.index, n_eff)
        self._map(self._best, step.points, step.origin)
        return StepResult(self._best, step.motion, n_eff, score, True, resampled, self._certainty())

    def likelihood(self, scores: NDArray[np.int32]) -> NDArray[Any]:
        """What the weights [N] are multiplied by: the scores [N] themselves (II.7). Write another in a subclass.

        Returns:
            [N] finite likelihoods (no logarithms), none below 0; above 0 for one particle at least where a score is.
        """
        exponent = self._config.score_exponent
        return scores if exponent == 1 else np.power(scores / max(scores.max(), 1), exponent)

    def _checked(self, likelihood: Any, scores: NDArray[np.int32]) -> Array:
        """What ``likelihood`` returned, which may be that of a subclass."""
        try:
            found = np.asarray(likelihood, np.float64)
            fine = found.shape == scores.shape and bool((np.isfinite(found) & (found >= 0)).all())
        except (TypeError, ValueError):
            fine = False
        if not fine or (scores.any() and not found.any()):
            expected = f"[{len(scores)}] finite numbers >= 0, not all 0: likelihoods, not their logarithms"
            field = f"{type(self).__name__}.likelihood"
            raise InputError(f"{shortened(likelihood)}, expected {expected}", field=field)
        return found

    def occupancy(self) -> Raster:
        """The shared map."""
        return self.grid.snapshot()

    def revise(self, poses: Array, updates: NDArray[np.intp], scans: Scans) -> None:
        """Go on from a path that the back end has corrected: the shared map is drawn anew along it.

        Args:
            poses: [u, 3] of the robot at every update so far, corrected.
            updates: [u] the indices of their scans.
        """
        self.history.revise(self.history.path(self.best_particle), poses)
        self._misfit.revise(poses)
        last, self._best = self._best, poses[-1].copy()
        self.poses = se2.compose(self._best, se2.between(last, self.poses))
        self.grid = OccupancyGrid(self._config.map)
        for pose, update in zip(poses, updates, strict=True):
            self._map(pose, scans.points(int(update)), scans.origin)

    def _predict(self, step: Step) -> None:
        """III.3: every particle moves by the control, with noise."""
        predict(self.poses, self._motion, self._travelled, self._config.motion, seed=self._seed, step=step.index)
        self._motion, self._travelled = np.zeros(3), Travelled()

    def _match(self, step: Step) -> NDArray[np.int32]:
        """Section III.D.2: every particle moves to the best of its neighbourhood, of this score [N]."""
        found = match_poses(
            self.grid.occupied,
            self.grid.origin,
            self.grid.cell_size,
            self.poses,
            step.points,
            offsets_xy=self._offsets_xy,
            offsets_theta=self._offsets_theta,
        )
        self.poses = found.poses
        return found.scores

    def _resample(self, step: int, n_eff: float) -> bool:
        """Section III.D.3: where few particles carry the weight, draw them anew in proportion to it."""
        self.history.append(self.poses, self.weights.values)
        if n_eff >= self._config.resample_below * len(self.poses):
            return False
        c = self._config
        weights = self.weights.values
        parents = choose_parents(c.resampling, c.kld, c.particles, self.poses, weights, seed=self._seed, step=step)
        self.history.resampled(parents)
        self.poses = self.poses[parents]
        self.weights = Weights.uniform(len(parents))
        return True

    def _certainty(self) -> Certainty:
        """How sure the pose is."""
        return certainty_of(self._covariance.value, math.nan, self._misfit.probability)

    def _map(self, pose: Array, points: NDArray[np.float32], origin: Array) -> None:
        """III.2: the best particle's scan goes into the map."""
        self.grid.add_scan(se2.transform_points(pose, origin), se2.transform_points(pose, points))
