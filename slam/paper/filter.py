"""The paper's particle filter: one map shared by all particles, each moved to the best of its neighbourhood."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.kernels.matching import match_poses
from moteslam.kernels.motion import sample_motion
from moteslam.robot import se2
from moteslam.robot.raster import Raster
from moteslam.robot.se2 import Array
from moteslam.robot.values import shortened
from moteslam.slam.filter.certainty import FLOOR, NEIGHBOURHOOD, Certainty, Misfit, certainty_of
from moteslam.slam.filter.covariance import Symmetric, moved, plus_diagonal, symmetric
from moteslam.slam.filter.history import History
from moteslam.slam.filter.protocol import FilterDefaults, Scans, Step, StepResult
from moteslam.slam.filter.resampling import choose_parents
from moteslam.slam.filter.update_policy import Travelled, magnitude, update_due
from moteslam.slam.filter.weights import Weights
from moteslam.slam.mapping.occupancy import OccupancyGrid, draw_map
from moteslam.slam.paper.config import MatchConfig, MotionNoise, PaperFilterConfig

UNKNOWN_SPEED = 0.5  # Of a robot of which no motion was measured yet: that of a slow walk [m/s]


class PaperFilter(FilterDefaults):
    """Section III.D of the paper: predict, match, weight, resample, map."""

    def __init__(self, config: PaperFilterConfig, seed: int) -> None:
        self._config, self._seed = config, seed
        self._around = {name: np.array(offsets) for name, offsets in config.search.model_dump().items()}
        self.poses = np.zeros((config.particles, 3))  # [N, 3] of the particles at the last update
        self.weights = Weights.uniform(config.particles)  # of the particles
        self.grid = OccupancyGrid(config.map)  # the one shared map
        self.history = History()  # the particles' poses at every update
        self.best_particle = 0  # index into the last update's particles, before they were resampled
        self._n_eff = self.weights.effective_number  # at the last update, before resampling
        self._best = self.poses[0].copy()
        self._motion, self._travelled = np.zeros(3), Travelled()  # since the last update
        self._covariance, self._misfit = ParticleCovariance(config.motion, config.search), Misfit()

    def step(self, step: Step) -> StepResult:
        self._motion = se2.compose(self._motion, step.motion)
        motion = se2.as_pose(step.motion)
        self._travelled = self._travelled.plus(*magnitude(motion), step.dt)
        self._covariance.move(motion, step.dt, measured=step.measured)
        if len(self.history) and not update_due(self._config.update, self._travelled):
            pose = se2.compose(self._best, self._motion)
            return StepResult(pose, step.motion, self._n_eff, 0, False, False, self._certainty())
        score, driven = 0, self._travelled.distance
        if len(self.history):
            # III.3: every particle moves by the control, with noise
            spread = prediction_noise(self._config.motion, *self._travelled)
            sample_motion(self.poses, self._motion, spread, seed=self._seed, step=step.index)
            self._motion, self._travelled = np.zeros(3), Travelled()
            # section III.D.2: every particle moves to the best of its neighbourhood, of this score
            grid = self.grid
            found = match_poses(grid.occupied, grid.origin, grid.cell_size, self.poses, step.points, **self._around)
            self.poses, scores = found.poses, found.scores
            self.weights = self.weights.times(self._checked(self.likelihood(scores.astype(np.float64)), scores))
            self.best_particle = self.weights.best
            score = int(scores[self.best_particle])
            self._misfit.observe(driven, score / len(step.points) if len(step.points) else None)
        self._best = self.poses[self.best_particle].copy()
        self._covariance.update(self.poses, self.weights.values, self._best)
        self._misfit.update(self._best)
        self._n_eff = n_eff = self.weights.effective_number
        resampled = self._resample(step.index, n_eff)
        self.grid.add_scan(self._best, step.points, step.origin)  # III.2
        return StepResult(self._best, step.motion, n_eff, score, True, resampled, self._certainty())

    def likelihood(self, scores: Array) -> Array:
        """What the weights [N] are multiplied by: the scores [N] themselves (II.7). Write another in a subclass.

        Returns [N] finite likelihoods (no logarithms), none below 0; above 0 for one particle at least where a score
        is.
        """
        exponent = self._config.score_exponent
        return scores if exponent == 1 else np.asarray(np.power(scores / max(scores.max(), 1), exponent))

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
        return self.grid.snapshot()

    def revise(self, poses: Array, updates: NDArray[np.intp], scans: Scans) -> None:
        """See ``Filter``: the shared map is drawn anew along the path."""
        self.history.revise(self.history.path(self.best_particle), poses)
        self._misfit.revise(poses)
        last, self._best = self._best, poses[-1].copy()
        self.poses = se2.compose(self._best, se2.between(last, self.poses))
        self.grid = draw_map(self._config.map, scans, updates.tolist(), poses)

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
        return certainty_of(self._covariance.value, math.nan, self._misfit.probability)


def prediction_noise(noise: MotionNoise, distance: float, rotation: float, elapsed: float) -> NDArray[np.float64]:
    """The standard deviations of one prediction: forward [m], left [m], turn [rad].

    One epsilon is drawn for the interval between two updates of the filter, over which the robot has travelled, turned
    (the sum of absolute turns) and waited so much [m, rad, s], so the noise does not depend on how often the sensors
    report in between. The shares of the motion itself are those of Probabilistic Robotics, table 5.6; to the left,
    where the robot does not drive on purpose, it slips with the turn alone.
    """
    slip = noise.translation_from_rotation * rotation
    forward = np.hypot(noise.velocity * elapsed, noise.translation_from_translation * distance)
    heading = np.hypot(noise.yaw_rate * elapsed, noise.rotation_from_translation * distance)
    return np.array([np.hypot(forward, slip), slip, np.hypot(heading, noise.rotation_from_rotation * rotation)])


class ParticleCovariance:
    """Follows the covariance from scan to scan: by the odometry's ``motion`` noise it grows with distance and turn.

    Of the offsets of the ``search``: no pose is known better than the steps between them, nor than scans resolve it.
    """

    def __init__(self, motion: MotionNoise, search: MatchConfig) -> None:
        self._a_metre, self._a_radian, self._a_second = (
            np.square(prediction_noise(motion, *amount)) for amount in np.eye(3).tolist()
        )
        self._step, self._turn = (
            max(float(np.max(np.diff(offsets), initial=0.0)) ** 2 / 12, least)
            for offsets, least in zip((search.offsets_xy, search.offsets_theta), FLOOR, strict=True)
        )
        self._adrift, self._since, self._speed = 0.0, 0.0, UNKNOWN_SPEED  # [m]; driven since [m]; before [m/s]
        self._spread: Symmetric = (self._step, 0.0, 0.0, self._step, 0.0, self._turn)

    def move(self, motion: se2.Pose, dt: float, *, measured: bool) -> None:
        """Take in a motion that took ``dt`` [s].

        Of one that nothing measured the filter knows nothing: the robot may have driven on as fast as before, and any
        jump of the odometry is made up. That is open until the map around the robot was made after it.
        """
        distance, turn = magnitude(motion)
        x, y, theta = (distance * self._a_metre + turn * self._a_radian + dt * self._a_second).tolist()
        self._spread = plus_diagonal(moved(self._spread, motion), x, y, theta)
        if not measured:
            self._adrift, self._since = self._adrift + max(distance, self._speed * dt), 0.0
            return
        self._speed = distance / dt if dt > 0 else self._speed
        self._since += distance
        self._adrift = self._adrift if self._since < NEIGHBOURHOOD else 0.0

    @property
    def value(self) -> Symmetric:
        """At the last scan."""
        return plus_diagonal(self._spread, self._adrift**2, self._adrift**2, 0.0)

    def update(self, poses: Array, weights: Array, pose: Array) -> None:
        """Take in an update: the particles [N, 3], their weights [N], and the pose [3] that was chosen."""
        off = se2.between(pose, poses)
        spread = symmetric((off * weights[:, None]).T @ off)
        self._spread = plus_diagonal(spread, self._step, self._step, self._turn)
