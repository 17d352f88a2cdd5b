"""The world a robot drives in: line segments that a lidar sees, solids, what keeps clear of them, and its true map.

A building as it is lived in (``lived_in``) is the same world with more segments and materials: walls that are not flat,
things along them, surfaces that swallow light. The robot's physics knows nothing of these: they keep clear of its path.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import ConfigError
from moteslam.robot.formats.map_server import FREE, OCCUPIED, UNKNOWN
from moteslam.robot.noise import Surroundings
from moteslam.robot.raster import Raster
from moteslam.robot.se2 import Array
from moteslam.robot.values import Summarised
from moteslam.sim.world.layout import Layout, Slippery, read_floor_plan, wall_segments
from moteslam.sim.world.pieces import MATERIALS, PLAIN, Block, Material, Polygon, Segments

if TYPE_CHECKING:
    from shapely import STRtree

    from moteslam.kernels.raycast import SegmentBuckets


@dataclass(frozen=True, eq=False, repr=False)
class World(Summarised):
    segments: Segments  # [m, 4] x0, y0, x1, y1 [m]: walls and the outlines of the solids
    solids: tuple[Polygon, ...] = ()  # polygons [k, 2] [m] of boxes, pillars and furniture
    surfaces: NDArray[np.int16] | None = None  # [m] of each segment the material, an index into palette; None if plain
    palette: Mapping[str, Material] = field(default_factory=lambda: {PLAIN: MATERIALS[PLAIN]})
    plan: Raster | None = None  # a floor plan's solid cells, as bools; their sides are among the segments
    hollows: tuple[Polygon, ...] = ()  # polygons [k, 2] [m] that nothing may stand in and beams see into: shelves
    slippery: tuple[Slippery, ...] = ()  # patches of floor where wheels grip less

    @classmethod
    def of(cls, layout: Layout) -> World:
        pieces = [piece for kind in layout.pieces.values() for piece in kind]
        parts = [(piece.segments(), piece.material) for piece in pieces]
        solids = [solid for piece in pieces if isinstance(piece, Block) for solid in piece.solids()]
        hollows = tuple(shelf.polygon() for shelf in layout.shelves)
        plan = None if layout.plan is None else read_floor_plan(layout.plan)
        if plan is not None:
            parts.append((wall_segments(plan), PLAIN))
        segments = np.concatenate([*(lines for lines, _ in parts), np.empty((0, 4))])
        segments.setflags(write=False)
        surfaces = None
        names = list(layout.palette)
        if any(material != PLAIN for _, material in parts) or PLAIN in layout.materials:
            surfaces = np.concatenate([np.full(len(lines), names.index(name), np.int16) for lines, name in parts])
        return cls(segments, tuple(solids), surfaces, layout.palette, plan, hollows, layout.slippery)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """The smallest and largest coordinates: x_min, y_min, x_max, y_max [m]."""
        x, y = self.segments[:, 0::2], self.segments[:, 1::2]
        return float(x.min()), float(y.min()), float(x.max()), float(y.max())

    def distance(self, points: ArrayLike) -> Array:
        """How far each point [n, 2] is from the nearest segment [m], shape [n]; infinite in an empty world."""
        import shapely

        points = np.asarray(points, np.float64).reshape(-1, 2)
        found = np.full(len(points), np.inf)
        (at, _), away = self._walls.query_nearest(shapely.points(points), return_distance=True, all_matches=False)
        found[at] = away
        return found

    def inside_solid(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Which of the points [n, 2] are inside a solid, a hollow or a plan's solid cell, shape [n].

        A point on an edge belongs to what lies above it or to the right of it.
        """
        import shapely

        points = np.asarray(points, np.float64).reshape(-1, 2)
        inside = np.zeros(len(points), bool)
        if self.plan is not None:
            inside |= self.plan.values_at(points, outside=False)
        inside[self._blocks.query(shapely.points(np.nextafter(points, np.inf)), predicate="intersects")[0]] = True
        return inside

    def is_free(self, points: ArrayLike, clearance: float) -> NDArray[np.bool_]:
        """Which of the points [n, 2] are outside solids and hollows and at least ``clearance`` [m] from every wall."""
        return (self.distance(points) >= clearance) & ~self.inside_solid(points)

    @cached_property
    def buckets(self) -> SegmentBuckets:
        """The segments, sorted for raycasting."""
        from moteslam.kernels.raycast import build_buckets

        return build_buckets(self.segments)

    @cached_property
    def _walls(self) -> STRtree:
        """The segments, to look up the nearest."""
        import shapely

        return shapely.STRtree(shapely.linestrings(self.segments.reshape(-1, 2, 2)))

    @cached_property
    def _blocks(self) -> STRtree:
        """The solids and hollows, to look up which of them a point is in."""
        import shapely

        return shapely.STRtree([shapely.Polygon(corners) for corners in (*self.solids, *self.hollows)])


