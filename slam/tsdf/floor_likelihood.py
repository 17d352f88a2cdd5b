"""The colours of the floor as one more likelihood of the particles, where there is a camera."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.slam.inputs.floor_views import FloorView
from moteslam.slam.texture.config import TextureConfig
from moteslam.slam.tsdf.config import ColourConfig
from moteslam.slam.tsdf.floor_tracker import FloorTracker
from moteslam.slam.tsdf.motion import MotionSinceUpdate
from moteslam.slam.tsdf.particles import Particles
from moteslam.slam.tsdf.proposal import Proposal

Array = NDArray[np.float64]


class FloorLikelihood:
    """Weighs particles by camera frames of the floor; without frames it changes nothing.

    Args:
        config: of the colours.
        texture: what counts as floor.
        information_share: share of the endpoints' information that counts beside that of the floor.
    """

    def __init__(self, config: ColourConfig, texture: TextureConfig, information_share: float) -> None:
        self._config = config
        self._tracker = FloorTracker(config, texture)
        self._information_share = information_share
        self._view: FloorView | None = None  # the frame of this update
        self._since_frame = 0.0  # distance since the last frame [m]

    def look(self, read: Callable[[float], FloorView | None] | None) -> None:
        """Read the newest frame for this update, if the run uses the camera."""
        self._view = None if read is None else read(self._config.largest_age)

    def refine(self, proposal: Proposal, since: MotionSinceUpdate, best: int) -> Proposal | None:
        """The proposal multiplied by what the floor measures of each particle's position.

        Lidar and odometry put a particle at a Gaussian of information A, the floor at another one, of information B,
        at an offset d: the mean of the product lies (A + B)^-1 B d away, and its integral, which is the particle's
        likelihood, falls with d^T (B - B (A + B)^-1 B) d / 2.

        Args:
            proposal: of lidar and odometry.
            since: the motion since the last update.
            best: the particle around which the floor is searched.

        Returns:
            None where there is no frame, or it measures nothing.
        """
        if self._view is None or not proposal.registered:
            return None
        registered = se2.compose(since.odometry, proposal.offsets[best])
        self._view = self._view.corrected(np.array(since.wheels), registered, since.travelled.elapsed)
        fit = self._tracker.fit(self._view, proposal.means, best)
        if fit is None:
            return None
        lidar = proposal.precision(self._information_share)
        gain = np.linalg.solve(lidar + fit.information, np.broadcast_to(fit.information, lidar.shape))
        inside = fit.information - fit.information @ gain
        off = fit.offsets
        return replace(
            proposal,
            offsets=se2.compose(proposal.offsets, np.einsum("nij,nj->ni", gain, off)),
            information=proposal.information + fit.information / self._information_share,
            position_share=1.0,  # the floor tells particles apart where the lidar does not
            log_likelihood=-0.5 * np.einsum("ni,nij,nj->n", off, inside, off),
        )

    def integrate(self, particles: Particles, since: MotionSinceUpdate) -> None:
        """Write the frame of this update into the newest map of the floor, seen from the best particle.

        Args:
            particles: at this update.
            since: the motion since the update before.
        """
        self._since_frame += since.travelled.distance
        if self._view is not None:
            self._tracker.add(self._view, particles.poses, particles.best, self._since_frame)
            self._since_frame = 0.0

    def resample(self, parents: NDArray[np.int64]) -> None:
        """Particles [M] survive as the children of these."""
        self._tracker.resample(parents)
