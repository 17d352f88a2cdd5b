"""The world a robot drives in: line segments that a lidar sees, and solids that nothing can be inside of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.sim.floorplan import OccupiedGrid, read_floor_plan
from moteslam.sim.furniture import outline
from moteslam.sim.layout import Box, Layout, Pillar, Room, Segments, Wall
from moteslam.sim.materials import MATERIALS, PLAIN, Material

_CHUNK = 1_000_000
"""Point-segment pairs held in memory at a time."""


@dataclass(frozen=True, eq=False)
class World:
    """The standing parts of a scenario.

    Attributes:
        segments: [m, 4] x0, y0, x1, y1 [m]: walls and the outlines of the solids.
        solids: polygons [k, 2] [m] of boxes, pillars and furniture.
        hollows: polygons [k, 2] [m] that nothing may stand in and beams see into: shelves.
        surfaces: [m] what each segment is made of, an index into ``palette``; None where all is plain.
        palette: the materials.
        plan: a floor plan's solid cells; their sides are among the segments.
    """

    segments: Segments
    solids: tuple[NDArray[np.float64], ...] = ()
    surfaces: NDArray[np.int16] | None = None
    palette: tuple[Material, ...] = (MATERIALS[PLAIN],)
    plan: OccupiedGrid | None = None
    hollows: tuple[NDArray[np.float64], ...] = ()

    @classmethod
    def of(cls, layout: Layout) -> World:
        """The world that a layout describes.

        Raises:
            ConfigError: a floor plan that cannot be read.
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
            parts.append((plan.walls(), PLAIN))
        segments = np.concatenate([*(lines for lines, _ in parts), np.empty((0, 4))])
        segments.setflags(write=False)
        surfaces = None
        names = list(layout.palette)
        if any(material != PLAIN for _, material in parts) or PLAIN in layout.materials:
            surfaces = np.concatenate([np.full(len(lines), names.index(name), np.int16) for lines, name in parts])
        return cls(segments, tuple(solids), surfaces, tuple(layout.palette.values()), plan, hollows)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """The smallest and largest coordinates: x_min, y_min, x_max, y_max [m]."""
        x, y = self.segments[:, 0::2], self.segments[:, 1::2]
        return float(x.min()), float(y.min()), float(x.max()), float(y.max())

    def distance(self, points: ArrayLike) -> NDArray[np.float64]:
        """How far each point [n, 2] is from the nearest segment [m], shape [n]; infinite in an empty world."""
        points = np.asarray(points, np.float64).reshape(-1, 2)
        found = np.full(len(points), np.inf)
        if not len(self.segments):
            return found
        a, b = self.segments[:, :2], self.segments[:, 2:]
        along = b - a
        squared = np.maximum((along**2).sum(-1), 1e-300)
        step = max(1, _CHUNK // len(a))
        for i in range(0, len(points), step):
            offset = points[i : i + step, None] - a
            share = np.clip((offset * along).sum(-1) / squared, 0.0, 1.0)
            away = offset - share[..., None] * along
            found[i : i + step] = np.sqrt((away**2).sum(-1).min(1))
        return found

    def inside_solid(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Which of the points [n, 2] are inside a solid, a hollow (even-odd rule) or a plan's solid cell, shape [n]."""
        points = np.asarray(points, np.float64).reshape(-1, 2)
        inside = np.zeros(len(points), bool) if self.plan is None else self.plan.is_solid(points)
        x, y = points[:, :1], points[:, 1:]
        for polygon in (*self.solids, *self.hollows):
            (ax, ay), (bx, by) = polygon.T, np.roll(polygon, -1, axis=0).T
            straddles = (ay > y) != (by > y)
            with np.errstate(divide="ignore", invalid="ignore"):
                crossing = ax + (y - ay) / (by - ay) * (bx - ax)
            inside |= (straddles & (x < crossing)).sum(1) % 2 == 1
        return inside

    def is_free(self, points: ArrayLike, clearance: float) -> NDArray[np.bool_]:
        """Which of the points [n, 2] are outside solids and hollows and at least ``clearance`` [m] from every wall."""
        return (self.distance(points) >= clearance) & ~self.inside_solid(points)
