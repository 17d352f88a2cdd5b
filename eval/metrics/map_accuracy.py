"""A map against the true map: walls that lie where walls are, and free space that both know."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.formats.map_server import FREE, OCCUPIED, UNKNOWN
from moteslam.robot.raster import Raster
from moteslam.robot.se2 import IDENTITY, Poses
from moteslam.robot.values import expect_type

Array = NDArray[np.float64]

REACH = 0.1
"""Walls closer to each other than this [m] are the same wall."""

FARTHEST = 1.0
"""A wall cell counts as at most this far from the nearest one of the other map [m]."""


@dataclass(frozen=True)
class MapAccuracy:
    """A map against the true map.

    Attributes:
        precision: share of the map's wall cells within ``REACH`` of a true surface.
        recall: share of the true surface's cells, of those that were seen, within ``REACH`` of a wall cell of the map.
        f1: harmonic mean of both.
        distance: mean distance of the map's wall cells to the true surface, and of the surface that was seen to the
            map's walls, half each, each at most ``FARTHEST`` [m].
        free_iou: intersection over union of the free cells, among those that both maps know.
        known: share of the true free space that the map knows; what it does not know is in no other figure but recall.
        walls: wall cells of the map.
        surface: cells of the true surface that were seen.
    """

    precision: float
    recall: float
    f1: float
    distance: float
    free_iou: float
    known: float
    walls: int
    surface: int


def map_accuracy(
    estimate: Raster, truth: Raster, *, transform: Poses = IDENTITY, seen: Array | None = None
) -> MapAccuracy:
    """Score a map by the true one.

    The true surface are the true wall cells beside free ones: nobody sees the inside of a wall. Without ``seen`` the
    recall is over all of it.

    Args:
        estimate, truth: values [H, W] of ``FREE``, ``OCCUPIED`` or ``UNKNOWN``, of any cell size.
        transform: [3] pose of the estimate's frame in the true one, as ``absolute_trajectory_error`` finds it.
        seen: [p, 2] points that the lidar saw, in the true frame: recall is over the surface within ``REACH`` of one.

    Raises:
        InputError: maps of other values, or without a wall.
    """
    for raster, name in ((estimate, "estimate"), (truth, "truth")):
        expect_type(raster, Raster, name, "read_map(path) reads one")
        if raster.values.ndim != 2 or not np.isin(raster.values, (FREE, OCCUPIED, UNKNOWN)).all():
            raise InputError("values beside free, occupied and unknown, expected a trinary map", field=name)
    everywhere = surface_of(truth)
    surface = everywhere if seen is None else everywhere[_distances(everywhere, seen) <= REACH]
    walls = se2.transform_points(transform, estimate.centres(np.argwhere(estimate.values == OCCUPIED)))
    for points, name in ((walls, "estimate"), (surface, "truth")):
        if not len(points):
            raise InputError("no wall that was seen" if name == "truth" else "no wall", field=name)
    to_truth, to_map = _distances(walls, everywhere), _distances(surface, walls)
    precision, recall = float((to_truth <= REACH).mean()), float((to_map <= REACH).mean())
    there = np.argwhere(truth.values != UNKNOWN)
    true = truth.values[there[:, 0], there[:, 1]]
    back = se2.transform_points(se2.inverse(transform), truth.centres(there))
    mapped = estimate.values_at(back, outside=UNKNOWN)
    both = mapped != UNKNOWN
    union = both & ((mapped == FREE) | (true == FREE))
    return MapAccuracy(
        precision=precision,
        recall=recall,
        f1=2 * precision * recall / (precision + recall) if precision + recall else 0.0,
        distance=float(to_truth.mean() + to_map.mean()) / 2,
        free_iou=float((union & (mapped == true)).sum() / max(union.sum(), 1)),
        known=float(both[true == FREE].mean()) if (true == FREE).any() else 0.0,
        walls=len(walls),
        surface=len(surface),
    )


def surface_of(truth: Raster) -> Array:
    """The centres [n, 2] of the wall cells of a trinary map that share an edge with a free one [m]."""
    from scipy.ndimage import binary_dilation

    return truth.centres(np.argwhere((truth.values == OCCUPIED) & binary_dilation(truth.values == FREE)))


def _distances(points: Array, others: Array) -> Array:
    """Of points [n, 2] to the nearest of others [m, 2], at most ``FARTHEST``: [n] [m]."""
    from scipy.spatial import cKDTree

    if not len(points) or not len(others):
        return np.full(len(points), FARTHEST)
    return np.minimum(cKDTree(others).query(points, distance_upper_bound=FARTHEST)[0], FARTHEST)
