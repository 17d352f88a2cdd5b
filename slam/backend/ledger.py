"""The ledger of a back end: every loop that it looked for, what was found, and why it was taken or not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from moteslam.robot.se2 import Array
from moteslam.robot.values import Summarised

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
    share: float
    runner_up: float  # the largest share at a place half a metre or more off, 0 where there is none
    known: float  # share of the endpoints where the submap is known
    likelihood: float  # mean likelihood of those, 0 to 1
    crossed: float  # share of the rays that pass through a surface of the submap
    verdict: Verdict  # what became of it

    @classmethod
    def unsearched(
        cls, earlier: int, later: int, stamps: tuple[float, float], predicted: Array, window: tuple[float, float]
    ) -> LoopCandidate:
        """One before it is searched for."""
        return cls(earlier, later, stamps, predicted, predicted, window, 0.0, 0.0, 0.0, 0.0, 0.0, "unsearched")

    @property
    def accepted(self) -> bool:
        """Whether it is an edge of the graph that the final path confirms."""
        return self.verdict == "accepted"
