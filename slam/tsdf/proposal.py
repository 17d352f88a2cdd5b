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
from moteslam.slam.odometry.noise import odometry_error
from moteslam.slam.registration.config import RegistrationConfig, TrackingConfig
from moteslam.slam.registration.evidence import proved
from moteslam.slam.registration.registrar import Registration, deviation_of_way, prior_spread, register, subsample
from moteslam.slam.tsdf.config import ProposalConfig
from moteslam.slam.tsdf.motion import MotionSinceUpdate
from moteslam.slam.tsdf.particles import Particles

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Proposal:
    """A Gaussian for each of N particles.

    Attributes:
        predicted: [N, 3] poses by the odometry.
        offsets: [N, 3] of the means from these, in their frames.
        information: [N, 3, 3] of the measurements about the means, zeros where nothing was measured.
        spread: [3] standard deviation of the odometry about the predicted poses.
        position_share: share of that of the position that particles are sampled with.
        registered: whether the scan has points enough to be registered; else nothing was measured.
        log_likelihood: [N] of the measurements, up to a constant.
        likelihoods: [N] mean likelihood of the endpoints, 0 to 1.
    """

    predicted: Array
    offsets: Array
    information: Array
    spread: Array
    position_share: float
    registered: bool
    log_likelihood: Array
    likelihoods: Array

    @property
    def means(self) -> Array:
        """The means [N, 3]."""
        return se2.compose(self.predicted, self.offsets)

    def precision(self, information_share: float) -> Array:
        """The inverse covariances [N, 3, 3] of measurements and odometry together."""
        return information_share * self.information + np.diag(1 / np.maximum(self.spread, 1e-9) ** 2)

    def of(self, parents: NDArray[np.int64]) -> Proposal:
        """The proposals of these particles [M]."""
        return replace(
            self,
            predicted=self.predicted[parents],
            offsets=self.offsets[parents],
            information=self.information[parents],
            log_likelihood=self.log_likelihood[parents],
            likelihoods=self.likelihoods[parents],
        )


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

    Args:
        origin: [2] where its rays start.
        tracking: the fewest points of a scan that is registered, and what speaks against it far from the odometry.
        measured: whether odometry measured the last step: then only the endpoints' evidence overrules it.
        places: [N, 3] where each looks for the robot, from where the tracked motion leads it; by default there.
    """
    n, travelled = len(particles), since.travelled
    predicted = se2.compose(particles.poses, since.odometry)
    if places is not None and places.any():
        away = places.any(axis=1)
        starts = se2.compose(se2.compose(particles.poses[away], since.tracked), places[away])
        predicted[away] = se2.compose(starts, se2.between(since.tracked, since.odometry))
    spread = np.array(odometry_error(config, travelled.distance, travelled.rotation))
    if len(scan.points) < tracking.min_points:
        zeros = np.zeros(n)
        nothing = np.zeros((n, 3, 3))
        return Proposal(predicted, nothing[..., 0], nothing, spread, config.sampled_share, False, zeros, zeros)
    drift = prior_spread(registration, travelled.distance, travelled.rotation, measured=measured)
    starts = np.array((se2.between_one(since.odometry, since.tracked),) * n)
    points = subsample(scan.points, registration.max_points)
    along = deviation_of_way(drift, registration)
    found = register(
        particles.maps.all(), predicted, drift, points, origin, starts, registration, keep=True, deviation=along
    )
    if measured:
        found = proved(found, particles.maps.all(), predicted, drift, points, origin, registration, tracking)
    return Proposal(
        predicted=predicted,
        offsets=found.offsets,
        information=found.information,
        spread=spread,
        position_share=config.sampled_share,
        registered=True,
        log_likelihood=_log_likelihood(found, drift, config),
        likelihoods=found.likelihoods,
    )


def sample(proposal: Proposal, normals: Array, config: ProposalConfig, *, best: int) -> Array:
    """Poses [N, 3] drawn from the proposal; the best particle stays at its mean.

    Args:
        normals: [N, 3] standard normal numbers.
    """
    share = proposal.position_share
    narrowed = replace(proposal, spread=proposal.spread * np.array([share, share, 1.0]))
    L = np.linalg.cholesky(narrowed.precision(config.information_share))  # P = L L^T
    noise = np.linalg.solve(np.swapaxes(L, 1, 2), normals[..., None])[..., 0]  # L^-T z has the covariance P^-1
    noise[best] = 0.0
    return se2.compose(proposal.predicted, proposal.offsets + noise)


def _log_likelihood(found: Registration, drift: Array, config: ProposalConfig) -> Array:
    """By the endpoints, the rays through surfaces, and the offset delta from the odometry [N]."""
    evidence = -config.evidence_share * (found.costs + config.crossing_cost * found.crossed)  # -lambda (c + kappa n)
    return np.asarray(evidence - 0.5 * np.square(found.offsets / drift).sum(axis=1))  # -|delta / sigma|^2 / 2
