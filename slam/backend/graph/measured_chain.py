"""What the chain has measured: the steps between nodes in a row, of one session or of several one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.se2 import Array
from moteslam.slam.registration.config import RegistrationConfig
from moteslam.slam.registration.registrar import prior_spread

CONTRADICTED = 10.0  # A path so many deviations from a step is no error of that step but contradicts it
UNKNOWN = 1e6
"""Variance of the step from the last node of a session to the first of the next, which nothing measured [m^2]: so small
a weight only keeps the equations of a graph whole."""


class MeasuredChain(NamedTuple):
    """The steps between n nodes."""

    steps: Array  # [n - 1, 3] in the frames where they begin: by registration, odometry and the filter
    covariance: Array  # [n - 1, 3, 3] of them, in the frames where they end
    prior_steps: Array  # the same as a joint registration is to keep them
    prior_covariance: Array  # likewise
    doubted: NDArray[np.bool_]  # [n - 1] which of these may be far off: the odometry contradicts it, or there is none

    def prior(self, start: Array, config: RegistrationConfig) -> tuple[Array, Array, NDArray[np.bool_]]:
        """The steps for a joint registration that starts at poses [n, 3], their covariance, and which are doubtful.

        Where the start contradicts a step, it is the hypothesis that odometry or registration failed there: its own
        step then, loosely.
        """
        steps, covariance = self.prior_steps.copy(), self.prior_covariance.copy()
        begun = se2.between(start[:-1], start[1:])
        deviations = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        contradicted = (np.abs(se2.between(begun, steps)) >= CONTRADICTED * deviations).any(axis=1)
        for k in np.flatnonzero(contradicted):
            distance, rotation = float(np.hypot(*begun[k, :2])), abs(float(begun[k, 2]))
            loose = prior_spread(config, distance, rotation, measured=False)
            steps[k], covariance[k] = begun[k], np.diag(np.square(loose))
        return steps, covariance, self.doubted | contradicted

    def errors(self, poses: Array) -> tuple[Array, Array]:
        """[n - 1, 3] how far the steps between poses [n, 3] are off the measured ones, and the deviations of these."""
        off = se2.between(self.steps, se2.between(poses[:-1], poses[1:]))
        return off, np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))

    @classmethod
    def of_sessions(cls, chains: Sequence[MeasuredChain], gaps: Array) -> MeasuredChain:
        """The chains of k sessions in a row, with the steps [k - 1, 3] between them, which nothing measured."""
        unknown = np.eye(3)[None] * UNKNOWN
        parts = [chains[0]]
        for gap, chain in zip(gaps[:, None], chains[1:], strict=True):
            parts += [cls(gap, unknown, gap, unknown, np.zeros(1, np.bool_)), chain]
        return cls(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
