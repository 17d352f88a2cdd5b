"""The world a robot drives in: line segments that a lidar sees, and solids that nothing can be inside of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.robot.raster import Raster
from moteslam.robot.values import Summarised
from moteslam.sim.world.blocks import Box, Pillar
from moteslam.sim.world.floor_plan import read_floor_plan
from moteslam.sim.world.geometry import Polygon, Segments, outline
from moteslam.sim.world.layout import Layout, Slippery
from moteslam.sim.world.materials import MATERIALS, PLAIN, Material
from moteslam.sim.world.tracing import wall_segments
from moteslam.sim.world.walls import Room, Wall

if TYPE_CHECKING:
    from shapely import STRtree


@dataclass(frozen=True, eq=False, repr=False)
class World(Summarised):
    """The standing parts of a scenario.

    Attributes:
        segments: [m, 4] x0, y0, x1, y1 [m]: walls and the outlines of the solids.
        solids: polygons [k, 2] [m] of boxes, pillars and furniture.
        surfaces: [m] what each segment is made of, an index into ``palette``; None where all is plain.
        palette: the materials by name.
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
        """The world that a layout describes.

        Raises:
            InputError: a floor plan that cannot be read.
        """
        around: list[Wall | Room] = [*layout.walls, *layout.rooms]
        blocks: list[Box | Pillar] = [*layout.boxes, *layout.pillars]
        parts = [(piece.segments(), piece.material) for piece in around]
        parts += [(outline(piece.polygon()), piece.material) for piece in blocks]
        solids = [piece.polygon() for piece in blocks]
        for stand in (*layout.tables, *layout.chairs):
            parts += [(outline(leg), stand.material) for leg in stand.polygons()]
            solids += stand.polygons()
        for shelf in layout.shelves:
            parts.append((shelf.segments(), shelf.material))
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
