"""Furniture of random buildings: boxes, pillars, tables and chairs that stand in free space and clear of the route."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from moteslam.sim.world.blocks import Box, Pillar
from moteslam.sim.world.furniture import Chair, Table
from moteslam.sim.world.geometry import Polygon

if TYPE_CHECKING:
    from shapely import Geometry

AREA_PER_PIECE = 12.0
"""Free area for which one piece is placed at density 1 [m^2]."""
ATTEMPTS = 8
"""Places tried for a piece before it is left out."""
CLEAR_OF_ROUTE = 0.65
"""Distance of clutter from the route [m]: half a robot's diagonal, and what it cuts corners by."""
CLEAR_OF_REVERSAL, REVERSAL_REACH = 0.95, 1.5
"""Distance of clutter [m] from the route where it turns back, and up to how far from there [m]: the robot swings out by
half a metre as it turns (at most 0.49 m in 30 buildings, 0.23 m elsewhere)."""
KINDS = ("boxes", "boxes", "pillars", "tables", "chairs")
"""Drawn from with equal probability: every second piece or so is a box."""


def place_clutter(
    free: NDArray[np.bool_],
    corner: NDArray[np.float64],
    cell: float,
    route: NDArray[np.float64],
    rng: np.random.Generator,
    density: float,
) -> dict[str, list[dict[str, Any]]]:
    """Place furniture so that it overlaps neither walls, nor the route's clearance, nor other furniture.

    Args:
        free: [rows, columns] which cells are free space.
        corner: [2] of cell [0, 0] [m].
        cell: side of a cell [m].
        route: [k, 2] waypoints [m].
        rng: of kinds, places and sizes.
        density: 1 is a piece in 12 square metres of free space; fewer where there is no room for them.

    Returns:
        the tables of a world, as TOML gives them: ``boxes``, ``pillars``, ``tables`` and ``chairs``.
    """
    import shapely

    room = _free_space(free, corner, cell).difference(_swept(route))
    shapely.prepare(room)
    pieces: dict[str, list[dict[str, Any]]] = {kind: [] for kind in KINDS}
    standing: list[Geometry] = []
    cells = np.argwhere(free)
    for _ in range(round(density * len(cells) * cell**2 / AREA_PER_PIECE)):
        for _ in range(ATTEMPTS):
            row, column = cells[int(rng.integers(len(cells)))]
            kind, piece = _draw_piece(corner + (np.array((column, row)) + 0.5) * cell, rng)
            outline = shapely.Polygon(_outline(kind, piece))
            if room.covers(outline) and not any(outline.intersects(other) for other in standing):
                pieces[kind].append(piece)
                standing.append(outline)
                break
    return pieces


def _swept(route: NDArray[np.float64]) -> Geometry:
    """The area that is kept clear for the robot along its route [k, 2]."""
    import shapely

    line = shapely.LineString(route)
    back, on = route[:-2] - route[1:-1], route[2:] - route[1:-1]
    reversals = route[1:-1][(back * on).sum(axis=1) > 0.5 * np.hypot(*back.T) * np.hypot(*on.T)]
    near = shapely.buffer(shapely.points(reversals), REVERSAL_REACH)
    turns = [line.intersection(disc).buffer(CLEAR_OF_REVERSAL) for disc in near]
    return shapely.union_all([line.buffer(CLEAR_OF_ROUTE), *turns])


def _free_space(free: NDArray[np.bool_], corner: NDArray[np.float64], cell: float) -> Geometry:
    """The free cells as one polygon [m]: the union of the runs of free cells in each row."""
    import shapely

    steps = np.diff(np.pad(free.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    rows, begin = np.nonzero(steps == 1)
    _, end = np.nonzero(steps == -1)
    x, y = corner
    return shapely.union_all(
        shapely.box(x + begin * cell, y + rows * cell, x + end * cell, y + (rows + 1) * cell), grid_size=cell / 1000
    )


def _draw_piece(centre: NDArray[np.float64], rng: np.random.Generator) -> tuple[str, dict[str, Any]]:
    """The kind of a piece and its table, with a random size and angle."""
    kind = KINDS[int(rng.integers(len(KINDS)))]
    size = rng.uniform(0.25, 1.0, 2).round(2)
    angle = round(float(rng.choice((0.0, 0.0, rng.uniform(-1.5, 1.5)))), 3)
    place = {"centre": centre.round(3).tolist()}
    if kind == "pillars":
        return kind, {**place, "radius": round(float(size[0]) / 2, 3)}
    if kind == "chairs":
        return kind, {**place, "angle": angle}
    if kind == "tables":
        size = size + 0.5
    return kind, {**place, "angle": angle, "size": size.round(2).tolist()}


def _outline(kind: str, piece: dict[str, Any]) -> Polygon:
    """The area [k, 2] [m] that a piece takes on the floor; of tables and chairs, the area between their legs too."""
    if kind == "pillars":
        return Pillar.model_validate(piece).polygon()
    if kind == "boxes":
        return Box.model_validate(piece).polygon()
    return (Chair if kind == "chairs" else Table).model_validate(piece).board()
