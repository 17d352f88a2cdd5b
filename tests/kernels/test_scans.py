"""Scans: ranges as endpoints as in NumPy, many in one launch, and normals of lines, corners and of what is no line."""

import numpy as np
import pytest
from numpy.typing import NDArray

from moteslam.kernels.normals import scan_normals
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
    points, begins, counts = scans.block(3, 60)
    assert len(counts) == 57
    for number, (begin, count) in enumerate(zip(begins, counts, strict=True)):
        expected = scans.points(3 + number)
        assert points[begin : begin + count].shape == expected.shape
        # float32 of up to 30 m
        np.testing.assert_allclose(points[begin : begin + count], expected, rtol=0, atol=4e-6)


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