MAX_SEGMENTS = 20_000  # Line segments in a world that a file spells out
MAX_PLAN_SEGMENTS = 400_000  # Line segments in a world with a floor plan
_SAMPLING = 0.05  # Between the points of a leg that are checked [m]


def check_world(world: World) -> None:
    """Refuse a world that is empty or too large."""
    if not len(world.segments):
        raise ConfigError("nothing stands in it, expected a wall, room, box, pillar, furniture or plan", field="world")
    limit = MAX_SEGMENTS if world.plan is None else MAX_PLAN_SEGMENTS
    if len(world.segments) > limit:
        raise ConfigError(f"{len(world.segments)} segments, expected at most {limit}", field="world")


def check_place(world: World, point: ArrayLike, radius: float, *, field: str, what: str) -> None:
    """Refuse a place in a wall or nearer to one than ``radius`` [m]; ``what`` is there."""
    away = 0.0 if world.inside_solid(point)[0] else float(world.distance(point)[0])
    if away < radius:
        x, y = np.asarray(point, np.float64)
        problem = f"{what} is {away:.2f} m from a wall at ({x:g}, {y:g}), expected at least {radius:.2f} m"
        raise ConfigError(problem, field=field)


def check_legs(world: World, corners: Array, clearance: float, *, field: str) -> None:
    """Refuse straight legs between waypoints [k, 2] with less than ``clearance`` [m] on both sides."""
    for i, (a, b) in enumerate(pairwise(corners)):
        samples = np.linspace(a, b, max(2, int(np.ceil(np.hypot(*(b - a)) / _SAMPLING)) + 1))
        free = world.is_free(samples, clearance)
        if not free.all():
            x, y = samples[np.argmin(free)]
            raise ConfigError(
                f"the leg to the next waypoint runs into a wall near ({x:.2f}, {y:.2f}), "
                f"expected {clearance:.2f} m clear on both sides",
                field=f"{field}.{i}",
            )


MAX_CELLS = 64_000_000  # Of a true map


def true_map(world: World, resolution: float, *, seen_from: ArrayLike, margin: float = 0.5) -> Raster:
    """Rasterise a world into `FREE`, `OCCUPIED` or `UNKNOWN` cells int8 [H, W] of a side ``resolution`` [m].

    A cell is occupied if a wall crosses it or its centre lies in a solid; free if it can be reached, from cell to
    cell across their sides, from where the robot was (``seen_from`` [n, 2] [m]); all others are unknown. The middles
    of cells are at multiples of the resolution, as walls of round lengths are; maps of one world lie on one another.
    """
    from scipy.ndimage import label

    if not (np.isfinite(resolution) and resolution > 0):
        raise ConfigError(f"{resolution}, expected a positive length [m]", field="resolution")
    points = np.asarray(seen_from, np.float64).reshape(-1, 2)
    x0, y0, x1, y1 = world.bounds
    low = np.minimum((x0, y0), points.min(0)) - margin
    high = np.maximum((x1, y1), points.max(0)) + margin
    first = np.rint(low / resolution).astype(np.int64)
    cols, rows = (np.rint(high / resolution).astype(np.int64) - first + 1).tolist()
    if cols * rows > MAX_CELLS:
        raise ConfigError(
            f"{cols} x {rows} cells of {resolution:g} m, expected at most {MAX_CELLS} in all", field="resolution"
        )
    origin = (first - 0.5) * resolution
    occupied = np.zeros((rows, cols), bool)
    for line in world.segments:
        cell = _crossed(line, resolution) - first
        occupied[cell[:, 1], cell[:, 0]] = True
    _fill_solids(world, occupied, origin, resolution)
    regions, _ = label(~occupied)
    at = np.rint(points / resolution).astype(np.int64) - first
    reached = np.unique(regions[at[:, 1], at[:, 0]])
    free = np.isin(regions, reached[reached > 0])
    values = np.where(occupied, OCCUPIED, np.where(free, FREE, UNKNOWN)).astype(np.int8)
    return Raster(values, float(resolution), (float(origin[0]), float(origin[1]), 0.0))


