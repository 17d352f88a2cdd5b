"""The null back end: it corrects nothing."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.values import Issue
from moteslam.slam.backend.ledger import LoopCandidate
from moteslam.slam.backend.protocol import BackendConfig, KeyScan


class NoBackendConfig(BackendConfig):
    """No back end: what the filter finds is final."""

    method: Literal["none"] = "none"
    """The back end behind the filter: `none`, `graph`, or one that another package brings."""


class NoBackend:
    """Corrects nothing."""

    def __init__(self, config: NoBackendConfig) -> None:
        del config

    @property
    def loops(self) -> tuple[LoopCandidate, ...]:
        """None."""
        return ()

    @property
    def measured(self) -> None:
        """None."""

    @property
    def issues(self) -> tuple[Issue, ...]:
        """None."""
        return ()

    def add(self, key: KeyScan) -> None:
        """Nothing to correct."""

    def relocated(self, path: NDArray[np.float64]) -> None:
        """Nothing to correct."""

    def finish(self, path: NDArray[np.float64]) -> None:
        """Nothing to correct."""
