"""Loop candidates for tests."""

import numpy as np
from numpy.typing import ArrayLike

from moteslam.slam.backend.protocol import LoopCandidate, Verdict


def candidate(
    earlier: int,
    later: int,
    *,
    stamps: tuple[float, float] = (0.0, 1.0),
    found: ArrayLike = (0.0, 0.0, 0.0),
    predicted: ArrayLike = (0.0, 0.0, 0.0),
    verdict: Verdict = "accepted",
) -> LoopCandidate:
    """A candidate between two scans with scores like those of a clear loop."""
    return LoopCandidate(
        earlier=earlier,
        later=later,
        stamps=stamps,
        predicted=np.array(predicted, np.float64),
        found=np.array(found, np.float64),
        window=(3.5, np.deg2rad(20.0)),
        share=0.9,
        runner_up=1 / 3,
        known=0.95,
        likelihood=0.8,
        crossed=0.01,
        verdict=verdict,
    )