def _crossed(line: Array, size: float) -> NDArray[np.int64]:
    """Every cell (col, row) [n, 2] that a segment crosses: the middle of each piece between two cell sides."""
    a, b = line[:2] / size + 0.5, line[2:] / size + 0.5
    cuts = [np.array((0.0, 1.0))]
    for axis in (0, 1):
        low, high = sorted((a[axis], b[axis]))
        if high > low:
            sides = np.arange(np.ceil(low), np.floor(high) + 1)
            cuts.append(np.clip((sides - a[axis]) / (b[axis] - a[axis]), 0.0, 1.0))
    share = np.unique(np.concatenate(cuts))
    middle = (share[1:] + share[:-1]) / 2
    return np.asarray(np.floor(a + middle[:, None] * (b - a)), np.int64)


def _fill_solids(world: World, occupied: NDArray[np.bool_], origin: Array, size: float) -> None:
    """Mark the cells whose centres lie within solids; hollows stay free."""
    import shapely

    rows, cols = occupied.shape
    if world.plan is not None:
        centres = _centres(np.array((0, 0)), np.array((cols, rows)), origin, size)
        occupied |= world.plan.values_at(centres, outside=False).reshape(rows, cols)
    for polygon in world.solids:
        low = np.maximum(np.floor((polygon.min(0) - origin) / size), 0).astype(np.int64)
        high = np.minimum(np.ceil((polygon.max(0) - origin) / size), (cols, rows)).astype(np.int64)
        inside = shapely.contains_xy(shapely.Polygon(polygon), _centres(low, high, origin, size))
        occupied[low[1] : high[1], low[0] : high[0]] |= inside.reshape(high[1] - low[1], high[0] - low[0])


def _centres(low: NDArray[np.int64], high: NDArray[np.int64], origin: Array, size: float) -> Array:
    """The centres [n, 2] [m] of the cells from (col, row) ``low`` to before ``high``, row by row."""
    row, col = np.mgrid[low[1] : high[1], low[0] : high[0]]
    return np.asarray(np.stack((col.ravel(), row.ravel()), axis=-1) * size + origin + size / 2)


SHORTEST = 0.3  # Segments below this length are furniture or frames and stay as they are [m]
DEEPEST = 0.5  # That a thing stands out from its wall [m]
CLEARANCE = 0.05  # Between a thing and the robot's body [m]
SHADES = 12  # How many materials the reaches of plain surfaces are sorted into


def lived_in(world: World, settings: Surroundings, rng: np.random.Generator, *, path: Array, radius: float) -> World:
    """The world with relief, clutter and shades of grey; solids, hollows and slippery patches are the plan's.

    ``path`` [n, 2] is where the robot's centre was [m].
    """
    lines, owner = _in_relief(world.segments, settings, rng)
    things = _clutter(world.segments, settings, rng, path, radius + CLEARANCE)
    segments = np.concatenate((lines, things.reshape(-1, 4)))
    names = list(world.palette)
    surfaces = np.full(len(world.segments), names.index(PLAIN), np.int16) if world.surfaces is None else world.surfaces
    surfaces = np.concatenate((surfaces[owner], np.full(3 * len(things), names.index(PLAIN), np.int16)))
    groups = np.concatenate((owner, len(world.segments) + np.repeat(np.arange(len(things)), 3)))
    palette = dict(world.palette)
    if settings.reach > 0:
        surfaces, palette = _shaded(surfaces, palette, groups, settings, rng)
    segments.setflags(write=False)
    return replace(world, segments=segments, surfaces=surfaces if len(palette) > 1 else world.surfaces, palette=palette)


