"""The paper's particle filter: one map shared by all particles, each moved to the best of its neighbourhood."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.matching import match_poses
from moteslam.kernels.motion import sample_motion
from moteslam.robot import se2
from moteslam.slam.config import SlamConfig
from moteslam.slam.gate import UpdateGate
from moteslam.slam.grid import OccupancyGrid
from moteslam.slam.history import History
from moteslam.slam.motion_model import motion_spread
from moteslam.slam.outcome import Outcome
from moteslam.slam.particle_number import choose_parents
from moteslam.slam.step import Step
from moteslam.slam.weights import Weights


class PaperFilter:
    """Section III.D of the paper: predict, match, weight, resample, map.

    Attributes:
        poses: [N, 3] of the particles at the last update.
        weights: theirs.
        grid: the one shared map.
        history: the particles' poses at every update.
        best_particle: index into the last update's particles, before they were resampled.
        needs_odometry: prediction is all that moves its particles farther than its search.
    """

    needs_odometry: ClassVar[bool] = True

    def __init__(self, config: SlamConfig, seed: int) -> None:
        self._config, self._seed = config, seed
        self._offsets_xy = np.array(config.search.offsets_xy)
        self._offsets_theta = np.array(config.search.offsets_theta)
        self.poses = np.zeros((config.particles, 3))
        self.weights = Weights.uniform(config.particles)
        self.grid = OccupancyGrid(config.map)
        self.history = History()
        self.best_particle = 0
        self._best = self.poses[0].copy()
        self._motion = np.zeros(3)  # since the last update
        self._gate = UpdateGate(config.update)

    def step(self, step: Step) -> Outcome:
        """Take in one scan and the motion since the scan before."""
        self._motion = se2.compose(self._motion, step.motion)
        self._gate.add(step)
        if len(self.history) and not self._gate.due():
            pose = se2.compose(self._best, self._motion)
            return Outcome(pose, step.motion, self.weights.effective_number, 0, False, False)
        score = 0
        if len(self.history):
            self._predict(step)
            scores = self._match(step)
            self.weights = self.weights.times(scores)
            self.best_particle = self.weights.best
            score = int(scores[self.best_particle])
        self._best = self.poses[self.best_particle].copy()
        n_eff = self.weights.effective_number
        parents = self._resample(step.index, n_eff)
        self._map(step)
        return Outcome(self._best, step.motion, n_eff, score, True, parents is not None)

    def _predict(self, step: Step) -> None:
        """III.3: every particle moves as the control says, with noise."""
        spread = motion_spread(self._config.motion, self._gate.travelled, self._gate.turned, self._gate.elapsed)
        sample_motion(self.poses, self._motion, spread, seed=self._seed, step=step.index)
        self._motion = np.zeros(3)
        self._gate.reset()

    def _match(self, step: Step) -> NDArray[np.int32]:
        """Section III.D.2: every particle moves to the best of its neighbourhood; its score is returned, [N]."""
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

    def _resample(self, step: int, n_eff: float) -> NDArray[np.int64] | None:
        """Section III.D.3: when few particles carry the weight, draw them anew in proportion to it."""
        parents = None
        poses = self.poses
        if n_eff < self._config.resample_below * len(poses):
            parents = choose_parents(self._config, poses, self.weights.values, seed=self._seed, step=step)
            self.poses = poses[parents]
            self.weights = Weights.uniform(len(parents))
        self.history.append(poses, parents)
        return parents

    def _map(self, step: Step) -> None:
        """III.2: the best particle's scan goes into the map."""
        self.grid.add_scan(se2.transform_points(self._best, step.origin), se2.transform_points(self._best, step.points))
