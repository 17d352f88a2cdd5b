"""What a filter is to a run: a step in, a result out, the particles' paths at the end."""

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.raster import Raster
from moteslam.robot.se2 import Array
from moteslam.robot.values import Issue
from moteslam.slam.filter.certainty import Certainty
from moteslam.slam.filter.history import History
from moteslam.slam.filter.weights import Weights
from moteslam.slam.inputs.config import ThinningConfig
from moteslam.slam.inputs.scans import Scans
from moteslam.slam.inputs.step import Step

__all__ = ["Filter", "FilterDefaults", "Scans", "Step", "StepResult"]


class StepResult(NamedTuple):
    pose: Array  # [3] of the robot in the map frame, as estimated now
    motion: Array  # [3] since the scan before, as the filter estimates it, in the frame of the pose there
    n_eff: float  # effective number of particles, before resampling
    score: float  # of the best particle's scan in its map; what it counts is the filter's own
    updated: bool  # the filter updated particles and map with this scan; else the pose followed the motion
    resampled: bool  # particles were resampled
    # how sure the filter is of the pose; None if it does not measure that: then it follows from the spread of the
    # particles.
    certainty: Certainty | None = None


class FilterDefaults(Protocol):
    """What a filter does that has one hypothesis, no camera and no map of its own, and does not follow corrections."""

    @property
    def settled(self) -> bool:
        """Whether the particles are at one place; else the best one's path may yet turn out to be wrong."""
        return True

    @property
    def uses_camera(self) -> bool:
        """Whether it asks for camera frames of the floor."""
        return False

    @property
    def thinning(self) -> ThinningConfig | None:
        """How the scans of its steps are thinned; None to take them as they are."""
        return None

    @property
    def lost(self) -> bool:
        """Whether the robot is lost, and what it sees goes into a map apart until it is found."""
        return False

    @property
    def issues(self) -> tuple[Issue, ...]:
        """What it could not do, for the warnings of the run."""
        return ()

    def occupancy(self) -> Raster | None:
        """The filter's own occupancy map; None to have it drawn along the best particle's path."""
        return None

    def relocated(self) -> Array | None:
        """The path [u, 3] of all updates where a robot that was lost has been found since this was asked; else None.

        The caller corrects the path by ``revise``.
        """
        return None

    def revise(self, poses: Array, updates: NDArray[np.intp], scans: Scans) -> None:
        """Go on from a path that was corrected: poses [u, 3] of the robot at every update so far, of the scans
        ``updates`` [u].
        """
        return


class Filter(FilterDefaults, Protocol):
    """A particle filter for SLAM. The robot starts at the identity of the map frame."""

    @property
    def poses(self) -> Array:
        """[N, 3] of the particles at the last update."""

    @property
    def weights(self) -> Weights:
        """Of the particles at the last update."""

    @property
    def history(self) -> History:
        """The particles' poses at every update."""

    @property
    def best_particle(self) -> int:
        """Index of the best particle at the last update, before it was resampled."""

    def step(self, step: Step) -> StepResult:
        """Take in one scan and the motion since the scan before."""