def _in_relief(
    segments: Segments, settings: Surroundings, rng: np.random.Generator
) -> tuple[Segments, NDArray[np.intp]]:
    """Long segments as polylines whose inner points stray from the line, and which segment each piece is of."""
    pieces, owner = [], []
    for index, (x0, y0, x1, y1) in enumerate(segments):
        length = float(np.hypot(x1 - x0, y1 - y0))
        count = max(1, round(length / settings.relief_length)) if length >= SHORTEST and settings.relief > 0 else 1
        share = np.linspace(0.0, 1.0, count + 1)
        off = np.zeros(count + 1)
        off[1:-1] = settings.relief * rng.standard_normal(max(0, count - 1))
        normal = np.array((y0 - y1, x1 - x0)) / max(length, 1e-12)
        points = np.outer(1 - share, (x0, y0)) + np.outer(share, (x1, y1)) + off[:, None] * normal
        pieces.append(np.concatenate((points[:-1], points[1:]), axis=1))
        owner += [index] * count
    return np.concatenate([*pieces, np.empty((0, 4))]), np.asarray(owner, np.intp)


def _clutter(segments: Segments, settings: Surroundings, rng: np.random.Generator, path: Array, clear: float) -> Array:
    """Things along the walls, each three segments [k, 3, 4] that stand out from one of its sides and back."""
    from scipy.spatial import cKDTree

    lengths = np.hypot(segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1])
    counts = rng.poisson(2 * settings.clutter * np.where(lengths >= SHORTEST, lengths, 0.0))
    wall = np.repeat(np.arange(len(segments)), counts)
    draws = rng.random((len(wall), 3))
    depth = np.minimum(rng.exponential(settings.clutter_depth, len(wall)) + 0.02, DEEPEST)
    width = np.minimum(rng.exponential(settings.clutter_width, len(wall)) + 0.03, lengths[wall])
    begin = draws[:, 0] * (lengths[wall] - width)
    start, along = segments[wall, :2], (segments[wall, 2:] - segments[wall, :2]) / lengths[wall, None]
    across = np.stack((-along[:, 1], along[:, 0]), axis=1) * np.where(draws[:, 1:2] < 0.5, 1.0, -1.0)
    slant = 1.0 - 0.5 * draws[:, 2]  # the far corner stands out less
    first, last = (start + at[:, None] * along for at in (begin, begin + width))  # at the wall
    corners = np.stack((first, first + depth[:, None] * across, last + (depth * slant)[:, None] * across, last), axis=1)
    things = np.concatenate((corners[:, :-1], corners[:, 1:]), axis=2)
    if not len(things):
        return things
    share = np.linspace(0.0, 1.0, 9)[:, None]
    outline = things[:, :, None, :2] * (1 - share) + things[:, :, None, 2:] * share
    near, _ = cKDTree(path).query(outline.reshape(-1, 2), distance_upper_bound=clear)
    return things[np.isinf(near).reshape(len(things), -1).all(axis=1)]


def _shaded(
    surfaces: NDArray[np.int16],
    palette: dict[str, Material],
    groups: NDArray[np.intp],
    settings: Surroundings,
    rng: np.random.Generator,
) -> tuple[NDArray[np.int16], dict[str, Material]]:
    """Plain surfaces sorted into shades, each with a reach; one shade a wall or thing."""
    from scipy.special import ndtri

    first, names = len(palette), list(palette)
    quantiles = ndtri((np.arange(SHADES) + 0.5) / SHADES)
    reaches = settings.reach * np.exp(settings.reach_spread * quantiles)
    shades = {f"shade {number}": Material(reach=float(reach)) for number, reach in enumerate(reaches)}
    shade = rng.integers(0, SHADES, int(groups.max(initial=0)) + 1)[groups]
    plain = surfaces == names.index(PLAIN)
    return np.where(plain, first + shade, surfaces).astype(np.int16), {**palette, **shades}
