"""The map against the true one; and whether the map that the scans draw under a trajectory has thin walls."""

from dataclasses import dataclass

import numpy as np

from moteslam.errors import InputError
from moteslam.eval.metrics.association import Indices, evenly, placed_scans, travelled, tree_of
from moteslam.eval.metrics.residuals import surface_points
from moteslam.robot import se2
from moteslam.robot.formats.map_server import FREE, OCCUPIED, UNKNOWN
from moteslam.robot.raster import Raster, cell_counts, cells_of
from moteslam.robot.recording import LidarStream, Recording
from moteslam.robot.se2 import IDENTITY, Array, Poses
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import counted, expect_type
from moteslam.slam.inputs.scans import Scans

SAME_WALL, FARTHEST = 0.1, 1.0
"""Walls closer to each other than this are the same wall; no wall cell counts as farther from the other map's [m]."""


@dataclass(frozen=True)
class MapAccuracy:
    """A map against the true map: the metrics ``map_precision`` to ``map_known``, how many cells are edges of the map's
    walls, how many cells of the true surface were seen, and as ``alike`` the share of these edges, where the true map
    is known, that are at an edge of a true wall: also of two maps with thick walls, and of more than was seen.
    """

    precision: float
    recall: float
    f1: float
    distance: float
    free_iou: float
    known: float
    walls: int
    surface: int
    alike: float


def map_accuracy(
    estimate: Raster, truth: Raster, *, transform: Poses = IDENTITY, seen: Array | None = None
) -> MapAccuracy:
    """Score a map by the true one, values [H, W] of ``FREE``, ``OCCUPIED`` or ``UNKNOWN``, of any cell size each.

    The map's walls are the edges of its occupied areas, the true surface are the true wall cells beside free ones:
    nobody sees the inside of a wall. ``transform`` [3] is the pose of the estimate's frame in the true one, as
    ``absolute_trajectory_error`` finds it. With what the lidar saw, ``seen`` [p, 2] in the true frame, recall is over
    the surface within ``SAME_WALL`` of a point of it.
    """
    from scipy.ndimage import binary_dilation, binary_erosion

    for raster, name in ((estimate, "estimate"), (truth, "truth")):
        expect_type(raster, Raster, name, "read_map(path) reads one")
        if raster.values.ndim != 2 or not np.isin(raster.values, (FREE, OCCUPIED, UNKNOWN)).all():
            raise InputError("values beside free, occupied and unknown, expected a trinary map", field=name)
    everywhere = truth.centres(np.argwhere((truth.values == OCCUPIED) & binary_dilation(truth.values == FREE)))
    surface = everywhere if seen is None else everywhere[_distances(everywhere, seen) <= SAME_WALL]
    edges, true_edges = (
        one.centres(np.argwhere((one.values == OCCUPIED) & ~binary_erosion(one.values == OCCUPIED)))
        for one in (estimate, truth)
    )
    walls = se2.transform_points(transform, edges)
    for points, name in ((walls, "estimate"), (surface, "truth")):
        if not len(points):
            raise InputError("no wall that was seen" if name == "truth" else "no wall", field=name)
    to_truth, to_map = _distances(walls, everywhere), _distances(surface, walls)
    precision, recall = float((to_truth <= SAME_WALL).mean()), float((to_map <= SAME_WALL).mean())
    at_edges = _distances(walls, true_edges) <= SAME_WALL
    is_known = at_edges | (truth.values_at(walls, outside=UNKNOWN) != UNKNOWN)
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
        alike=float(at_edges[is_known].mean()) if is_known.any() else 0.0,
    )


def _distances(points: Array, others: Array) -> Array:
    """Of points [n, 2] to the nearest of others [m, 2], at most ``FARTHEST``: [n] [m]."""
    return np.minimum(tree_of(others).query(points, distance_upper_bound=FARTHEST)[0], FARTHEST)


SPACING, MAX_SCANS = 0.3, 5000
"""A scan is used once the robot has moved by this much [m], or turned by as many radians, since the last one used; of
more than so many an even choice."""
CELL, BLOCK = 0.05, 1.0  # Edges of the cells, and of the blocks by which walls are measured [m]
CROFTON = np.pi / 4
"""Metres of a straight line in each metre of the squares that it meets, in the mean over its directions."""
SAMPLES = 8000  # Endpoints that are compared with those of other scans, spread evenly over all
NEAR_PATH, FAR_PATH, REACH = 6.0, 15.0, 0.4
"""Scans less than the first and more than the second of path apart are compared [m], where endpoints are this near."""
TWICE, APART, SAME_FACING = 0.1, 1.0, 0.8
"""A wall is drawn twice where the nearest endpoint on the same side of it, more than ``FAR_PATH`` away, is farther than
the first and nearer than the second [m]: the cosine between their normals is larger than the third."""
AROUND, FEWEST = 0.15, 10
"""A wall's thickness is measured over the endpoints within this distance of one [m], where there are at least
this many."""


