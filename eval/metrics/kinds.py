"""The metrics of a trajectory that every run is scored with: the bundled ones, and those of other packages.

Other packages bring theirs as entry points ``moteslam.metrics``; the name is the key in ``metrics.json``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

from moteslam.eval.metrics.ate import absolute_trajectory_error
from moteslam.eval.metrics.rpe import relative_pose_error
from moteslam.plugins import Plugins
from moteslam.robot.trajectory import Trajectory


class Result(Protocol):
    """What a metric comes to."""

    def as_dict(self) -> dict[str, Any]:
        """Plain values, fit for JSON; keys end in their unit."""


@dataclass(frozen=True)
class Metric:
    """A metric of a trajectory against the truth.

    Attributes:
        unit: of the headline figure.
        meaning: what it measures, one sentence with its source.
        score: ``score(estimate, truth)``; raises ``InputError`` where it cannot be had.
    """

    unit: str
    meaning: str
    score: Callable[[Trajectory, Trajectory], Result]


ATE = Metric("m", "Absolute trajectory error after rigid alignment (Sturm et al. 2012).", absolute_trajectory_error)
RPE_1M = Metric(
    "m", "Relative pose error over a metre of path (Sturm et al. 2012).", partial(relative_pose_error, unit="m")
)
RPE_1S = Metric("m", "Relative pose error over a second (Sturm et al. 2012).", partial(relative_pose_error, unit="s"))

METRICS: Plugins[Metric] = Plugins(
    "moteslam.metrics",
    Metric,
    bundled={name: f"moteslam.eval.metrics.kinds:{name.upper()}" for name in ("ate", "rpe_1m", "rpe_1s")},
)
"""By name."""
