"""A map's cells as the distance field that all particles share, the places that are free in it, and its scale."""

import math

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.kernels.tiles import CELLS, EMPTY, FINE_CELLS, MAX_WEIGHT, SIDE, STEPS, WEIGHT_BITS, tile_store
from moteslam.robot import se2
from moteslam.robot.formats.map_server import FREE, OCCUPIED, UNKNOWN
from moteslam.robot.raster import Raster
from moteslam.robot.se2 import Array
from moteslam.robot.values import Issue, when
from moteslam.slam.mapping.config import LOST_DISTANCE, TsdfConfig
from moteslam.slam.mapping.tsdf import TsdfMaps
from moteslam.slam.rows import Rows

TO_SIDE = 0.6  # A direction that few walls lie along [rad]
THICK, THICKEST, CELLS_THICK = 0.07, 0.5, 1.5
"""Walls may be drawn too thick to either side from this to that on [m], and by so many cells, at least."""
CLEARANCE = 0.1  # A robot's lidar stands no nearer to a surface [m]


class KnownMaps(TsdfMaps):
    """The one map of all particles, of trinary cells [H, W]; scans change nothing in it.

    A cell's distance is that to the middle of the nearest occupied cell that has a neighbour which is not: known in all
    free cells, and as far as the truncation behind surfaces; what lies deeper in walls, or is unknown to the map, is
    unknown. The cell size and the truncations of the field are those of ``config``. A map without occupied cells, or
    without free ones, is refused.
    """

    def __init__(self, occupancy: Raster, config: TsdfConfig) -> None:
        super().__init__(config)
        self.occupancy = occupancy = upright(occupancy)
        self.surface = Surface(occupancy)
        left, right, bottom, top = occupancy.extent
        margin = config.coarse_truncation + self._tile_size
        low = np.floor((np.array((left, bottom)) - margin) / self._tile_size).astype(int)
        columns, rows = (np.ceil((np.array((right, top)) + margin) / self._tile_size).astype(int) - low).tolist()
        self._corner = low
        self._check_entries(1, rows, columns)
        fine, coarse = (
            self._cells(low * self._tile_size, rows, columns, level, truncation)
            for level, truncation in ((0, config.truncation), (1, config.coarse_truncation))
        )
        tiles = np.concatenate((fine, coarse), axis=1)
        used = np.flatnonzero((tiles & MAX_WEIGHT).any(axis=1))
        table = np.full(rows * columns, EMPTY, np.int32)
        table[used] = np.arange(1, len(used) + 1)
        pool = np.zeros((len(used) + 1, CELLS), np.int16)
        pool[1:] = tiles[used]
        self._store = tile_store(rows, columns, len(pool))
        self._store.fill(pool.reshape(-1), table)

    def _write(self, poses: Array, scans: object, part: range) -> None:
        """The map is known: nothing is written into it."""

    def _cells(self, corner: Array, rows: int, columns: int, level: int, truncation: float) -> NDArray[np.int16]:
        """The cells of a level, [tiles, cells of one]."""
        side, size = SIDE >> level, self.config.cell_size * (1 << level)
        x = corner[0] + (np.arange(columns * side) + 0.5) * size
        words = np.empty((rows * side, columns * side), np.int16)
        for row in range(rows * side):
            y = corner[1] + (row + 0.5) * size
            distance, known = self.surface.at(x, np.full_like(x, y))
            steps = np.rint(np.clip(distance / truncation, -1.0, 1.0) * STEPS).astype(np.int16)
            words[row] = np.where(known | (np.abs(distance) < truncation), (steps << WEIGHT_BITS) + MAX_WEIGHT, 0)
        tiles = words.reshape(rows, side, columns, side).swapaxes(1, 2)
        assert side * side == (FINE_CELLS >> (2 * level))
        return tiles.reshape(rows * columns, side * side)

    def free_squares(self, step: float) -> tuple[Array, NDArray[np.bool_]]:
        """Squares of two by two places of a lattice of which one at least is free, with ``CLEARANCE`` from surfaces.

        Returns [m, 2] the lowest place of each, neighbours in turn; and [m, 4] which of its places are free, x fastest.
        """
        low = np.array(self.occupancy.origin[:2]) + step / 2
        left, right, bottom, top = self.occupancy.extent
        columns, rows = (2 * math.ceil(wide / (2 * step)) for wide in (right - left, top - bottom))
        x, y = (
            corner + step * index.ravel()
            for corner, index in zip(low, np.meshgrid(np.arange(columns), np.arange(rows)), strict=True)
        )
        distance, _ = self.surface.at(x, y)
        free = self.surface.is_free(x, y) & (np.abs(distance) > CLEARANCE)
        if not free.any():
            raise InputError("no free cell, expected a map in which a robot can stand")
        fours = free.reshape(rows // 2, 2, columns // 2, 2).swapaxes(1, 2).reshape(-1, 4)
        row, column = np.divmod(np.flatnonzero(fours.any(axis=1)), columns // 2)
        order = np.lexsort((column, row, column // 4, row // 4))
        return low + 2 * step * np.stack((column, row), axis=1)[order], fours[fours.any(axis=1)][order]


class Surface:
    """Where the surfaces of a map are: the middles of occupied cells that have a neighbour which is not occupied."""

    def __init__(self, occupancy: Raster) -> None:
        from scipy.ndimage import binary_erosion, distance_transform_edt

        values, self._size = occupancy.values, occupancy.cell_size
        self._corner = np.array(occupancy.origin[:2])
        occupied = values == OCCUPIED
        inside = binary_erosion(occupied, np.ones((3, 3), bool), border_value=1)
        surface = occupied & ~inside
        if not surface.any():
            raise InputError("no occupied cell, expected a map with walls")
        self._known = (values != UNKNOWN) & ~inside
        self._free, self._occupied = values == FREE, occupied
        self._normals = _across(surface)
        self._nearest = distance_transform_edt(~surface, return_distances=False, return_indices=True).astype(np.int32)

    def _index(self, x: Array, y: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_]]:
        """Rows and columns of the cells at places, moved into the map, and which were in it."""
        rows, columns = self._known.shape
        column, row = (
            np.floor((a - b) / self._size).astype(np.intp) for a, b in zip((x, y), self._corner, strict=True)
        )
        within = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        return np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1), within

    def lines(self, x: Array, y: Array) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
        """The distances [n] from places to the line along which the nearest wall runs [m], how far along it from the
        nearest cell's middle [m], the direction [2, n] across it, in which the first grow, and which are in the map.
        """
        row, column, within = self._index(x, y)
        near_row, near_column = self._nearest[:, row, column]
        left, below = self._corner
        dx, dy = x - left - (near_column + 0.5) * self._size, y - below - (near_row + 0.5) * self._size
        across = self._normals[:, near_row, near_column].astype(float)
        return dx * across[0] + dy * across[1], dx * across[1] - dy * across[0], across, within

    def inside(self, x: Array, y: Array, u: Array, v: Array) -> Array:
        """How far rays [n] of directions (u, v) that end at places go through the wall there [m], 0 outside of any."""
        deep = np.zeros(len(x))
        through = np.ones(len(x), bool)
        for depth in np.arange(0.0, DEEP, self._size / 2):
            row, column, within = self._index(x - depth * u, y - depth * v)
            through &= within & self._occupied[row, column]
            deep[through] = depth
        return deep

    def at(self, x: Array, y: Array) -> tuple[Array, NDArray[np.bool_]]:
        """The distances [n] from places to the surface [m], negative on one side of it, and whether they are known."""
        row, column, _ = self._index(x, y)
        off, along, _, within = self.lines(x, y)
        return np.where(off < 0, -1, 1) * np.hypot(off, along), within & self._known[row, column]

    def is_free(self, x: Array, y: Array) -> NDArray[np.bool_]:
        """Which places [n] are free."""
        row, column, within = self._index(x, y)
        return np.asarray(within & self._free[row, column])


def _across(lines: NDArray[np.bool_]) -> NDArray[np.float32]:
    """The direction [2, H, W] across lines of cells: that of the strongest curvature where they are drawn blurred.

    Of the two the one within a quarter turn of ``TO_SIDE``: along a wall it is the same, so that the distance changes
    its sign there, and between cells it is zero where the wall is.
    """
    from scipy.ndimage import gaussian_filter

    drawn = lines.astype(np.float32)
    xx, xy, yy = (gaussian_filter(drawn, 1.0, order=order) for order in ((0, 2), (1, 1), (2, 0)))
    along = 0.5 * np.arctan2(2 * xy, xx - yy)
    angle = along + np.pi / 2 - TO_SIDE
    angle = np.where(np.cos(angle) < 0, angle + np.pi, angle) + TO_SIDE
    return np.stack((np.cos(angle), np.sin(angle)))


def thinned(occupancy: Raster) -> tuple[Raster, float] | None:
    """A trinary map with walls thinner by half of what most are thick, to either side, and without new gaps; and by how
    much that is [m]. None where it is little.
    """
    from scipy.ndimage import distance_transform_edt, maximum_filter

    occupied, size = occupancy.values == OCCUPIED, occupancy.cell_size
    deep = distance_transform_edt(occupied)
    middle = occupied & (deep == maximum_filter(deep, 3))
    by = float(np.median(deep[middle])) - 1 if middle.any() else 0.0
    if not max(THICK, CELLS_THICK * size) <= by * size <= THICKEST:
        return None
    values = np.where(occupied & ~middle & (deep <= by), FREE, occupancy.values)
    return Raster(values.astype(np.int8), size, occupancy.origin), by * size


def upright(occupancy: Raster) -> Raster:
    """A trinary map whose rows run along x, of the same cells: one that is turned is read anew, cell by cell."""
    x, y, yaw = occupancy.origin
    if yaw == 0:
        return occupancy
    (rows, columns), size = occupancy.shape, occupancy.cell_size
    c, s = math.cos(yaw), math.sin(yaw)
    ends = np.array(((0, 0), (columns, 0), (0, rows), (columns, rows))) @ np.array(((c, s), (-s, c)))
    low, high = np.floor(ends.min(axis=0) + 1e-6), np.ceil(ends.max(axis=0) - 1e-6)
    wide, tall = (high - low).astype(int).tolist()
    # in cells from its corner: after a quarter turn the centres of new cells are those of old ones
    u, v = np.meshgrid(low[0] + np.arange(wide) + 0.5, low[1] + np.arange(tall) + 0.5)
    column, row = np.floor(c * u + s * v).astype(int), np.floor(c * v - s * u).astype(int)
    within = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    values = np.where(within, occupancy.values[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)], UNKNOWN)
    return Raster(values.astype(np.int8), size, (x + float(low[0]) * size, y + float(low[1]) * size, 0.0))


DEEP = 0.8  # Rays are followed back so far to the face of the wall that they end in [m]
SPACING, MOST = 0.5, 256  # A scan is kept each so much path [m]; of so many every second, and the spacing doubles
POINTS = 128  # of a scan, evenly chosen
LEAST = 10  # Scans, at least; they are in as many parts of the path, as scans of one place err alike, ...
PARTS = 20  # ... at most in so many
SCALES = np.geomspace(0.5, 0.03, 20)
"""Cauchy's of the residuals [m], by iterations: a wrong scale displaces walls at first, cells at last; not people."""
SIGMAS, WRONG, BENT, NO_MAP = 5.0, 0.01, 0.02, 0.2
"""A scale is a map's fault at so many standard deviations, and where it is more than the second: lidars err by less.
Directions may differ by less than the third: walls of a sound SLAM map are turned by millimetres a metre. In a map that
is bent by more than the last nothing is found: too few walls are seen."""
ALONG = 15.0  # A direction within as much of an axis is called that [degrees]


SPAN, TORN, ASIDE = 1.0, 0.12, 7.0
"""Motions over so much path [m] are compared with the odometry's; the map is torn where they differ by more than the
second [m] and so many medians: in sound maps by up to 4.5."""


class MapTears:
    """Where the path of a robot that is sure of its pose steps aside from its odometry."""

    def __init__(self) -> None:
        self._rows = Rows(9)  # stamp, path driven and how often it was lost until then; pose; pose by odometry
        self._driven, self._lost, self._odometry = 0.0, 0, np.zeros(3)

    def add(self, stamp: float, pose: Array, motion: Array, *, known: bool) -> None:
        """A pose [3] at a stamp, ``known`` if that is sure, after a motion [3] by odometry."""
        self._odometry = np.asarray(se2.compose(self._odometry, motion))
        self._driven += float(np.hypot(*motion[:2]))
        self._lost += not known
        if known:
            self._rows.add(np.array([[stamp, self._driven, self._lost, *pose, *self._odometry]]))

    def issue(self) -> Issue | None:
        """Where it does, if anywhere."""
        stamps, driven, lost = self._rows.values[:, :3].T
        last = np.searchsorted(driven, driven + SPAN)
        first = np.flatnonzero(last < len(driven))
        last = last[first]
        first, last = (some[lost[first] == lost[last]] for some in (first, last))
        both = np.hsplit(self._rows.values[:, 3:], 2)
        in_map, by_odometry = (se2.between(poses[first], poses[last]) for poses in both)
        off = np.hypot(*(in_map - by_odometry)[:, :2].T)
        aside = off > max(TORN, ASIDE * float(np.median(off))) if len(off) >= LEAST else np.zeros(len(off), bool)
        if not aside.any():
            return None
        edges = np.flatnonzero(np.diff(aside, prepend=False, append=False)).reshape(-1, 2)
        spans = [(float(stamps[first[begin]]), float(stamps[last[end - 1]])) for begin, end in edges.tolist()]
        text = f"the path steps aside from its odometry by up to {off.max():.2f} m, {when(spans)}: the map is torn or "
        text += "doubled there (a loop is not closed), or lacks what is seen, and poses are off by more; or wheels slip"
        return Issue("step-contradicted", text, len(spans))


class MapScale:
    """The strain between a known map and the scans of a robot that is sure of its pose, by least squares.

    Endpoints lie ``(1 + strain) (p + offset u)`` from the robot's place, p being where the lidar says and u along the
    ray: the strain is symmetric, of which a stretch, a skew and a scale are cases; the offset is the thickness of walls
    as they are drawn. The poses of all scans are eliminated (Schur complement).
    """

    def __init__(self, maps: KnownMaps) -> None:
        self._maps, self._spacing, self._driven = maps, SPACING, SPACING
        self._scans: list[tuple[Array, Array, Array]] = []  # pose [3], endpoints and directions of their rays [k, 2]

    def add(self, pose: Array, points: NDArray[np.float32], origin: Array, driven: float, *, known: bool) -> None:
        """A scan [k, 2] whose rays start at an origin [2], from a pose [3] in the map; ``known`` if that is sure."""
        self._driven += driven
        if not known or self._driven < self._spacing or not len(points):
            return
        some = points[:: -(-len(points) // POINTS)].astype(float)
        rays = some - origin
        self._scans.append((pose.copy(), some, rays / np.maximum(np.hypot(*rays.T), 1e-6)[:, None]))
        self._driven = 0.0
        if len(self._scans) == MOST:
            self._scans, self._spacing = self._scans[::2], 2 * self._spacing

    def fit(self) -> tuple[Array, Array]:
        """The strain xx, yy, xy, the offset [m], and their covariance [4, 4]."""
        poses = np.array([scan[0] for scan in self._scans])
        points, rays = (np.concatenate([scan[k] for scan in self._scans]) for k in (1, 2))
        lengths = [len(scan[1]) for scan in self._scans]
        of, begin = np.repeat(np.arange(len(poses)), lengths), np.cumsum([0, *lengths[:-1]])
        strain, cells, near = np.zeros(4), self._maps.occupancy, None
        for scale in (*SCALES, SCALES[-1]):
            c, s = np.cos(poses[of, 2]), np.sin(poses[of, 2])
            (x, y), (u, v) = ((c * a - s * b, s * a + c * b) for a, b in (points.T, rays.T))
            xx, yy, xy, offset = strain
            at_x = poses[of, 0] + x + xx * x + xy * y + offset * u
            at_y = poses[of, 1] + y + xy * x + yy * y + offset * v
            deep = self._maps.surface.inside(at_x, at_y, u, v)
            residual, along, (n, m), known = self._maps.surface.lines(at_x - deep * u, at_y - deep * v)
            residual += deep * (n * u + m * v)
            known &= np.abs(along) < cells.cell_size  # not beside a wall's end
            near = np.abs(residual) < LOST_DISTANCE if near is None else near  # the rest may be furniture
            weight = (known & near) / (1 + np.square(residual / scale))
            row = np.stack((n, m, m * x - n * y, n * x, m * y, n * y + m * x, n * u + m * v, residual), axis=1)
            sums = np.add.reduceat(weight[:, None, None] * row[:, :7, None] * row[:, None], begin, axis=0)
            moved = np.linalg.solve(sums[:, :3, :3] + 1e-2 * np.eye(3), sums[:, :3, 3:])
            left = sums[:, 3:, 3:] - sums[:, :3, 3:7].swapaxes(1, 2) @ moved
            inverse = np.linalg.inv(left[..., :4].sum(axis=0) + 1e-6 * np.eye(4))
            change = -inverse @ left[..., 4].sum(axis=0)
            strain = strain + change
            poses = poses - moved[..., 4] - moved[..., :4] @ change
        parts = np.array([part.sum(axis=0) for part in np.array_split(left[..., 4], min(PARTS, len(left)))])
        spread = inverse @ parts.T
        covariance = spread @ spread.T * len(parts) / (len(parts) - 4)
        # Walls lie anywhere in their rows or columns of cells, each displaced as a whole
        steep = np.abs(n) >= np.abs(m)
        foot = np.where(steep, at_x - n * residual - cells.origin[0], at_y - m * residual - cells.origin[1])
        _, wall = np.unique(2 * np.floor(foot / cells.cell_size) + steep, return_inverse=True)
        force = weight[:, None] * (row[:, 3:7] - np.einsum("kp,kpg->kg", row[:, :3], moved[of, :, :4]))
        forces = np.array([np.bincount(wall, of_one) for of_one in force.T])
        spread = cells.cell_size / np.sqrt(12) * inverse @ forces
        return strain, covariance + spread @ spread.T

    def issue(self) -> Issue | None:
        """What is wrong with the map's scale, if it is certain."""
        if len(self._scans) < LEAST:
            return None
        strain, covariance = self.fit()
        stretch, skew = (strain[0] - strain[1]) / 2, strain[2]
        apart, turned = 2 * float(np.hypot(stretch, skew)), float(np.degrees(np.arctan2(skew, stretch)) / 2)
        of = np.array((stretch, -stretch, 2 * skew, 0.0)) / max(apart / 2, 1e-9)
        if np.abs(strain[:3]).max() > NO_MAP:
            return None
        if apart > max(BENT, SIGMAS * float(np.sqrt(of @ covariance @ of))):
            text = f"along {turned:.0f} degrees to its x than across: skewed or bent"
            if min(abs(turned), 90 - abs(turned)) < ALONG:
                text = f"along {'x than along y' if abs(turned) < 45 else 'y than along x'}: stretched"
            text = f"the map is {100 * apart:.1f} % longer {text}, by what the lidar measures, and poses in it with it"
            return Issue("map-scale", text)
        weight = np.linalg.inv(covariance[:2, :2]).sum(axis=0)  # of each direction in the scale of both
        percent = 100 * float(weight @ strain[:2] / weight.sum())
        if abs(percent) < 100 * max(WRONG, SIGMAS * float(weight.sum() ** -0.5)):
            thick, about = -float(strain[3]), float(np.sqrt(covariance[3, 3]))
            if thick < max(THICK, CELLS_THICK * self._maps.occupancy.cell_size, SIGMAS * about):
                return None
            text = f"walls of the map are {100 * thick:.0f} +-{196 * about:.0f} cm nearer on all sides than the lidar "
            text += "measures: they are drawn too thick, and poses may be off by as much, or its ranges are too long"
            return Issue("map-scale", text)
        text = f"the map is {abs(percent):.1f} % {'larger' if percent > 0 else 'smaller'} than the lidar measures: its "
        text += "resolution is not as stated, and poses are wrong by as much, or the lidar's ranges are"
        return Issue("map-scale", text)
