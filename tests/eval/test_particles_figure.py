"""The figure of the particles: deviations, magnified by a stated factor, common ancestors, and where lineages part."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from figures import legend_of
from matplotlib.figure import Figure

from moteslam.eval.report.particles import Cloud, draw_particles, magnification


@pytest.fixture
def cloud() -> Cloud:
    """Four particles that drive 9 m along x: one ancestor for five updates, two for three, then four, 1 mm apart."""
    paths = np.zeros((4, 10, 3))
    paths[..., 0] = np.arange(10.0)
    paths[2:, 5:, 1] = 0.004
    paths[1::2, 8:, 1] += 0.001
    ancestors = np.zeros((4, 10), np.int64)
    ancestors[2:, 5:] = 1
    ancestors[:, 8:] = np.arange(4)[:, None]
    return Cloud(np.arange(10.0), paths, ancestors, np.full((10, 3), 0.002), best=2)


@pytest.fixture
def figure(cloud: Cloud, tmp_path: Path, drawn: list[Figure]) -> Figure:
    """The figure of these particles."""
    draw_particles(tmp_path / "particles.png", cloud)
    return drawn[0]


def test_ancestors_are_counted_and_lineages_part(cloud: Cloud) -> None:
    assert cloud.ancestor_counts.tolist() == [1, 1, 1, 1, 1, 2, 2, 2, 4, 4]
    assert cloud.partings.tolist() == [5, 8]


def test_deviations_are_from_the_mean_along_and_across_the_heading() -> None:
    paths = np.zeros((2, 1, 3))
    paths[:, 0] = [(1.0, 0.0, np.pi / 2 - 0.1), (3.0, 4.0, np.pi / 2 + 0.1)]
    cloud = Cloud(np.zeros(1), paths, np.arange(2)[:, None], np.zeros((1, 3)))
    np.testing.assert_allclose(cloud.mean, [(2.0, 2.0, np.pi / 2)])
    np.testing.assert_allclose(cloud.deviations(np.array([1])), [[(2.0, -1.0, 0.1)]])


def test_headings_that_straddle_the_seam_have_a_mean() -> None:
    paths = np.zeros((2, 1, 3))
    paths[:, 0, 2] = (np.pi - 0.1, 0.1 - np.pi)
    cloud = Cloud(np.zeros(1), paths, np.arange(2)[:, None], np.zeros((1, 3)))
    assert abs(cloud.deviations(np.arange(2))[:, 0, 2]).max() == pytest.approx(0.1)


def test_the_factor_is_printed_and_the_deviations_are_magnified_by_it(figure: Figure, cloud: Cloud) -> None:
    plan, _, across, _, _ = figure.axes
    assert plan.get_title() == "deviations magnified 100 times; ellipses: 2 standard deviations"
    paths = plan.collections[1].get_paths()
    drawn = np.array([path.vertices[-1, 1] for path in paths])
    true = cloud.paths[:, -1, 1]
    np.testing.assert_allclose(drawn - drawn.mean(), 100 * (true - true.mean()), atol=1e-9)
    assert across.get_ylabel() == "across [cm]"
    lines = across.collections[-1].get_segments()
    np.testing.assert_allclose([line[-1, 1] for line in lines], 100 * (true - true.mean()), atol=1e-9)


def test_ancestors_and_partings_are_drawn(figure: Figure) -> None:
    panel = figure.axes[-1]
    counts, partings = panel.lines
    assert counts.get_ydata().tolist() == [1, 1, 1, 1, 1, 2, 2, 2, 4, 4]
    assert partings.get_xdata().tolist() == [5, 8]
    assert panel.get_title("left") == "ancestors of the 4 particles of the last update: one common ancestor until 4 s"
    assert {"start", "end", "lineages part (2 times)", "paths of 4 particles of the last update"} <= set(
        legend_of(figure)
    )


@pytest.mark.parametrize(("largest", "factor"), [(0.0, 5000), (0.001, 500), (0.01, 50), (3.0, 1), (50.0, 1)])
def test_magnification_is_a_round_number(largest: float, factor: int) -> None:
    assert magnification(largest, 10.0) == factor
