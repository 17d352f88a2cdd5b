"""What is kept of every scan: its pose and motion while SLAM ran, how sure the filter was, and what it cost."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.slam.filter.certainty import Certainty
from moteslam.slam.filter.protocol import StepResult

Array = NDArray[np.float64]
DIAGNOSTICS = ("particles", "n_eff", "score", "updated", "resampled", "seconds", "degenerate", "state", "corrected")
"""What is kept of every step: see ``Estimate.diagnostics``."""


class ScanRecords:
    """Arrays with a row a scan of the recording, filled in the order of the scans.

    Args:
        scans: that the recording has until now.

    Attributes:
        done: scans that are recorded; the rows after them are zero.
    """

    def __init__(self, scans: int) -> None:
        self.done = 0
        self._poses, self._motions, self._covariances = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3))
        self._diagnostics = {key: np.zeros(0) for key in DIAGNOSTICS}
        self.make_room(scans)

    def make_room(self, scans: int) -> None:
        """Room for ``scans`` scans in all; what is recorded stays."""
        more = scans - len(self._poses)
        self._poses, self._motions, self._covariances = (
            np.concatenate((kept, np.zeros((more, *kept.shape[1:]))))
            for kept in (self._poses, self._motions, self._covariances)
        )
        self._diagnostics = {key: np.concatenate((kept, np.zeros(more))) for key, kept in self._diagnostics.items()}

    def add(
        self, result: StepResult, certainty: Certainty, *, particles: int, seconds: float, corrected: float
    ) -> None:
        """Record the next scan.

        Args:
            result, certainty: of the filter's step.
            particles: how many there are.
            seconds: spent on the scan.
            corrected: how far the back end then moved the robot [m].
        """
        index = self.done
        self._poses[index], self._motions[index] = result.pose, result.motion
        self._covariances[index] = certainty.covariance
        values = (particles, result.n_eff, result.score, result.updated, result.resampled, seconds)
        for key, value in zip(DIAGNOSTICS, (*values, certainty.degenerate, certainty.state, corrected), strict=True):
            self._diagnostics[key][index] = value
        self.done = index + 1

    def add_to_last(self, *, seconds: float, corrected: float) -> None:
        """What the latest scan cost, and was corrected by, beyond what is recorded of it."""
        self._diagnostics["seconds"][self.done - 1] += seconds
        self._diagnostics["corrected"][self.done - 1] += corrected

    @property
    def poses(self) -> Array:
        """The filter's pose [k, 3] at each recorded scan."""
        return self._poses[: self.done]

    @property
    def motions(self) -> Array:
        """The motion [k, 3] from the scan before to each, in that one's frame."""
        return self._motions[: self.done]

    @property
    def covariances(self) -> Array:
        """Of the poses, [k, 3, 3]."""
        return self._covariances[: self.done]

    @property
    def diagnostics(self) -> dict[str, Array]:
        """By the names of `DIAGNOSTICS`, [k] each."""
        return {key: values[: self.done] for key, values in self._diagnostics.items()}
