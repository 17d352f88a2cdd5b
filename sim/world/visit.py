"""Another visit to a building: some of its furniture stands elsewhere, and some of its doors are shut."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from moteslam.robot.se2 import Array
from moteslam.robot.values import Section, Share, Whole
from moteslam.sim.world.layout import Layout, Wall
from moteslam.sim.world.pieces import Box, Shelf, Table
from moteslam.sim.world.random_corridors import swept
from moteslam.sim.world.world import World

if TYPE_CHECKING:
    from shapely import Geometry, STRtree

Piece = Box | Table | Shelf

FURNITURE = ("boxes", "tables", "chairs", "shelves")  # What may be moved; pillars belong to the building
NEAREST, FARTHEST, TRIES = 0.5, 3.0, 100  # How far a piece is moved [m], and how many places are tried for it
SAME_DOOR = 0.3  # Doorways whose middles are nearer to each other are one, in two walls that touch [m]
LEAF = 0.25  # A shut door is in pieces of at most this length, on which `lived_in` puts neither relief nor clutter [m]


class Visit(Section):
    """What a visit finds changed: a share of the furniture, and a share of the doorways that nobody passes."""

    seed: Annotated[Whole, Field(ge=0, lt=2**63)] = 0  # of what these are
    building: Annotated[Whole, Field(ge=0, lt=2**63)] = 0  # seed of `noise.surroundings`, the same in every visit
    moved: Share = 0.1  # of the boxes, tables, chairs and shelves: each within its room, by 0.5 to 3 m
    shut: Share = 0.5  # of the doorways in walls and rooms through which the robot does not drive


def visited(layout: Layout, visit: Visit, route: Array, others: Sequence[tuple[Array, float]]) -> Layout:
    """The layout as a visit finds it; clear stay corners ``route`` [k, 2] and, as far as is said, other lines [k, 2]
    [m].
    """
    import shapely

    rng = np.random.default_rng(np.random.SeedSequence(visit.seed, spawn_key=(0x515,)))
    clear = shapely.union_all([swept(route), *(_line(line).buffer(far) for line, far in others)])
    shut: list[Wall] = []
    seen: list[Array] = []
    walls_of_rooms = (side for room in layout.rooms for side in room.sides())
    for doorway in (each for wall in (*layout.walls, *walls_of_rooms) for each in wall.doorways()):
        middle = doorway.mean(axis=0)
        if any(np.hypot(*(middle - other)) < SAME_DOOR for other in seen):
            continue
        seen.append(middle)
        if rng.random() < visit.shut and not _line(doorway).intersects(clear):
            count = int(np.hypot(*(doorway[1] - doorway[0])) / LEAF) + 2
            shut.append(Wall(points=tuple(map(tuple, np.linspace(doorway[0], doorway[1], count).tolist()))))
    layout = layout.model_copy(update={"walls": (*layout.walls, *shut)})
    bare = layout.model_copy(update=dict.fromkeys(FURNITURE, ()))
    walls = shapely.STRtree(shapely.linestrings(World.of(bare).segments.reshape(-1, 2, 2)))
    kinds = [kind for kind in FURNITURE for _ in getattr(layout, kind)]
    standing: list[Piece] = [piece for kind in FURNITURE for piece in getattr(layout, kind)]
    left = round(visit.moved * len(standing))
    for i in rng.permutation(len(standing)):
        if left:
            others_stand = [shapely.Polygon(piece.polygon()) for piece in (*standing[:i], *standing[i + 1 :])]
            piece = _moved(standing[i], walls, shapely.union_all([clear, *others_stand]), rng)
            left -= piece is not standing[i]
            standing[i] = piece
    of = {kind: tuple(piece for k, piece in zip(kinds, standing, strict=True) if k == kind) for kind in FURNITURE}
    return layout.model_copy(update=of)


def _line(points: Array) -> Geometry:
    import shapely

    points = np.asarray(points, np.float64)
    return shapely.LineString(points if len(points) > 1 else np.repeat(points, 2, axis=0))


def _moved(piece: Piece, walls: STRtree, taken: Geometry, rng: np.random.Generator) -> Piece:
    """A piece at another place of its room, half of them turned; the same where there is none."""
    import shapely

    here = np.array(piece.centre)
    for _ in range(TRIES):
        far, way, turn = rng.uniform(NEAREST, FARTHEST), rng.uniform(-np.pi, np.pi), rng.choice((0.0, np.pi / 2))
        there = (here + far * np.array((np.cos(way), np.sin(way)))).round(3)
        moved = piece.model_copy(update={"centre": tuple(there.tolist()), "angle": piece.angle + float(turn)})
        outline, path = shapely.Polygon(moved.polygon()), shapely.LineString((here, there))
        if not outline.intersects(taken) and not len(walls.query([outline, path], "intersects")[0]):
            return moved
    return piece
