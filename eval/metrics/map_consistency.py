"""The map that the scans of a recording draw under a trajectory, and whether its walls are thin; no truth needed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.eval.metrics.association import evenly, placed_scans, travelled
from moteslam.eval.metrics.residuals import surface_points
from moteslam.robot import se2
from moteslam.robot.raster import cells_of, mean_cells
from moteslam.robot.recording import LidarStream, Recording
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import counted
from moteslam.slam.inputs.scans import Scans
from moteslam.slam.inputs.synchronise import synchronise

Array = NDArray[np.float64]

SPACING = 0.3
"""A scan is used once the robot has moved by this much [m] or turned by as many radians since the last one used."""
MAX_SCANS = 5000
"""At most this many of them are used, spread evenly over the drive."""
CELL, BLOCK = 0.05, 1.0
"""Edges of the cells, and of the blocks by which walls are measured [m]."""
CROFTON = np.pi / 4
"""Metres of a straight line in each metre of the squares that it meets, in the mean over its directions."""
SAMPLES = 8000
"""Endpoints that are compared with those of other scans, spread evenly over all."""
NEAR_PATH, FAR_PATH = 6.0, 15.0
"""Scans less than the first and more than the second of path apart are compared [m]."""
REACH = 0.4
"""An endpoint without another one within this distance [m] is not compared with those scans."""
TWICE, APART = 0.1, 1.0
"""A wall is drawn twice where the nearest endpoint on the same side of it, more than ``FAR_PATH`` away, is farther than
the first and nearer than the second [m]."""
SAME_FACING = 0.8
"""Smallest cosine between the normals of two endpoints of the same side of a wall."""
AROUND, FEWEST = 0.15, 10
"""A wall's thickness is measured over the endpoints within this distance of one [m], where there are at least
this many."""


@dataclass(frozen=True)
class MapConsistency:
    """The sharpness of the map that the scans draw.

    Attributes:
        cells: how many cells of 5 cm hold an endpoint: fewer are sharper.
        walls: length of the walls that were seen [m], counted again where they are seen again after ``FAR_PATH``: so it
            hardly depends on where the trajectory draws them.
        cells_per_metre: of these walls [1/m].
        near: mean distance of an endpoint to the nearest one of scans less than ``NEAR_PATH`` of path away [m]: noise.
        far: the same, more than ``FAR_PATH`` away [m]: noise and loops that do not close; None where the robot comes
            back to no place.
        thickness: median standard deviation of endpoints across their wall [m].
        twice: share of the endpoints whose wall was seen again after ``FAR_PATH`` where it lies elsewhere then, see
            ``TWICE``; None where none was.
        scans: how many scans were used.
    """

    cells: int
    walls: float
    cells_per_metre: float
    near: float
    far: float | None
    thickness: float
    twice: float | None
    scans: int


def map_consistency(recording: Recording, trajectory: Trajectory, *, scans: Scans | None = None) -> MapConsistency:
    """Score a trajectory by the map that the scans of its recording draw under it; arguments as of ``scan_residuals``.

    Raises:
        InputError: no scans, fewer than two of them with a pose, or none that sees what another one saw.
    """
    lidar, index, poses = placed_scans(recording, trajectory)
    used = evenly(_spaced(poses), MAX_SCANS)
    synchronised = synchronise(recording).scans if scans is None else scans
    seen = [_surface(synchronised, lidar, int(index[scan]), poses[scan]) for scan in used]
    points, normals = (np.vstack(some) for some in zip(*seen, strict=True))
    owners = np.repeat(np.arange(len(used)), [len(some) for some, _ in seen])
    if not len(points):
        raise InputError("scans without an endpoint, expected some", field="lidar")
    path = travelled(poses)[0][used][owners]
    near, far, twice = _between_scans(points, normals, owners, path)
    if not len(near):
        raise InputError(f"no endpoint within {REACH:g} m of another scan's", field="trajectory")
    cells, walls = mean_cells(points, CELL), _length_seen(points, path)
    return MapConsistency(
        cells=round(cells),
        walls=walls,
        cells_per_metre=cells / walls,
        near=float(near.mean()),
        far=float(far.mean()) if len(far) else None,
        thickness=_thickness(points),
        twice=float((twice > TWICE).mean()) if len(twice) else None,
        scans=len(used),
    )


def _spaced(poses: Array) -> NDArray[np.intp]:
    """The poses to use of [n, 3]: the first, and each that is ``SPACING`` away from the one before."""
    kept = [0]
    for i, pose in enumerate(poses):
        off = pose - poses[kept[-1]]
        if np.hypot(off[0], off[1]) > SPACING or abs(se2.wrap(off[2])) > SPACING:
            kept.append(i)
    return np.array(kept)


def _surface(scans: Scans, lidar: LidarStream, index: int, pose: Array) -> tuple[Array, Array]:
    """Endpoints of a scan taken at a pose [3], and their normals towards the lidar, zero where unknown, [k, 2] each."""
    points, joined = surface_points(scans, lidar, index, pose)
    normals = np.zeros_like(points)
    if len(points) >= 3:
        both = joined[:-1] & joined[1:]
        along = points[2:][both] - points[:-2][both]
        across = np.column_stack((-along[:, 1], along[:, 0])) / np.maximum(np.hypot(*along.T), 1e-9)[:, None]
        inner = np.flatnonzero(both) + 1
        origin = se2.transform_points(pose, scans.origin[None])
        towards = np.sign((across * (origin - points[inner])).sum(axis=1))
        normals[inner] = across * towards[:, None]
    return points, normals


def _between_scans(points: Array, normals: Array, owners: NDArray[np.intp], path: Array) -> tuple[Array, Array, Array]:
    """Distances [m] of some endpoints to the nearest one of near scans, of far scans, and of far ones on the same side.

    Args:
        points, normals: [p, 2].
        owners: [p] the scan of each.
        path: [p] driven up to it [m].
    """
    from scipy.spatial import cKDTree

    chosen = evenly(np.arange(len(points)), SAMPLES)
    tree = cKDTree(points)
    near, far, twice = [], [], []
    for i, around in zip(chosen.tolist(), tree.query_ball_point(points[chosen], APART), strict=True):
        others = np.array(around)
        gap = np.abs(path[others] - path[i])
        distance = np.hypot(*(points[others] - points[i]).T)
        close = (gap < NEAR_PATH) & (owners[others] != owners[i]) & (distance < REACH)
        away = gap > FAR_PATH
        facing = away & (normals[others] @ normals[i] > SAME_FACING)
        away &= distance < REACH
        if close.any():
            near.append(distance[close].min())
        if away.any():
            far.append(distance[away].min())
        if facing.any():
            twice.append(distance[facing].min())
    return np.array(near), np.array(far), np.array(twice)


def _length_seen(points: Array, path: Array) -> float:
    """The length of the walls that points [p, 2] lie on, seen after that much path [p] [m]: see ``MapConsistency``."""
    counts = []
    for blocks in cells_of(points, BLOCK):
        order = np.lexsort((path, blocks))
        again = (np.diff(blocks[order]) != 0) | (np.diff(path[order]) > FAR_PATH)
        counts.append(1 + int(np.count_nonzero(again)))
    return float(np.mean(counts)) * BLOCK * CROFTON


def _thickness(points: Array) -> float:
    """The median standard deviation of the endpoints around one across their longest extent [m]."""
    from scipy.spatial import cKDTree

    chosen = evenly(np.arange(len(points)), SAMPLES // 4)
    spreads = []
    tree = cKDTree(points)
    for point in points[chosen]:
        around = tree.query_ball_point(point, AROUND)
        if len(around) >= FEWEST:
            off = points[around] - points[around].mean(axis=0)
            spreads.append(np.sqrt(max(np.linalg.eigvalsh(off.T @ off / len(off))[0], 0.0)))
    if not spreads:
        raise InputError(f"nowhere {counted(FEWEST, 'endpoint')} within {AROUND:g} m of each other", field="trajectory")
    return float(np.median(spreads))
