"""What a back end is: it is given key scans as the filter places them, and may correct the path they lie on.

Its ledger has every loop that it looked for, what was found, and why it was taken or not. And the back ends there are:
the bundled ones, and those of other packages (entry points ``moteslam.backends``).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from moteslam.plugins import Plugins
from moteslam.robot.se2 import Array
from moteslam.robot.values import Issue, Section, Summarised
from moteslam.slam.backend.building import Measured
from moteslam.slam.inputs.lapses import CLOSED, Open

Verdict = Literal["accepted", "weak", "ambiguous", "outside", "contradicted", "overruled", "unsearched"]
"""What became of a candidate: `accepted`; `weak`: too few endpoints on surfaces; `ambiguous`: another place fits nearly
as well; `outside`: found beyond what the relative covariance allows; `contradicted`: the other edges of the graph
outvoted it; `overruled`: it was an edge of the graph, but the final path, from all scans, lies elsewhere;
`unsearched`: its window is so wide that the search would cost more than the path driven allows."""


@dataclass(frozen=True, eq=False, repr=False)
class LoopCandidate(Summarised):
    """A pair of scans that may show the same place."""

    earlier: int  # index of a scan in the recording
    later: int  # likewise
    stamps: tuple[float, float]  # theirs [s], the earlier first
    predicted: Array  # [3] pose of the later scan in the frame of the earlier one, by the graph as it was
    found: Array  # [3] the same, where the search found it
    window: tuple[float, float]  # half widths of the search: [m], [rad]
    # of the endpoints that lie on surfaces of the submap, at most 1, less what rays through surfaces and the
    # offset from the prediction cost.
    share: float = 0.0
    runner_up: float = 0.0  # the largest share at a place half a metre or more off, 0 where there is none
    known: float = 0.0  # share of the endpoints where the submap is known
    likelihood: float = 0.0  # mean likelihood of those, 0 to 1
    crossed: float = 0.0  # share of the rays that pass through a surface of the submap
    verdict: Verdict = "unsearched"  # what became of it

    @property
    def accepted(self) -> bool:
        """Whether it is an edge of the graph that the final path confirms."""
        return self.verdict == "accepted"


class BackendConfig(Section):
    """Which back end runs behind the filter; each back end has a model of its own under this one."""

    method: str = "none"  # The back end: `none`, `graph`, or one that another package brings


@dataclass(frozen=True, eq=False, repr=False)
class KeyScan(Summarised):
    """A scan that the filter updated its particles with."""

    index: int  # of the scan in the recording
    stamp: float  # of the scan [s]
    points: NDArray[np.float32]  # [k, 2] float32 endpoints in the robot's frame [m]
    origin: Array  # [2] where the rays start, in the same frame [m]
    pose: Array  # [3] of the robot in the map frame, as the filter estimates it now
    # [3] motion since the key scan before by odometry alone, in the frame of the pose there; zeros where nothing
    # measured it.
    odometry: Array
    measured: bool  # whether the odometry measured all of that motion
    motion: Array  # [3] the same motion as the filter estimates it, along the path of its best particle
    lost: bool = False  # the filter does not know where the robot is in the map of before
    left_open: Open = CLOSED  # after a lapse of the odometry how far off the filter may be, where the scan did not say


class Backend(Protocol):
    """Corrects the path of the key scans, while the run goes on and at its end."""

    @property
    def loops(self) -> tuple[LoopCandidate, ...]:
        """The loops that it looked for so far, in the order of the search."""

    @property
    def measured(self) -> Measured | None:
        """The pose graph behind the latest ``finish``; None of a back end without one. May be left out."""

    @property
    def issues(self) -> tuple[Issue, ...]:
        """What the latest ``finish`` left aside or contradicts, for people. May be left out."""

    def add(self, key: KeyScan) -> Array | None:
        """Take in the next key scan; returns corrected poses [u, 3] of all u so far, from which the filter goes on, or
        None.

        While the filter is not settled none comes; then all that have waited do, one after the other.
        """
        return None

    def relocated(self, path: Array) -> None:
        """Take in that the filter has found a robot that was lost: the path [u, 3] of all key scans by it."""
        return

    def finish(self, path: Array) -> Array | None:
        """The path of all key scans as known at the end, poses [u, 3], or None where there is nothing to correct.

        The final trajectory, the map and the texture are drawn along it. ``path`` [u, 3] is the filter's best
        particle's; where the filter was corrected, with these corrections. In the middle of a run its last ones may be
        of key scans that wait.
        """
        return None


@dataclass(frozen=True)
class BackendKind:
    config: type[BackendConfig]  # the model of its section ``[backend]``; its `method` is the entry point's
    make: Callable[[Any], Backend]  # makes one for a run, of its configuration


class NoBackendConfig(BackendConfig):
    """No back end: what the filter finds is final."""

    # The back end behind the filter: `none`, `graph`, or one that another package brings
    method: Literal["none"] = "none"


class NoBackend(Backend):
    """Corrects nothing."""

    loops: tuple[LoopCandidate, ...] = ()
    measured: None = None
    issues: tuple[Issue, ...] = ()


NONE = BackendKind(NoBackendConfig, lambda config: NoBackend())

BACKENDS: Plugins[BackendKind] = Plugins(
    "moteslam.backends",
    BackendKind,
    bundled={"none": "moteslam.slam.backend.protocol:NONE", "graph": "moteslam.slam.backend.graph.backend:GRAPH"},
)
"""By name; the configuration key ``backend.method`` chooses one."""
