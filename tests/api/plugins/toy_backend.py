"""A back end of another package: it moves everything north, once while the run goes on and once more at its end."""

from typing import Literal

import numpy as np

from moteslam.slam.backend.protocol import BackendConfig, BackendKind, KeyScan


class ToyConfig(BackendConfig):
    """Its keys."""

    method: Literal["toy"] = "toy"
    north: float = 1.0
    after: int = 5


class ToyBackend:
    """Corrects by a shift."""

    loops = ()  # it looks for none

    def __init__(self, config: ToyConfig) -> None:
        self.config, self.poses = config, []

    def add(self, key: KeyScan) -> np.ndarray | None:
        """After some key scans all of them are moved."""
        self.poses.append(key.pose)
        return self.finish(np.array(self.poses)) if len(self.poses) == self.config.after else None

    def finish(self, path: np.ndarray) -> np.ndarray:
        """The path moved to the north [m], once more at the end."""
        return path + np.array((0.0, self.config.north, 0.0))


BACKEND = BackendKind(ToyConfig, ToyBackend)
