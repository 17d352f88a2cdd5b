"""The world a robot drives in: line segments that a lidar sees, solids, and what keeps clear of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import ConfigError
from moteslam.robot.raster import Raster
from moteslam.robot.values import Summarised
from moteslam.sim.world.floor_plan import read_floor_plan, wall_segments
from moteslam.sim.world.layout import Layout, Slippery
from moteslam.sim.world.pieces import MATERIALS, PLAIN, Block, Material, Polygon, Segments

if TYPE_CHECKING:
    from shapely import STRtree


@dataclass(frozen=True, eq=False, repr=False)
class World(Summarised):
    """The standing parts of a scenario.

    Attributes:
        segments: [m, 4] x0, y0, x1, y1 [m]: walls and the outlines of the solids.
        solids: polygons [k, 2] [m] of boxes, pillars and furniture.
        surfaces: [m] what each segment is made of, an index into ``palette``; None where all is plain.
        plan: a floor plan's solid cells, as bools; their sides are among the segments.
        hollows: polygons [k, 2] [m] that nothing may stand in and beams see into: shelves.
        slippery: patches of floor where wheels grip less.
    """

    segments: Segments
    solids: tuple[Polygon, ...] = ()
    surfaces: NDArray[np.int16] | None = None
    palette: Mapping[str, Material] = field(default_factory=lambda: {PLAIN: MATERIALS[PLAIN]})
    plan: Raster | None = None
    hollows: tuple[Polygon, ...] = ()
    slippery: tuple[Slippery, ...] = ()

    @classmethod
    def of(cls, layout: Layout) -> World:
        """The world that a layout describes."""
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

    def distance(self, points: ArrayLike) -> NDArray[np.float64]:
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
    def _walls(self) -> STRtree:
        """The segments, to look up the nearest."""
        import shapely

        return shapely.STRtree(shapely.linestrings(self.segments.reshape(-1, 2, 2)))

    @cached_property
    def _blocks(self) -> STRtree:
        """The solids and hollows, to look up which of them a point is in."""
        import shapely

        return shapely.STRtree([shapely.Polygon(corners) for corners in (*self.solids, *self.hollows)])


MAX_SEGMENTS = 20_000
"""Line segments in a world that a file spells out."""

MAX_PLAN_SEGMENTS = 400_000
"""Line segments in a world with a floor plan."""

_SAMPLING = 0.05
"""Between the points of a leg that are checked [m]."""


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


def check_legs(world: World, corners: NDArray[np.float64], clearance: float, *, field: str) -> None:
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
