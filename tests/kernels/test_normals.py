"""Normals of scans: on a line, at a corner, on what is no line."""

import numpy as np
import pytest

from moteslam.kernels.normals import scan_normals

pytestmark = pytest.mark.usefixtures("taichi")

OPTIONS = {"reach": 0.3, "noise": 0.005, "largest": 0.1}


def normals(points: np.ndarray, joined: np.ndarray | None = None, **options: float) -> np.ndarray:
    linked = np.ones(len(points), np.int32) if joined is None else joined
    return scan_normals(points, linked, [0, len(points)], **{**OPTIONS, **options})


def test_a_wall_has_its_normal_towards_the_sensor():
    along = np.linspace(-1, 1, 41)
    for angle in (0.0, 0.7, 2.5, -1.2):
        c, s = np.cos(angle), np.sin(angle)
        wall = np.column_stack((2 * c - along * s, 2 * s + along * c))
        np.testing.assert_allclose(normals(wall), np.tile((-c, -s), (41, 1)), atol=1e-3)


def test_both_walls_of_a_corner_keep_their_normals_up_to_it():
    along = np.arange(0, 1.001, 0.05)
    wall = np.column_stack((np.full(len(along), 2.0), along))
    other = np.column_stack((2.0 - along[1:], np.full(len(along) - 1, 1.0)))
    found = normals(np.vstack((wall, other)))
    np.testing.assert_allclose(found[: len(wall) - 1], np.tile((-1, 0), (len(wall) - 1, 1)), atol=1e-3)
    np.testing.assert_allclose(found[len(wall) + 1 :], np.tile((0, -1), (len(other) - 1, 1)), atol=1e-3)


def test_noise_turns_them_by_what_the_fit_allows():
    rng = np.random.default_rng(1)
    along = np.linspace(-3, 3, 201)
    wall = np.column_stack((2 + rng.normal(0, 0.005, 201), along))
    turned = np.arctan2(normals(wall)[:, 1], -normals(wall)[:, 0])
    assert np.abs(turned).max() < 0.15
    assert np.std(turned) < 0.04


def test_most_points_on_no_line_have_none():
    rng = np.random.default_rng(2)
    bush = rng.uniform((1.7, -0.3), (2.3, 0.3), (60, 2))
    assert (normals(bush) == 0).all(axis=1).mean() > 0.6


def test_scans_do_not_mix():
    wall = np.column_stack((np.full(4, 2.0), np.arange(4) * 0.05))
    found = scan_normals(wall, np.ones(4, np.int32), [0, 2, 4], **OPTIONS)
    assert (found == 0).all()
