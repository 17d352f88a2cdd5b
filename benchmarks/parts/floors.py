"""Office floors drawn at random as PNG: rooms along both sides of a corridor, as a map_server plan with a route."""

from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.image import imsave

CELL, WALL = 0.05, 0.2
"""Edge of a pixel, thickness of the walls [m]."""
AWAY = 1.0
"""Furniture is so far from the way into its room at least [m]."""


def drawn_floor(seed: int, folder: Path) -> Path:
    """The scenario file of a floor that is written into a folder, with every second room or more visited in turn."""
    random = np.random.default_rng(seed)
    width, (below, above), across = random.uniform(18, 32), random.uniform(4, 7, 2), random.uniform(1.6, 2.6)
    top, height = below + across, below + across + above
    free = np.full((round(height / CELL), round(width / CELL)), True)

    def fill(x: tuple[float, float], y: tuple[float, float], *, with_free: bool = False) -> None:
        (left, right), (low, high) = (np.rint(np.clip(each, 0, None) / CELL).astype(int) for each in (x, y))
        free[low:high, left:right] = with_free

    for y in ((0, WALL), (height - WALL, height), (below - WALL, below), (top, top + WALL)):
        fill((0, width), y)
    for x in ((0, WALL), (width - WALL, width)):
        fill(x, (0, height))
    stops: list[tuple[float, float]] = []
    for wall, inside, (low, high) in (
        ((below - WALL, below), below - 1.5, (0, below)),
        ((top, top + WALL), top + 1.5, (top, height)),
    ):
        begin = 0.0
        while begin < width:
            end = begin + random.uniform(4, 9)
            end = width if width - end < 3 else end
            fill((end, end + WALL), (low, high))
            door, half = random.uniform(begin + 1.2, end - 1.2), random.uniform(1.1, 1.4) / 2
            for x, y, *size in random.uniform((begin, low, 0.2, 0.2), (end, high, 0.7, 0.7), (random.integers(3), 4)):
                if abs(x - door) > size[0] + AWAY:
                    fill((x - size[0], x + size[0]), (max(y - size[1], low), min(y + size[1], high)))
            if not stops or random.random() < 0.75:
                fill((door - half, door + half), wall, with_free=True)
                stops.append((door, inside))
            begin = end
    middle = (below + top) / 2
    route = [(1.2, middle)]
    for door, inside in sorted(stops):
        route += [(door, middle), (door, inside), (door, middle)]
    route += [(width - 1.2, middle), (1.5, middle)]
    apart = [b for a, b in pairwise(route) if np.hypot(b[0] - a[0], b[1] - a[1]) > 0.3]
    imsave(folder / "floor.png", np.where(free, 1.0, 0.0)[::-1], cmap="gray", vmin=0, vmax=1)
    thresholds = "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    (folder / "floor.yaml").write_text(f"image: floor.png\nresolution: {CELL}\norigin: [0, 0, 0]\n{thresholds}")
    points = [[round(float(value), 2) for value in point] for point in (route[0], *apart)]
    (folder / "floor.toml").write_text(f'[world.plan]\nfile = "floor.yaml"\n[route]\nwaypoints = {points}\n')
    return folder / "floor.toml"
