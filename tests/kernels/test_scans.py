"""Ranges as endpoints, many scans in one launch: the same as one at a time in NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from moteslam.robot.platform import LidarSpec
from moteslam.robot.recording import LidarStream
from moteslam.slam.inputs.scans import Scans

BEAMS, SCANS = 181, 70
MOUNT = LidarSpec(x=0.2, y=-0.1, yaw=0.3)


def lidar() -> LidarStream:
    """Ranges from 0.1 to 30 m, with some that are infinite and some NaN; one scan has nothing else."""
    generator = np.random.default_rng(3)
    ranges = generator.uniform(0.1, 30.0, (SCANS, BEAMS)).astype(np.float32)
    ranges[generator.random(ranges.shape) < 0.1] = np.inf
    ranges[generator.random(ranges.shape) < 0.1] = np.nan
    ranges[5] = np.nan
    return LidarStream(np.arange(SCANS) * 0.1, ranges, -np.pi / 2, np.pi / 180, 0.1, 30.0)


def sweeps() -> NDArray[np.float64]:
    """Up to 10 cm and a quarter of a turn within a sweep."""
    return np.random.default_rng(4).uniform((-0.1, -0.1, -1.5), (0.1, 0.1, 1.5), (SCANS, 3))


@pytest.mark.parametrize("moved", [False, True])
@pytest.mark.parametrize("max_range", [np.inf, 12.0])
def test_a_block_of_scans_has_the_endpoints_of_each(moved: bool, max_range: float) -> None:
    scans = Scans(lidar(), MOUNT, sweeps=sweeps() if moved else None, max_range=max_range)
    block = scans.block(3, 60)
    assert len(block.counts) == 57
    for number in range(57):
        expected = scans.points(3 + number)
        assert block.of(number).shape == expected.shape
        # float32 of up to 30 m
        np.testing.assert_allclose(block.of(number), expected, rtol=0, atol=4e-6)
