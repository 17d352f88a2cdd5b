"""Random buildings: corridors of several widths between the points of an uneven lattice, and furniture, by a seed.

Free space is a union of rectangles on a raster of 0.1 m, so it is connected as the lattice's spanning tree is, and
its walls are exactly the raster's sides. The route follows the corridors' centre lines; furniture stands in free
space and clear of it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.se2 import Array
from moteslam.sim.world.layout import equal_runs, trace_sides
from moteslam.sim.world.pieces import Block, Box, Chair, Pillar, Table

if TYPE_CHECKING:
    from shapely import Geometry


CELL = 0.1  # Of the raster [m]
WIDTHS = (1.6, 2.0, 2.4, 3.0)  # Of corridors [m]
DISTANCE = 90.0  # To drive at least [m]
ROOMS = 0.35  # Share of the corridors' ends and crossings that widen to a room, and of corridors with a side room
RING_SHARE = 0.25  # Of the corridors that the spanning tree does without, the share that is built: each closes a ring
NAME = "random-corridors"

Node = tuple[int, int]
Edge = tuple[Node, Node]


@dataclass
class _Building:
    x: Array  # of the lattice's columns [m]
    y: Array  # of its rows [m]
    edges: dict[Edge, float] = field(default_factory=dict)  # corridors between neighbouring nodes and their widths [m]
    # x0, y0, x1, y1 [m] of free space, and whether each is free or filled again
    rectangles: list[tuple[float, float, float, float, bool]] = field(default_factory=list)

    def place(self, node: Node) -> Array:
        """Where a node is [2] [m]."""
        return np.array((self.x[node[0]], self.y[node[1]]))

    def at(self, node: Node) -> list[Node]:
        """The nodes that corridors lead to from here."""
        return [b if a == node else a for a, b in self.edges if node in (a, b)]

    def carve(self, x0: float, y0: float, x1: float, y1: float, *, free: bool = True) -> None:
        self.rectangles.append((x0, y0, x1, y1, free))


def random_corridors(seed: int) -> dict[str, Any]:
    """A building of corridors and a route through it, as the table of a scenario for ``parse_scenario``."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0x5EED,)))
    columns, rows = int(rng.integers(3, 6)), int(rng.integers(2, 5))
    gaps = [rng.uniform(6.0, 11.0, count - 1).round(1) for count in (columns, rows)]
    x, y = (np.concatenate(([0.0], np.cumsum(gap))).round(1) for gap in gaps)
    building = _Building(x, y)
    _connect(building, rng)
    _carve_all(building, rng)
    route = _route(building, rng)
    free, corner = _raster(building)
    walls = trace_sides(free) * CELL + np.tile(corner, 2)
    legs = float(np.hypot(*np.diff(route, axis=0).T).sum())
    return {
        "name": f"{NAME}-{seed}",
        "description": f"A random building of {len(building.edges)} corridors, number {seed}.",
        "why": "Corridors of several widths, crossings, rooms and clutter, all by the seed: nothing was tuned on them.",
        "seed": seed,
        "duration": min(1800.0, 60.0 + 2.5 * legs),
        "world": {
            "walls": [{"points": [line[:2], line[2:]]} for line in walls.round(3).tolist()],
            **_furniture(free, corner, route, rng),
        },
        "route": {"waypoints": route.round(3).tolist()},
    }


def _connect(building: _Building, rng: np.random.Generator) -> None:
    """Corridors along a random spanning tree of the lattice, and a few more that make rings."""
    columns, rows = len(building.x), len(building.y)
    edges = [((i, j), (i + 1, j)) for i in range(columns - 1) for j in range(rows)]
    edges += [((i, j), (i, j + 1)) for i in range(columns) for j in range(rows - 1)]
    roots = {node: node for edge in edges for node in edge}

    def root(node: Node) -> Node:
        while roots[node] != node:
            node = roots[node]
        return node

    for k in rng.permutation(len(edges)):  # Kruskal's algorithm
        a, b = (root(node) for node in edges[k])
        if a != b or rng.random() < RING_SHARE:
            roots[a] = b
            building.edges[edges[k]] = float(rng.choice(WIDTHS))


