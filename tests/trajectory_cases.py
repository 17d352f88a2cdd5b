"""Random trajectories that tests of their files share."""

import numpy as np
from hypothesis import strategies as st

from moteslam.robot.trajectory import Trajectory

# no subnormals: a library in the same process (Taichi) may have the processor flush them to zero
NUMBERS = st.floats(-1e6, 1e6, allow_subnormal=False)
HEADINGS = st.floats(-3.14159, 3.14159, allow_subnormal=False)


def made(n: int = 20, seed: int = 0) -> Trajectory:
    """Poses on a random walk, on the clock of Unix."""
    generator = np.random.default_rng(seed)
    return Trajectory(1298445274.5 + np.cumsum(generator.uniform(0, 0.1, n)), generator.normal(size=(n, 3)))


@st.composite
def trajectories(draw: st.DrawFn, latest: float = 2e9) -> Trajectory:
    """Any poses at any stamps from 0 to the latest [s], equal ones among them."""
    row = st.tuples(st.floats(0, latest, allow_subnormal=False), NUMBERS, NUMBERS, HEADINGS)
    table = np.array(sorted(draw(st.lists(row, min_size=1, max_size=12)), key=lambda row: row[0]))
    return Trajectory(table[:, 0], table[:, 1:])
