"""A Rao-Blackwellised particle filter with a signed-distance map for every particle.

The proposal is the improved one of Grisetti, Stachniss and Burgard (2007), with Gauss-Newton on a signed distance in
place of a hill climb: every particle registers the scan to its own map, is drawn around what it found with the
covariance found there, and weighed by how well its map explains the scan.

Between updates, and as their starting point, the scan is registered to the best particle's map alone: what that says
of the motion since the last update holds for all particles, whose maps differ by bends that are long against it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.thinning import ThinnedScan, thin_scan
from moteslam.robot import se2
from moteslam.slam.config import SlamConfig
from moteslam.slam.constant_velocity import carried_on
from moteslam.slam.floor_tracker import FloorFit, FloorTracker
from moteslam.slam.gate import UpdateGate, extent
from moteslam.slam.history import History
from moteslam.slam.motion_model import odometry_spread
from moteslam.slam.odometry_calibration import OdometryCalibration
from moteslam.slam.outcome import Outcome
from moteslam.slam.particle_number import choose_parents
from moteslam.slam.registration import Registrar, evenly
from moteslam.slam.resampling import Draws, generator_for
from moteslam.slam.step import Step
from moteslam.slam.surface_maps import SurfaceMaps
from moteslam.slam.weights import Weights

Array = NDArray[np.float64]
SAME_PLACE, SAME_HEADING = 0.5, 0.2
"""Particles within so much of the best one believe the same as it [m], [rad]; others count for another place."""
FEW = 5
"""Vertices; a scan with fewer says nothing, and the odometry is all that is known."""


class SurfaceFilter:
    """Predict, register, weigh, resample, draw, map.

    Attributes:
        poses: [N, 3] of the particles at the last update.
        weights: theirs.
        history: the particles' poses at every update.
        best_particle: index into them.
        needs_odometry: it follows the scans at a constant velocity without.
    """

    needs_odometry: ClassVar[bool] = False

    def __init__(self, config: SlamConfig, seed: int) -> None:
        self._config, self._seed = config, seed
        self.poses = np.zeros((config.particles, 3))
        self.weights = Weights.uniform(config.particles)
        self.history = History()
        self.best_particle = 0
        self._maps = SurfaceMaps(config.surface)
        self._calibration = OdometryCalibration(config.calibration)
        self._registrar = Registrar(config.registration, config.proposal)
        self._pose = np.zeros(3)  # at the last scan, by the best particle's map
        self._motion = np.zeros(3)  # since the last update, as tracked
        self._odometry = np.zeros(3)  # the same, as the odometry tells it, corrected
        self._wheels = np.zeros(3)  # the same, not corrected
        self._teaches = True  # whether it does: no part of it is a guess or a slip
        self._step, self._seconds = np.zeros(3), 0.0  # the motion of the last step, as tracked, and how long it took
        self._gate = UpdateGate(config.update)
        self._floor = FloorTracker(config.colours, config.texture)
        self._since_frame = 0.0  # way since the last frame of the floor
        self._slip = np.zeros(3)  # how far the odometry was just off, if it was
        self._mean = np.zeros(3)  # of the particles at the last update, in the best one's frame
        self._lost = 0  # scans in a row that contradict the map

    def step(self, step: Step) -> Outcome:
        """Take in one scan and the motion since the scan before."""
        scan = self._thin(step)
        before = self._pose
        if not len(self.history):
            return self._begin(scan)
        told = carried_on(self._step, self._seconds, step.dt) if step.guess else step.motion
        self._wheels = se2.compose(self._wheels, told)
        self._teaches = self._teaches and not step.guess
        step = replace(step, motion=told if step.guess else self._calibration.corrected(told))
        self._gate.add(step)
        self._track(step, scan)
        motion = se2.between(before, self._pose)
        if self._lost or not self._gate.due(self._motion):
            return Outcome(self._told(), motion, self.weights.effective_number, 0.0, False, False)
        n_eff, fit, resampled = self._update(step, scan)
        self._mean = self._around_best()
        return Outcome(self._told(), motion, n_eff, fit, True, resampled)

    def _told(self) -> Array:
        """Where the robot is held to be [3]: the mean of the particles, moved by what was tracked since."""
        return se2.compose(self._pose, self._mean)

    def _around_best(self) -> Array:
        """The weighted mean of the particles that share the best one's belief, in its frame [3]."""
        off = se2.between(self.poses[self.best_particle], self.poses)
        near = (np.hypot(off[:, 0], off[:, 1]) <= SAME_PLACE) & (abs(off[:, 2]) <= SAME_HEADING)
        weights = self.weights.values * near
        return np.asarray(weights @ off / weights.sum())

    def _begin(self, scan: ThinnedScan) -> Outcome:
        """The first scan: nothing to register to yet; all particles share one map."""
        self.history.append(self.poses, None)
        self._maps.add(self._pose[None], scan)
        self._maps.resample(np.zeros(len(self.poses), np.int64))
        return Outcome(self._pose, np.zeros(3), self.weights.effective_number, 0.0, True, False)

    def _thin(self, step: Step) -> ThinnedScan:
        s = self._config.surface
        return thin_scan(
            step.points,
            step.origin,
            spacing=s.spacing,
            max_spacing=s.widest_spacing,
            max_points=s.vertices,
            gap=s.gap,
            gap_from_range=s.gap_from_range,
        )

    def _track(self, step: Step, scan: ThinnedScan) -> None:
        """Follow the motion since the last scan in the best particle's map."""
        predicted = se2.compose(self._pose, step.motion)
        offset = np.zeros(3)
        usual = self._registrar.spread(*extent(step.motion), guess=step.guess)
        spread = usual + self._slip
        if len(scan.points) >= FEW:
            carried = carried_on(self._step, self._seconds, step.dt)
            guesses = np.stack((np.zeros(3), se2.between(step.motion, carried)))
            found = self._registrar.follow(
                self._maps.of(self.best_particle), predicted, spread, scan.points, step.origin, guesses
            )
            lost = self._registrar.lost(found, len(scan.points))
            if not lost or self._lost >= self._config.registration.patience:
                offset, self._lost = found.offsets[0], 0
            else:
                self._lost += 1
        # odometry that was far off, of a slip or a wrong stamp, is likely to be as far off again, or back
        shift, turn = extent(offset)
        off = np.array([shift, shift, turn])
        self._slip = np.where(off > 2 * usual, off, 0.0)
        if self._slip.any():
            self._teaches = False
        moved = se2.compose(predicted, offset)
        tracked = se2.between(self._pose, moved)
        self._motion = se2.compose(self._motion, tracked)
        self._odometry = se2.compose(self._odometry, tracked if step.guess or self._slip.any() else step.motion)
        self._step, self._seconds = tracked, step.dt
        self._pose = moved

    def _update(self, step: Step, scan: ThinnedScan) -> tuple[float, float, bool]:
        predicted = se2.compose(self.poses, self._odometry)
        spread = odometry_spread(self._config.proposal, self._gate.travelled, self._gate.turned)
        drift = self._registrar.spread(self._gate.travelled, self._gate.turned, guess=step.guess)
        fit, resampled, offsets = 0.0, False, np.zeros_like(predicted)
        information = np.zeros((len(predicted), 3, 3))
        n_eff = self.weights.effective_number
        view = step.look() if step.look is not None else None
        floor: FloorFit | None = None
        if len(scan.points) >= FEW:
            found = self._registrar.register(
                self._maps.all(),
                predicted,
                drift,
                evenly(scan.points, self._config.registration.points),
                step.origin,
                self._starts(step.index, drift),
            )
            found = self._registrar.trusted(found, drift)
            offsets, information = found.offsets, found.information
            self.weights = self.weights.times_log(
                -self._config.proposal.evidence_share * (found.costs + self._config.proposal.crossing * found.crossed)
                - 0.5 * np.square(found.offsets / drift).sum(axis=1)
            )
            if view is not None:
                moved = se2.compose(self._odometry, offsets[self.best_particle])
                view = view.corrected(self._wheels, moved, self._gate.elapsed)
                floor = self._floor.fit(view, se2.compose(predicted, offsets), self.best_particle)
            if floor is not None:
                offsets, information = self._weigh_floor(floor, offsets, information, spread)
            best = self.weights.best
            if self._teaches:
                moved = se2.compose(self._odometry, offsets[best])
                self._calibration.learn(self._wheels, moved, information[best])
            fit = float(found.likelihoods[best])
            n_eff = self.weights.effective_number
            weights = self.weights.values
            parents = self._resample(step.index, n_eff, se2.compose(predicted, offsets))
            if parents is not None:
                best = int(weights[parents].argmax())  # the best itself, unless the draw left it out
                predicted, offsets, information = predicted[parents], offsets[parents], information[parents]
                resampled = True
            self.best_particle = best
        share = 1.0 if floor is not None else self._config.proposal.drawn  # colours tell where the lidar does not
        noise = self._draw(step.index, information, spread * np.array([share, share, 1.0]))
        self.poses = se2.compose(predicted, offsets + noise)
        self.history.append(self.poses, None)
        if len(scan.points) >= FEW:
            self._maps.add(self.poses, scan)
        self._since_frame += self._gate.travelled
        if view is not None:
            self._floor.add(view, self.poses, self.best_particle, self._since_frame)
            self._since_frame = 0.0
        self._pose = self.poses[self.best_particle].copy()
        self._motion, self._odometry, self._wheels = np.zeros(3), np.zeros(3), np.zeros(3)
        self._teaches = True
        self._gate.reset()
        return n_eff, fit, resampled

    def _weigh_floor(self, floor: FloorFit, offsets: Array, information: Array, spread: Array) -> tuple[Array, Array]:
        """Weigh the particles by the colours of the floor; offsets [N, 3] and information [N, 3, 3] with them.

        Lidar and odometry put a particle at a Gaussian, of information A, and the floor at another one, B, off by d:
        the product's top lies (A + B)^-1 B d away, and its integral, which is the particle's likelihood, falls with
        d^T (B - B (A + B)^-1 B) d / 2. The particle is drawn from the product.
        """
        lidar = self._precision(information, spread)
        gain = np.linalg.solve(lidar + floor.information, np.broadcast_to(floor.information, lidar.shape))
        inside = floor.information - floor.information @ gain
        off = floor.offsets
        self.weights = self.weights.times_log(-0.5 * np.einsum("ni,nij,nj->n", off, inside, off))
        offsets = se2.compose(offsets, np.einsum("nij,nj->ni", gain, off))
        return offsets, information + floor.information / self._config.proposal.information_share

    def _precision(self, information: Array, spread: Array) -> Array:
        """Inverse covariance [N, 3, 3] of endpoints and odometry together."""
        return self._config.proposal.information_share * information + np.diag(1 / np.maximum(spread, 1e-9) ** 2)

    def _starts(self, step: int, drift: Array) -> Array:
        """Where the particles' registrations start, as offsets from the odometry [N, 3].

        At what was tracked in the best particle's map, and for every other particle where the odometry may have gone:
        where a scan fits at several places, several are found.
        """
        starts = np.repeat(se2.between(self._odometry, self._motion)[None], len(self.poses), axis=0)
        if self._config.proposal.explore:
            draws = generator_for(self._seed, step, Draws.STARTS).standard_normal((len(starts), 3))
            others = np.arange(len(starts)) % 2 == 1
            others[self.best_particle] = False
            starts[others] = (draws * drift)[others]
        return starts

    def _draw(self, step: int, information: Array, spread: Array) -> Array:
        """An offset for every particle, drawn with the covariance of what is known of it; none for the best one."""
        normals = generator_for(self._seed, step, Draws.PROPOSAL).standard_normal((len(information), 3))
        total = self._precision(information, spread)
        # total = L L^T, so L^-T times standard normals has the covariance total^-1
        factors = np.linalg.cholesky(total)
        noise = np.linalg.solve(np.swapaxes(factors, 1, 2), normals[..., None])[..., 0]
        noise[self.best_particle] = 0.0
        return np.asarray(noise)

    def _resample(self, step: int, n_eff: float, poses: Array) -> NDArray[np.int64] | None:
        """When few particles carry the weight: the [M] that live on, by their poses [N, 3] as registered."""
        if n_eff >= self._config.resample_below * len(self.poses):
            return None
        parents = choose_parents(self._config, poses, self.weights.values, seed=self._seed, step=step)
        self.weights = Weights.uniform(len(parents))
        self.history.resampled(parents)
        self._maps.resample(parents)
        self._floor.resample(parents)
        return parents
