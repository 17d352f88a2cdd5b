"""A Rao-Blackwellised particle filter with a TSDF for every particle, and the improved proposal."""

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.scans import ThinnedScan
from moteslam.robot import se2
from moteslam.robot.se2 import Array, Pose, as_pose, compose_one
from moteslam.slam.filter.certainty import Certainty, LocalisationState, certainty_of
from moteslam.slam.filter.history import History
from moteslam.slam.filter.protocol import FilterDefaults, StepResult
from moteslam.slam.filter.resampling import Draws, choose_parents, generator_for
from moteslam.slam.filter.update_policy import update_due
from moteslam.slam.filter.weights import Weights
from moteslam.slam.inputs.config import ThinningConfig
from moteslam.slam.inputs.scans import Scans
from moteslam.slam.inputs.step import Step, thin, thin_some
from moteslam.slam.tsdf.config import TsdfFilterConfig
from moteslam.slam.tsdf.doubt import Doubt
from moteslam.slam.tsdf.floor import FloorLikelihood
from moteslam.slam.tsdf.motion import STILL, MotionSinceUpdate
from moteslam.slam.tsdf.particles import Particles, Thinned
from moteslam.slam.tsdf.pose_covariance import PoseCovariance
from moteslam.slam.tsdf.proposal import Proposal, propose, sample
from moteslam.slam.tsdf.relocation import Relocation
from moteslam.slam.tsdf.tracking import Tracked, Tracker

WRONG_WHILE_LOST = 0.95  # Probability of a wrong pose from when the robot is lost until it is found


