"""A building as it is lived in: walls that are not flat, things along them, surfaces that swallow light.

It makes of a world another, with the same palette and more segments and materials; the plan stays what it was. The
robot's physics knows nothing of it: what is put up keeps clear of where the robot drives.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.noise import Surroundings
from moteslam.sim.world.pieces import PLAIN, Material, Segments
from moteslam.sim.world.world import World

SHORTEST = 0.3
"""Segments below this length are furniture or frames and stay as they are [m]."""
DEEPEST = 0.5
"""That a thing stands out from its wall [m]."""
CLEARANCE = 0.05
"""Between a thing and the robot's body [m]."""
SHADES = 12
"""How many materials the reaches of plain surfaces are sorted into."""

Floats = NDArray[np.float64]


def lived_in(world: World, settings: Surroundings, rng: np.random.Generator, *, path: Floats, radius: float) -> World:
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


def _clutter(
    segments: Segments, settings: Surroundings, rng: np.random.Generator, path: Floats, clear: float
) -> NDArray[np.float64]:
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
    corners = np.stack(
        (
            start + begin[:, None] * along,
            start + begin[:, None] * along + depth[:, None] * across,
            start + (begin + width)[:, None] * along + (depth * slant)[:, None] * across,
            start + (begin + width)[:, None] * along,
        ),
        axis=1,
    )
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