def _carve_all(building: _Building, rng: np.random.Generator) -> None:
    """Carve the corridors, crossings, rooms, niches and side rooms; fill pilasters."""
    pilasters = []
    for (a, b), width in building.edges.items():
        (x0, y0), (x1, y1) = building.place(a), building.place(b)
        half = width / 2
        building.carve(x0 - half, y0 - half, x1 + half, y1 + half)
        along, length = (0, x1 - x0) if y0 == y1 else (1, y1 - y0)

        def piece(begin: float, span: float, low: float, high: float) -> tuple[float, float, float, float]:
            """A rectangle: its begin and span along the corridor's centre line, and two distances to the left of it."""
            if along == 0:  # noqa: B023 - called within the loop alone
                return x0 + begin, y0 + low, x0 + begin + span, y0 + high  # noqa: B023
            return x0 - high, y0 + begin, x0 - low, y0 + begin + span  # noqa: B023

        for _ in range(int(rng.integers(1, 5))):
            span, begin = rng.uniform(0.4, 1.3), rng.uniform(1.5, max(1.6, length - 3.0))
            side = 1.0 if rng.random() < 0.5 else -1.0
            if width >= 2.0 and rng.random() < 0.35:
                low, high = sorted((side * half, side * (half - 0.2)))
                pilasters.append(piece(begin, min(span, 0.5), low, high))
            else:
                low, high = sorted((side * (half - 0.1), side * (half + rng.uniform(0.2, 0.7))))
                building.carve(*piece(begin, span, low, high))
        if rng.random() < ROOMS:
            side, depth = (1.0 if rng.random() < 0.5 else -1.0), rng.uniform(2.4, 4.0)
            begin, span = rng.uniform(0.5, 1.5), rng.uniform(2.4, 4.0)
            low, high = sorted((side * (half + 0.2), side * (half + 0.2 + depth)))
            building.carve(*piece(begin, span, low, high))
            low, high = sorted((side * (half - 0.1), side * (half + 0.3)))
            building.carve(*piece(begin + rng.uniform(0.2, span - 1.2), 1.0, low, high))
    for i in range(len(building.x)):
        for j in range(len(building.y)):
            x, y = building.place((i, j))
            dead_end = len(building.at((i, j))) == 1
            if rng.random() < ROOMS or dead_end:
                west, south, east, north = rng.uniform(1.2, 1.6 if dead_end else 3.0, 4)
                building.carve(x - west, y - south, x + east, y + north)
    for x0, y0, x1, y1 in pilasters:
        building.carve(x0, y0, x1, y1, free=False)


def _route(building: _Building, rng: np.random.Generator) -> Array:
    """A walk along the corridors [k, 2] [m] that prefers those least walked, and turns back only at dead ends."""
    nodes = sorted({node for edge in building.edges for node in edge})
    here = nodes[int(rng.integers(len(nodes)))]
    walk, walked, length = [here], dict.fromkeys(building.edges, 0), 0.0
    while length < DISTANCE:
        options = building.at(here)
        if len(options) > 1 and len(walk) > 1:
            options = [node for node in options if node != walk[-2]]
        times = [walked[min(here, node), max(here, node)] for node in options]
        options = [node for node, count in zip(options, times, strict=True) if count == min(times)]
        there = options[int(rng.integers(len(options)))]
        walked[min(here, there), max(here, there)] += 1
        length += float(np.hypot(*(building.place(there) - building.place(here))))
        walk.append(there)
        here = there
    return np.array([building.place(node) for node in walk])


def _raster(building: _Building) -> tuple[NDArray[np.bool_], Array]:
    """The free cells [rows, cols], and where the corner of cell [0, 0] is [m]."""
    rectangles = np.array([rectangle[:4] for rectangle in building.rectangles])
    corner = np.floor(rectangles[:, :2].min(0) / CELL).astype(int) - 2
    size = np.ceil(rectangles[:, 2:].max(0) / CELL).astype(int) + 2 - corner
    free = np.zeros((size[1], size[0]), bool)
    for x0, y0, x1, y1, is_free in building.rectangles:
        (left, low), (right, high) = (np.round(np.array(p) / CELL).astype(int) - corner for p in ((x0, y0), (x1, y1)))
        free[low:high, left:right] = is_free
    return free, corner * CELL