class TsdfFilter(FilterDefaults):
    """Track every scan; where an update is due register, weigh, resample, sample and map."""

    def __init__(self, config: TsdfFilterConfig, seed: int) -> None:
        self._config, self._seed = config, seed
        self._particles = Particles(config.particles, config.tsdf)
        self._tracker = Tracker(config.tracking, config.registration, config.calibration)
        self._floor = FloorLikelihood(config)
        self._covariance, self._doubt = PoseCovariance(config.registration), Doubt()
        self._relocation: Relocation | None = None  # of a robot that is lost, in the map that it had
        self._relocated: Array | None = None
        self._since = MotionSinceUpdate()
        self._mode_mean = STILL  # of the best particle's mode at the last update, in that particle's frame
        self._unseen = False  # no scan had enough points to begin a map

    @property
    def poses(self) -> Array:
        return self._particles.poses

    @property
    def weights(self) -> Weights:
        return self._particles.weights

    @property
    def history(self) -> History:
        return self._particles.history

    @property
    def best_particle(self) -> int:
        return self._particles.best

    @property
    def settled(self) -> bool:
        return self._particles.settled

    @property
    def uses_camera(self) -> bool:
        return self._config.colours.enabled

    @property
    def thinning(self) -> ThinningConfig:
        return self._config.thinning

    def step(self, step: Step) -> StepResult:
        scan = step.scan or thin(step.points, step.origin, self._config.thinning)
        if not len(self.history):
            return self._start(scan)
        if self._unseen:
            return self._wait(step, scan)
        tracked = self._track(step, scan)
        if self._doubt.state is LocalisationState.LOST or tracked.astray:
            return self._begin_anew(scan, tracked)
        doubted = tracked.lost or self._doubt.state is LocalisationState.DOUBTFUL
        due = update_due(self._config.update, self._since.travelled, self._since.tracked)
        if doubted or not (due or len(tracked.rivals.offsets)):
            return self._unweighed_result(tracked.motion, updated=False)
        rivals = tracked.rivals
        places = self._particles.divide(rivals.offsets, rivals.log_odds(self._config.proposal.evidence_share))
        proposal = self._register(step, scan, places)
        proposal = self._weigh(step, proposal)
        n_eff, score = self.weights.effective_number, float(proposal.likelihoods[self.best_particle])
        proposal, resampled = self._resample(step, proposal)
        self._sample(step, proposal)
        self._map(scan, proposal)
        self._relocate(scan)
        return StepResult(self._pose(), np.array(tracked.motion), n_eff, score, True, resampled, self._certainty())

    @property
    def lost(self) -> bool:
        """Whether the scans stopped to fit, and the robot has not been found in its map since."""
        return self._relocation is not None or self._relocated is not None

    def relocated(self) -> Array | None:
        relocated, self._relocated = self._relocated, None
        return relocated

    def revise(self, poses: Array, updates: NDArray[np.intp], scans: Scans) -> None:
        """See ``Filter``: with one map, drawn along the path, that all particles share.

        While the robot is lost that is a map of what it has seen since, and the one that it had is drawn anew, too.
        """
        before = 0
        if self._relocation is not None:
            before = self._relocation.updates
            self._relocation.revise(self._particles.drawn(poses[:before], self._thinned(scans, updates[:before])))
        self._particles.revise(poses, self._particles.drawn(poses[before:], self._thinned(scans, updates[before:])))
        self._tracker.pose = as_pose(self._particles.best_pose)
        self._floor = FloorLikelihood(self._config)

    def _thinned(self, scans: Scans, updates: NDArray[np.intp]) -> Thinned:
        """Some scans of updates [u], by their indices among these."""
        return lambda some: thin_some(scans, updates[some].tolist(), self._config.thinning)

    def _start(self, scan: ThinnedScan) -> StepResult:
        """The first scan: there is nothing to register to; it goes into the one map that all particles share."""
        self._particles.start(scan)
        self._unseen = len(scan.points) < self._config.tracking.min_points
        return self._unweighed_result(STILL, updated=True)

    def _wait(self, step: Step, scan: ThinnedScan) -> StepResult:
        """There is no map yet: the odometry moves the robot, and the first scan with enough points begins one."""
        motion = self._tracker.predict(as_pose(step.motion), step.dt, measured=step.measured, left=step.open)
        self._tracker.pose = compose_one(self._tracker.pose, motion.corrected)
        self._covariance.step(motion, motion.corrected, None)
        self._unseen = len(scan.points) < self._config.tracking.min_points
        if not self._unseen:
            self._particles.begin_anew(np.array(self._tracker.pose), scan)
            self._covariance = PoseCovariance(self._config.registration)
        return self._unweighed_result(motion.corrected, updated=not self._unseen)

    def _unweighed_result(self, motion: Pose, *, updated: bool) -> StepResult:
        n_eff = self.weights.effective_number
        return StepResult(self._pose(), np.array(motion), n_eff, 0.0, updated, False, self._certainty())

    def _begin_anew(self, scan: ThinnedScan, tracked: Tracked) -> StepResult:
        """The robot is lost: from here on it draws another map, and the one that it had is where it is looked for."""
        particles = self._particles
        if self._relocation is None:
            known = particles.maps, self.best_particle, self.history.path(self.best_particle), self._config.registration
            begin, reach = np.array(self._tracker.pose), tracked.astray or np.inf
            self._relocation = Relocation(*known, begin=begin, reach=reach, carried=self._doubt.carried)
        else:  # lost once more
            self._relocation.reach = np.inf
        particles.begin_anew(np.array(self._tracker.pose), scan)
        self._covariance, self._doubt = PoseCovariance(self._config.registration), Doubt()
        self._since, self._mode_mean = MotionSinceUpdate(), STILL
        return self._unweighed_result(tracked.motion, updated=True)

    def _relocate(self, scan: ThinnedScan) -> None:
        """Look for a robot that is lost in the map that it had."""
        if self._relocation is None:
            return
        if (frame := self._relocation.search(self._particles.best_pose, scan.points)) is not None:
            path, before = self.history.path(self.best_particle), self._relocation.updates
            self._relocated = np.vstack((path[:before], se2.compose(frame, path[before:])))
            self._relocation = None

    def _track(self, step: Step, scan: ThinnedScan) -> Tracked:
        """Predict the motion since the last scan, and register the scan to the best particle's map."""
        motion = self._tracker.predict(as_pose(step.motion), step.dt, measured=step.measured, left=step.open)
        x, y = step.origin.tolist()
        tracked = self._tracker.track(motion, scan, (x, y), self._particles)
        self._since = self._since.plus(motion, tracked.motion, slipped=tracked.slipped)
        fit = tracked.fit
        self._covariance.step(motion, tracked.motion, None if tracked.lost else fit)
        seen = None if fit is None else fit.scan
        self._doubt.observe(motion.distance, seen, turned=motion.rotation, carried=tracked.carried)
        return tracked

    def _register(self, step: Step, scan: ThinnedScan, places: Array) -> Proposal:
        """Register the scan to every particle's map, from these places [N, 3]."""
        c, seen = self._config, (self._particles, self._since, scan, step.origin)
        return propose(*seen, c.proposal, c.registration, c.tracking, measured=step.measured, places=places)

    def _weigh(self, step: Step, proposal: Proposal) -> Proposal:
        """Weigh the particles by lidar and odometry, and by the floor's colours; calibrate the odometry."""
        self._floor.read_frame(step.floor)
        if not proposal.registered:
            return proposal
        particles = self._particles
        particles.weights = particles.weights.times_log(proposal.log_likelihood)
        if (refined := self._floor.refine(proposal, self._since, particles.best)) is not None:
            proposal = refined
            particles.weights = particles.weights.times_log(proposal.log_likelihood)
        particles.best = particles.weights.best
        self._tracker.calibrate(
            self._since, as_pose(proposal.offsets[particles.best]), proposal.information[particles.best]
        )
        return proposal

    def _resample(self, step: Step, proposal: Proposal) -> tuple[Proposal, bool]:
        """Draw the particles anew where few carry the weight; the proposals of those that survive."""
        few = self.weights.effective_number < self._config.resample_below * len(self._particles)
        if not proposal.registered or not few:
            return proposal, False
        c, weights = self._config, self.weights.values
        parents = choose_parents(
            c.resampling, c.kld, c.particles, proposal.means, weights, seed=self._seed, step=step.index
        )
        self._particles.resample(parents)
        self._floor.resample(parents)
        return proposal.of(parents), True

    def _sample(self, step: Step, proposal: Proposal) -> None:
        """Draw every particle's pose from its proposal."""
        if (n := len(self._particles)) == 1:
            self._particles.move_to(proposal.means)  # the best one, which is not drawn
            return
        normals = generator_for(self._seed, step.index, Draws.PROPOSAL).standard_normal((n, 3))
        self._particles.move_to(sample(proposal, normals, self._config.proposal, best=self.best_particle))

    def _map(self, scan: ThinnedScan, proposal: Proposal) -> None:
        """Write the scan, and the floor, into the maps; count motion from here on."""
        particles, c = self._particles, self._config.proposal
        particles.join()
        if proposal.registered:
            particles.maps.integrate(particles.poses, scan)
            self._covariance.mapped()
        self._floor.integrate(particles, self._since)
        self._tracker.pose = as_pose(particles.best_pose)
        self._since = MotionSinceUpdate()
        self._mode_mean = as_pose(particles.mode_mean(c.mode_distance, c.mode_rotation))

    def _certainty(self) -> Certainty:
        wrong = max(self._doubt.probability, WRONG_WHILE_LOST if self.lost else 0.0)
        return certainty_of(self._covariance.value, self._covariance.degenerate, wrong)

    def _pose(self) -> Array:
        """The online pose [3]: the mean of the best particle's mode, moved by what was tracked since."""
        return np.array(compose_one(self._tracker.pose, self._mode_mean))
