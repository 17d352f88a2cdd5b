"""A filter of another package: dead reckoning in one particle."""

from typing import Literal

import numpy as np

from moteslam.robot import se2
from moteslam.slam.config import Method, SlamConfig
from moteslam.slam.filter.history import History
from moteslam.slam.filter.protocol import FilterDefaults, StepResult
from moteslam.slam.filter.weights import Weights
from moteslam.slam.inputs.step import Step


class ToyConfig(SlamConfig):
    """Its keys."""

    method: Literal["toy"] = "toy"
    scale: float = 1.0


class ToyFilter(FilterDefaults):
    """Follows the odometry."""

    best_particle = 0

    def __init__(self, config: ToyConfig, seed: int) -> None:
        self.config, self.history, self.weights = config, History(), Weights.uniform(1)
        self.poses = np.zeros((1, 3))

    def step(self, step: Step) -> StepResult:
        """Every scan is an update."""
        self.poses = se2.compose(self.poses, step.motion * (self.config.scale, self.config.scale, 1.0))
        self.history.append(self.poses)
        return StepResult(self.poses[0], step.motion, 1.0, 0.0, True, False)


METHOD = Method(ToyConfig, ToyFilter)