@dataclass(frozen=True)
class MapConsistency:
    """The sharpness of the map that the scans draw: the metrics ``map_cells`` to ``map_twice``.

    ``walls`` is the length of the walls that were seen [m], counted again where they are seen again after ``FAR_PATH``:
    so it hardly depends on where the trajectory draws them. ``far`` and ``twice`` are None without a place seen again.
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
    """Score a trajectory by the map that its recording's scans draw under it; arguments as of ``scan_residuals``."""
    lidar, index, poses, scans = placed_scans(recording, trajectory, scans)
    kept = [0]  # poses, each ``SPACING`` away from the one before
    for i, pose in enumerate(poses):
        off = pose - poses[kept[-1]]
        if np.hypot(off[0], off[1]) > SPACING or abs(se2.wrap(off[2])) > SPACING:
            kept.append(i)
    used = evenly(np.array(kept), MAX_SCANS)
    seen = [_surface(scans, lidar, int(index[scan]), poses[scan]) for scan in used]
    points, normals = (np.vstack(some) for some in zip(*seen, strict=True))
    owners = np.repeat(np.arange(len(used)), [len(some) for some, _ in seen])
    if not len(points):
        raise InputError("scans without an endpoint, expected some", field="lidar")
    path = travelled(poses)[0][used][owners]
    near, far, twice = _between_scans(points, normals, owners, path)
    if not len(near):
        raise InputError(f"no endpoint within {REACH:g} m of another scan's", field="trajectory")
    counts = []  # blocks that were seen, again after ``FAR_PATH``: see ``MapConsistency``
    for blocks in cells_of(points, BLOCK):
        order = np.lexsort((path, blocks))
        again = (np.diff(blocks[order]) != 0) | (np.diff(path[order]) > FAR_PATH)
        counts.append(1 + int(np.count_nonzero(again)))
    cells, walls = float(cell_counts(points, CELL).mean()), float(np.mean(counts)) * BLOCK * CROFTON
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


def _surface(scans: Scans, lidar: LidarStream, index: int, pose: Array) -> tuple[Array, Array]:
    """Endpoints of a scan taken at a pose [3], and their normals towards the lidar, zero where unknown, [k, 2] each."""
    points, joined = surface_points(scans, lidar, index, pose)
    normals = np.zeros_like(points)
    both = joined[:-1] & joined[1:]
    along = points[2:][both] - points[:-2][both]
    across = np.column_stack((-along[:, 1], along[:, 0])) / np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    inner = np.flatnonzero(both) + 1
    origin = se2.transform_points(pose, scans.origin[None])
    towards = np.sign((across * (origin - points[inner])).sum(axis=1))
    normals[inner] = across * towards[:, None]
    return points, normals


def _between_scans(points: Array, normals: Array, owners: Indices, path: Array) -> tuple[Array, Array, Array]:
    """Distances [m] of some endpoints [p, 2] with normals [p, 2], each of a scan [p] after some path [p] [m], to the
    nearest one of near scans, of far scans, and of far ones on the same side.
    """
    chosen = evenly(np.arange(len(points)), SAMPLES)
    tree = tree_of(points)
    found: tuple[list[float], list[float], list[float]] = ([], [], [])
    for i, around in zip(chosen.tolist(), tree.query_ball_point(points[chosen], APART), strict=True):
        others = np.array(around)
        gap = np.abs(path[others] - path[i])
        distance = np.hypot(*(points[others] - points[i]).T)
        near = (gap < NEAR_PATH) & (owners[others] != owners[i]) & (distance < REACH)
        facing = (gap > FAR_PATH) & (normals[others] @ normals[i] > SAME_FACING)
        for distances, those in zip(found, (near, (gap > FAR_PATH) & (distance < REACH), facing), strict=True):
            if those.any():
                distances.append(float(distance[those].min()))
    near_by, far, twice = map(np.array, found)
    return near_by, far, twice


def _thickness(points: Array) -> float:
    """The median standard deviation of the endpoints around one across their longest extent [m]."""
    chosen = evenly(np.arange(len(points)), SAMPLES // 4)
    spreads = []
    tree = tree_of(points)
    for point in points[chosen]:
        around = tree.query_ball_point(point, AROUND)
        if len(around) >= FEWEST:
            off = points[around] - points[around].mean(axis=0)
            spreads.append(np.sqrt(max(np.linalg.eigvalsh(off.T @ off / len(off))[0], 0.0)))
    if not spreads:
        raise InputError(f"nowhere {counted(FEWEST, 'endpoint')} within {AROUND:g} m of each other", field="trajectory")
    return float(np.median(spreads))
