"""The improved proposal: every particle registers the scan to its own map and is sampled around where it fits.

As Grisetti, Stachniss and Burgard (2007, Improved techniques for grid mapping with Rao-Blackwellized particle filters),
with Gauss-Newton on a TSDF in place of a hill climb. Of a particle, with the symbols of docs/theory/default-filter.md:

    P = s I + diag(1 / sigma_o^2)                       precision: of the endpoints (I) and the odometry
    x = x_o + delta + L^-T z,  P = L L^T                pose: predicted by the odometry, registered, sampled
    log w += -lambda (c + kappa n) - |delta / sigma|^2 / 2      weight: costs c and crossed rays n of the endpoints
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.scans import ThinnedScan
from moteslam.robot import se2
from moteslam.robot.se2 import Array
from moteslam.slam.mapping.config import RESOLVED
from moteslam.slam.registration.config import RegistrationConfig, TrackingConfig
from moteslam.slam.registration.localisation import proved
from moteslam.slam.registration.registrar import prior_spread, register, subsample
from moteslam.slam.tsdf.config import ProposalConfig
from moteslam.slam.tsdf.motion import MotionSinceUpdate
from moteslam.slam.tsdf.particles import Particles


@dataclass(frozen=True, eq=False)
class Proposal:
    """A Gaussian for each of N particles."""

    predicted: Array  # [N, 3] poses by the odometry
    offsets: Array  # [N, 3] of the means from these, in their frames
    information: Array  # [N, 3, 3] of the measurements about the means, zeros where nothing was measured
    spread: Array  # [3] standard deviation of the odometry about the predicted poses
    position_share: float  # share of that of the position that particles are sampled with
    registered: bool  # whether the scan has points enough to be registered; else nothing was measured
    log_likelihood: Array  # [N] of the measurements, up to a constant
    likelihoods: Array  # [N] mean likelihood of the endpoints, 0 to 1

    @property
    def means(self) -> Array:
        """The means [N, 3]."""
        return se2.compose(self.predicted, self.offsets)

    def precision(self, information_share: float) -> Array:
        """The inverse covariances [N, 3, 3] of measurements and odometry together."""
        return information_share * self.information + np.diag(1 / np.maximum(self.spread, 1e-9) ** 2)

    def of(self, parents: NDArray[np.int64]) -> Proposal:
        """The proposals of these particles [M]."""
        each = ("predicted", "offsets", "information", "log_likelihood", "likelihoods")
        return replace(self, **{name: getattr(self, name)[parents] for name in each})


def propose(
    particles: Particles,
    since: MotionSinceUpdate,
    scan: ThinnedScan,
    origin: Array,
    config: ProposalConfig,
    registration: RegistrationConfig,
    tracking: TrackingConfig,
    *,
    measured: bool,
    places: Array | None = None,
) -> Proposal:
    """Register a scan to every particle's map.

    Its rays start at an origin [2]. If odometry ``measured`` the last step only the endpoints' evidence overrules it.
    ``places``: [N, 3] where each looks for the robot, from where the tracked motion leads it; by default there.
    """
    n, travelled = len(particles), since.travelled
    predicted = se2.compose(particles.poses, since.odometry)
    if places is not None and places.any():
        away = places.any(axis=1)
        starts = se2.compose(se2.compose(particles.poses[away], since.tracked), places[away])
        predicted[away] = se2.compose(starts, se2.between(since.tracked, since.odometry))
    place = config.translation + config.translation_from_translation * travelled.distance
    spread = np.array((place, place, config.rotation + config.rotation_from_rotation * travelled.rotation))
    if len(scan.points) < tracking.min_points:
        zeros, nothing = np.zeros(n), np.zeros((n, 3, 3))
        return Proposal(predicted, nothing[..., 0], nothing, spread, config.sampled_share, False, zeros, zeros)
    drift = prior_spread(registration, travelled.distance, travelled.rotation, measured=measured)
    starts = np.array((se2.between_one(since.odometry, since.tracked),) * n)
    points = subsample(scan.points, registration.max_points)
    # along bare walls the errors of a map pull the same way at every update, and at each as far as odometry lets them:
    # with what the prior has at rest the farther, the more updates there are
    along = max(float(drift[0]) - registration.translation, RESOLVED[0])
    found = register(
        particles.maps.all(), predicted, drift, points, origin, starts, registration, keep=True, deviation=along
    )
    if measured:
        found = proved(found, particles.maps.all(), predicted, drift, points, origin, registration, tracking)
    evidence = -config.evidence_share * (found.costs + config.crossing_cost * found.crossed)  # -lambda (c + kappa n)
    return Proposal(
        predicted=predicted,
        offsets=found.offsets,
        information=found.information,
        spread=spread,
        position_share=config.sampled_share,
        registered=True,
        log_likelihood=evidence - 0.5 * np.square(found.offsets / drift).sum(axis=1),  # -|delta / sigma|^2 / 2
        likelihoods=found.likelihoods,
    )


def sample(proposal: Proposal, normals: Array, config: ProposalConfig, *, best: int) -> Array:
    """Poses [N, 3] drawn from the proposal by standard ``normals`` [N, 3]; the best particle stays at its mean."""
    share = proposal.position_share
    narrowed = replace(proposal, spread=proposal.spread * np.array([share, share, 1.0]))
    L = np.linalg.cholesky(narrowed.precision(config.information_share))  # P = L L^T
    noise = np.linalg.solve(np.swapaxes(L, 1, 2), normals[..., None])[..., 0]  # L^-T z has the covariance P^-1
    noise[best] = 0.0
    return se2.compose(proposal.predicted, proposal.offsets + noise)
