"""Colours at many poses: the kernel against NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from moteslam.errors import InputError
from moteslam.kernels.colour_match import UNKNOWN, match_colours
from moteslam.robot.se2 import transform_points


def twin(points, colours, poses, packed, corner, cell, limit):
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
    theirs = twin(points, colours, poses, packed, np.array((-2.0, -1.5)), 0.05, 200)
    assert theirs[:, 1].max() > 300
    assert np.abs(ours - theirs)[:, 1].max() <= 1  # float32 at the side of a cell
    assert np.abs(ours - theirs)[:, 0].max() <= 200


@pytest.mark.usefixtures("taichi")
def test_nothing_known_is_nothing() -> None:
    points, colours, poses, packed = case(1)
    far = match_colours(points, colours, poses + np.array((1e6, 0, 0)), packed, corner=(0, 0), cell_size=0.05)
    assert not far.any()
    blank = match_colours(points, colours, poses, np.full_like(packed, UNKNOWN), corner=(0, 0), cell_size=0.05)
    assert not blank.any()
    assert match_colours(points[:0], colours[:0], poses, packed, corner=(0, 0), cell_size=0.05).shape == (40, 2)


@pytest.mark.usefixtures("taichi")
def test_bad_input() -> None:
    points, colours, poses, packed = case(2)
    for bad in (
        {"colours": colours[1:].copy()},
        {"poses": np.full((2, 3), np.nan)},
        {"limit": 0},
        {"cell_size": 0.0},
        {"packed": packed.astype(float)},
    ):
        arguments = {"points": points, "colours": colours, "poses": poses, "packed": packed, "corner": (0, 0),
                     "cell_size": 0.05, **bad}  # fmt: skip
        with pytest.raises(InputError):
            match_colours(**arguments)
