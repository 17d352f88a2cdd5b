"""Calibration by motions of lidar and odometry, where the true values are known."""

from __future__ import annotations

import numpy as np
import pytest

from moteslam.robot import se2
from moteslam.slam.calibration.hand_eye import Fit, Pairs, Parameter, fit

MOUNT = np.array((0.15, -0.05, 0.3))


def fitted(*, turns: float = 1.0, noise: float = 0.0, slip: float = 0.0) -> Fit:
    """Of 1000 steps of a second: the odometry's turns scaled and noisy [rad], wheels that slip aside [s]."""
    rng = np.random.default_rng(0)
    turn = rng.normal(0, 0.2, 1000)
    length = rng.uniform(0.2, 1.0, 1000)

    def arcs(turn: np.ndarray, aside: float = 0.0) -> np.ndarray:
        left = -aside * length * turn
        cos, sin = np.cos(turn / 2), np.sin(turn / 2)
        return np.stack((cos * length - sin * left, sin * length + cos * left, turn), axis=1)

    lidar = se2.compose(se2.compose(se2.inverse(MOUNT), arcs(turn, slip)), MOUNT)
    poses = se2.accumulate(arcs(turns * turn + rng.normal(0, noise, 1000)), np.zeros(3))
    poses = np.vstack((np.zeros(3), poses))
    poses[:, 2] = np.unwrap(poses[:, 2])
    first = np.arange(1000.0)
    pairs = Pairs(first, first + 1, lidar, np.tile(1e-6 * np.eye(3), (1000, 1, 1)))
    return fit(pairs, lambda times: poses[np.rint(times).astype(int)], (0.0, 0.0), shared=True)


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.15])
@pytest.mark.parametrize("turns", [1.0, 1.05, 1.1, 0.9])
def test_noise_of_the_odometry_is_no_scale_of_its_turns(turns: float, noise: float) -> None:
    found = fitted(turns=turns, noise=noise)
    assert found.values[Parameter.TURNS] == pytest.approx(turns, abs=1e-4 + 3 * noise / 0.2 / 1000**0.5)
    assert found.values[: Parameter.TURNS] == pytest.approx((*MOUNT, 1), abs=0.002)


def test_wheels_that_slip_aside_in_turns_do_not_move_the_mount() -> None:
    found = fitted(slip=0.1)
    assert found.values[Parameter.SLIP] == pytest.approx(0.1, rel=0.05)
    assert found.values[: Parameter.LENGTHS] == pytest.approx(MOUNT, abs=0.002)
