"""A metric of another package: how far from the true end a trajectory ends."""

from dataclasses import dataclass

import numpy as np

from moteslam.eval.metrics.kinds import Metric
from moteslam.robot.se2 import between
from moteslam.robot.trajectory import Trajectory


@dataclass(frozen=True)
class EndError:
    """The distance [m]."""

    distance: float

    def as_dict(self) -> dict[str, float]:
        """For JSON."""
        return {"distance_m": self.distance}


def end_error(estimate: Trajectory, truth: Trajectory) -> EndError:
    """Both seen from where they begin."""
    true = truth.at(estimate.stamps[[0, -1]]).poses
    off = between(estimate.poses[0], estimate.poses[-1]) - between(true[0], true[1])
    return EndError(float(np.hypot(off[0], off[1])))


METRIC = Metric("m", "Distance from the true end.", end_error)
