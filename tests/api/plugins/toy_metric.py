"""A metric of another package: how far from the true end a trajectory ends."""

import numpy as np

from moteslam.eval.metrics.evidence import Track
from moteslam.eval.metrics.registry import Metric
from moteslam.robot.se2 import between


def end_error(track: Track) -> float:
    """The distance [m], both seen from where they begin."""
    estimate = track.trajectory
    true = track.truth.at(estimate.stamps[[0, -1]]).poses
    off = between(estimate.poses[0], estimate.poses[-1]) - between(true[0], true[1])
    return float(np.hypot(off[0], off[1]))


METRIC = Metric("m", "Distance from the true end.", "toys", of_trajectory=end_error)