AREA_PER_PIECE = 12.0  # Free area for which one piece of furniture is placed, if there is room [m^2]
ATTEMPTS = 8  # Places tried for a piece before it is left out
CLEAR_OF_ROUTE = 0.65  # Distance of clutter from the route [m]: half a robot's diagonal, and what it cuts corners by
CLEAR_OF_REVERSAL, REVERSAL_REACH = 0.95, 1.5
"""Distance of clutter [m] from the route where it turns back, and up to how far from there [m]: the robot swings out by
half a metre as it turns (at most 0.49 m in 30 buildings, 0.23 m elsewhere)."""
KINDS = ("boxes", "boxes", "pillars", "tables", "chairs")  # Drawn from with equal probability: two of five are boxes


def _furniture(
    free: NDArray[np.bool_], corner: Array, route: Array, rng: np.random.Generator
) -> dict[str, list[dict[str, Any]]]:
    """Furniture that overlaps neither walls, nor the clearance of a route [k, 2], nor other furniture: tables of a
    world.

    ``free`` [rows, columns] is free space, whose cell [0, 0] has its corner [2] there [m].
    """
    import shapely

    room = _free_space(free, corner).difference(swept(route))
    shapely.prepare(room)
    pieces: dict[str, list[dict[str, Any]]] = {kind: [] for kind in KINDS}
    standing: list[Geometry] = []
    cells = np.argwhere(free)
    for _ in range(round(len(cells) * CELL**2 / AREA_PER_PIECE)):
        for _ in range(ATTEMPTS):
            row, column = cells[int(rng.integers(len(cells)))]
            kind, piece = _draw_piece(corner + (np.array((column, row)) + 0.5) * CELL, rng)
            outline = shapely.Polygon(piece.polygon())
            if room.covers(outline) and not any(outline.intersects(other) for other in standing):
                pieces[kind].append(piece.model_dump(exclude_unset=True))
                standing.append(outline)
                break
    return pieces


def swept(route: Array) -> Geometry:
    """The area that is kept clear for the robot along its route [k, 2]."""
    import shapely

    line = shapely.LineString(route)
    back, on = route[:-2] - route[1:-1], route[2:] - route[1:-1]
    reversals = route[1:-1][(back * on).sum(axis=1) > 0.5 * np.hypot(*back.T) * np.hypot(*on.T)]
    near = shapely.buffer(shapely.points(reversals), REVERSAL_REACH)
    turns = [line.intersection(disc).buffer(CLEAR_OF_REVERSAL) for disc in near]
    return shapely.union_all([line.buffer(CLEAR_OF_ROUTE), *turns])


def _free_space(free: NDArray[np.bool_], corner: Array) -> Geometry:
    """The free cells as one polygon [m]: the union of the runs of free cells in each row."""
    import shapely

    rows, begin, end = equal_runs(free.astype(np.int8)).T
    (x, y), cell = corner, CELL
    return shapely.union_all(
        shapely.box(x + begin * cell, y + rows * cell, x + end * cell, y + (rows + 1) * cell), grid_size=cell / 1000
    )


def _draw_piece(centre: Array, rng: np.random.Generator) -> tuple[str, Block]:
    """A piece of a random kind, size and angle, and its kind."""
    kind = KINDS[int(rng.integers(len(KINDS)))]
    size = rng.uniform(0.25, 1.0, 2).round(2)
    angle = round(float(rng.choice((0.0, 0.0, rng.uniform(-1.5, 1.5)))), 3)
    place = tuple(centre.round(3).tolist())
    match kind:
        case "pillars":
            return kind, Pillar(centre=place, radius=round(float(size[0]) / 2, 3))
        case "chairs":
            return kind, Chair(centre=place, angle=angle)
        case "tables":
            return kind, Table(centre=place, angle=angle, size=tuple((size + 0.5).round(2).tolist()))
    return kind, Box(centre=place, angle=angle, size=tuple(size.tolist()))
