"""Colours into cells: the kernel against its twin, in any order, on any number of threads."""

import numpy as np
import pytest
from twins.camera import add_frame as twin
from twins.camera import disparity_of
from ucsd_robot import CAMERA

from moteslam.kernels.texture import UNKNOWN, match_colours
from moteslam.robot.rgbd import mount_rotation
from moteslam.robot.se2 import transform_points
from moteslam.slam.texture.floor_map import calibration

MOUNT = np.column_stack((mount_rotation(CAMERA), (0.18, 0.005, 0.36)))
PLACE = {"corner": (-4.0, -4.0), "cell_size": 0.05}


def frame(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A disparity image of floor and things on it, with holes of every kind, and random colours."""
    rng = np.random.default_rng(seed)
    row = np.arange(480)[:, None] + np.zeros((1, 640))
    slope = np.maximum(np.sin(0.36) + np.cos(0.36) * (row - 242.94) / 585.05, 0.02)
    depth = 0.36 / slope * rng.uniform(0.6, 1.1, (480, 640))
    disparity = np.clip(np.rint(disparity_of(depth)), 1, 1085).astype(np.uint16)
    disparity[rng.random((480, 640)) < 0.05] = 2047
    disparity[rng.random((480, 640)) < 0.02] = 0
    disparity[rng.random((480, 640)) < 0.02] = 1500
    return disparity, rng.integers(0, 256, (480, 640, 3), dtype=np.uint8)


def add(sums: np.ndarray, disparity: np.ndarray, rgb: np.ndarray, pose: object, **changes: object) -> None:
    from moteslam.kernels.texture import add_frame

    settings = {
        **PLACE, "calibration": calibration(), "mount": MOUNT, "height_limit": 0.1, "max_depth": 5.0, "nothing": 2047
    }  # fmt: skip
    add_frame(sums, disparity, rgb, pose, **{**settings, **changes})  # type: ignore[arg-type]


@pytest.mark.usefixtures("taichi")
@pytest.mark.parametrize("flat", [False, True])
def test_agrees_with_the_published_formulas(flat: bool) -> None:
    ours, theirs = np.zeros((160, 200, 4), np.int64), np.zeros((160, 200, 4), np.int64)
    for seed, pose in enumerate([(0.0, 0.0, 0.0), (0.7, -0.4, 2.0), (3.0, 1.0, -1.2)]):
        disparity, rgb = frame(seed)
        add(ours, disparity, rgb, pose, flat=flat)
        twin(
            theirs, disparity, rgb, pose, **PLACE, height_limit=0.1, max_depth=5.0, camera=MOUNT[:, 3] if flat else None
        )
    assert theirs[..., 3].sum() > 400_000
    # points within float32's reach of a cell's side, or colour pixels of a half, may fall to the other side
    assert np.abs(ours - theirs)[..., 3].sum() < 2e-4 * theirs[..., 3].sum()
    assert np.abs(ours - theirs)[..., :3].sum() < 1e-3 * theirs[..., :3].sum()


@pytest.mark.usefixtures("taichi")
def test_only_what_is_low_near_and_inside_counts() -> None:
    disparity, rgb = frame(0)

    def count(**changes: object) -> int:
        sums = np.zeros((160, 160, 4), np.int64)
        add(sums, disparity, rgb, (0.0, 0.0, 0.0), **changes)
        return int(sums[..., 3].sum())

    assert count(height_limit=-1e3) == 0
    assert count(height_limit=0.0) < count() < count(height_limit=1e3)
    assert count(max_depth=1.0) < count()
    assert count(corner=(50.0, 50.0)) == 0
    assert count(nothing=1) == 0
    elsewhere = np.zeros((160, 160, 4), np.int64)
    add(elsewhere, disparity, rgb, (1e9, 0.0, 0.0))
    assert not elsewhere.any()


def compared_by_numpy(points, colours, poses, packed, corner, cell, limit):
    out = []
    for pose in poses:
        cells = np.floor((transform_points(pose, points) - corner) / cell).astype(int)
        inside = ((cells >= 0) & (cells < packed.shape[::-1])).all(axis=1)
        there = packed[cells[inside, 1], cells[inside, 0]]
        here = colours[inside][there != UNKNOWN]
        there = there[there != UNKNOWN]
        apart = sum(np.abs((here >> shift & 255) - (there >> shift & 255)) for shift in (0, 8, 16))
        out.append((np.minimum(apart, limit).sum(), len(there)))
    return np.array(out)


def case(seed: int):
    rng = np.random.default_rng(seed)
    points = rng.uniform((0, -2), (4, 2), (1500, 2)).astype(np.float32)
    colours = rng.integers(0, 2**24, 1500).astype(np.int32)
    packed = rng.integers(0, 2**24, (70, 90)).astype(np.int32)
    packed[rng.random(packed.shape) < 0.3] = UNKNOWN
    poses = rng.uniform((-3, -3, -3), (3, 3, 3), (40, 3))
    return points, colours, poses, packed


@pytest.mark.usefixtures("taichi")
def test_agrees_with_numpy() -> None:
    points, colours, poses, packed = case(0)
    ours = match_colours(points, colours, poses, packed, corner=(-2.0, -1.5), cell_size=0.05, limit=200)
    theirs = compared_by_numpy(points, colours, poses, packed, np.array((-2.0, -1.5)), 0.05, 200)
    assert theirs[:, 1].max() > 300
    assert np.abs(ours - theirs)[:, 1].max() <= 1  # float32 at the side of a cell
    assert np.abs(ours - theirs)[:, 0].max() <= 200
