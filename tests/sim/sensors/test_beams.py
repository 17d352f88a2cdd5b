"""Wide beams, mixed pixels, false returns, and the smallest range."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from moteslam.robot.noise import LidarNoise
from moteslam.robot.platforms import UCSD
from moteslam.sim.sensors.echoes import Scene
from moteslam.sim.sensors.lidar import beam_ranges, measured
from moteslam.sim.world.layout import Layout, Room
from moteslam.sim.world.pieces import Box
from moteslam.sim.world.world import World

pytestmark = pytest.mark.usefixtures("taichi")

N = 20_000
SCAN = UCSD.lidar.scan
BOX = Scene(
    World.of(Layout(rooms=(Room(corner=(-10, -10), size=(20, 20)),), boxes=(Box(centre=(9.5, 3), size=(1, 6)),)))
)
"""A box whose front, at x = 9, ends at y = 0; behind it the wall at x = 10."""


def noise(**changed: float) -> LidarNoise:
    return LidarNoise().model_copy(update=changed)


def ranges_of(settings: LidarNoise, angles: np.ndarray, scene: Scene = BOX) -> np.ndarray:
    count = len(angles)
    return beam_ranges(scene, np.zeros((count, 2)), angles, np.zeros(count), SCAN, settings, np.random.default_rng(2))


def test_a_line_meets_one_side_of_the_edge() -> None:
    ranges = ranges_of(noise(), np.array([0.002, -0.002]))
    np.testing.assert_allclose(ranges, [9.0, 10.0], atol=1e-4)


def test_a_wide_beam_at_an_edge_measures_something_in_between() -> None:
    edge = np.full(N, 0.001)
    ranges = ranges_of(noise(divergence=0.013, mixed=0.5, pulse=2.0), edge)
    between = (ranges > 9.05) & (ranges < 9.95)
    assert between.mean() == pytest.approx(0.5 * 0.9, abs=0.03)
    apart = ranges_of(noise(divergence=0.013, mixed=0.5, pulse=0.5), edge)
    assert not ((apart > 9.01) & (apart < 9.99)).any()  # a metre is too far for one echo
    assert (apart > 9.5).mean() == pytest.approx(0.25, abs=0.02)


def test_flat_walls_have_no_edges() -> None:
    # the wall in the south, seen from square on to flat: its slope is no edge
    angles = -np.pi / 2 + np.linspace(-1.1, 0.7, 500)
    np.testing.assert_array_equal(ranges_of(noise(divergence=0.013), angles), ranges_of(noise(), angles))


def test_where_nothing_is_within_reach_there_is_no_edge() -> None:
    far = Scene(World.of(Layout(rooms=(Room(corner=(-200, -2), size=(400, 4)),))))
    angles = np.linspace(-0.1, 0.1, 300)
    ranges = ranges_of(noise(divergence=0.013), angles, far)
    assert np.isposinf(ranges[np.abs(angles) < 0.06]).all()
    assert not np.isnan(ranges).any()


def test_false_returns_are_short_and_as_many_as_asked_for() -> None:
    ranges = ranges_of(noise(false_return=0.1, false_scale=1.0), np.full(N, -0.3))
    wall = 10.0 / np.cos(0.3)
    early = ranges < wall - 1e-3
    assert early.mean() == pytest.approx(0.1, abs=0.01)
    assert (ranges[early] - 0.1).mean() == pytest.approx(1.0, abs=0.1)
    np.testing.assert_allclose(ranges[~early], wall, atol=1e-3)


def test_the_smallest_range_can_be_set() -> None:
    ranges = measured(np.array([0.2, 0.6], np.float32), replace(SCAN, range_min=0.5), noise(), np.random.default_rng(0))
    np.testing.assert_array_equal(np.isnan(ranges), [True, False])
