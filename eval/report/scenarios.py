"""A scenario as a plan: free space, what stands in it and of what material, who moves, and the robot's route."""

from __future__ import annotations

from typing import Any

import numpy as np

from moteslam.errors import File
from moteslam.eval.report import style
from moteslam.robot.formats.map_server import FREE
from moteslam.robot.se2 import Array, transform_points
from moteslam.sim.actors.actors import Door
from moteslam.sim.scenario import Scenario
from moteslam.sim.world.world import World, true_map

MATERIAL_COLOURS = {"plain": "0.25", "glass": "#56B4E9", "black": "black", "shiny": "#E69F00"}
OTHER_MATERIAL, PERSON, DOOR, SLIPPERY = "#CC79A7", "#D55E00", "#009E73", "#F0E442"
UNREACHED, FREE_SPACE = "0.9", "white"
FURNITURE = {
    "shelves": ("shelf", "#CDB08A"),
    "tables": ("table", "#E8D5B5"),
    "chairs": ("chair", "#F4E8D2"),
    "boxes": ("box", "0.75"),
    "pillars": ("pillar", "0.55"),
}
"""Name and colour of each kind; those that may stand on another one come after it. Of tables and chairs it is the board
that is filled, which the lidar does not see."""

LONGEST, RASTER = 11.0, 1500
"""The longer side of the plan [inch], and the cells along it of the raster of free space."""
ARROWS_APART, ARROW_BESIDE = 0.9, 0.05
"""Between the arrows along a route, and how far to the right of it they are, as there and back differ [inch]."""
ARROW: dict[str, Any] = {
    **{"units": "inches", "width": 0.035, "headwidth": 2.0, "headlength": 3.1, "headaxislength": 3.1},
    **{"scale_units": "inches", "scale": 1 / 0.11},
}
"""A triangle 0.11 inch long and 0.07 wide."""


def draw_scenario(path: File, scenario: Scenario, *, driven: Array | None = None) -> None:
    """Draw a scenario as a plan; the path [n, 2] that was driven [m] in place of its route."""
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.patches import Rectangle

    world = World.of(scenario.standing)
    line = driven if driven is not None else None if scenario.route is None else scenario.route.path()
    points = np.vstack((world.segments.reshape(-1, 2), scenario.start[None, :2] if line is None else line[:, :2]))
    scale = LONGEST / (float(np.ptp(points, axis=0).max()) + 2.0)  # inch/m, as of saved_plan
    with style.saved_plan(path, points, title=scenario.name, longest=LONGEST) as axes:
        axes.set_facecolor(FREE_SPACE)
        _draw_unreached(axes, world, scenario.start[:2])
        look: dict[str, Any] = {"facecolor": SLIPPERY, "alpha": 0.6, "zorder": 0.3}
        for patch in scenario.world.slippery:
            axes.add_patch(Rectangle(patch.corner, *patch.size, label=f"slippery floor, grip {patch.grip:g}", **look))
        look = {"edgecolors": "0.6", "linewidths": 0.4, "zorder": 0.5}
        for kinds, (kind, colour) in FURNITURE.items():
            if areas := [piece.polygon() for piece in getattr(scenario.standing, kinds)]:
                axes.add_collection(PolyCollection(areas, facecolors=colour, label=f"{kind} ({len(areas)})", **look))
        surfaces = np.zeros(len(world.segments), np.int64) if world.surfaces is None else world.surfaces
        for i, name in enumerate(world.palette):
            lines, plain = world.segments[surfaces == i].reshape(-1, 2, 2), name == "plain"
            if len(lines):
                colour, label = MATERIAL_COLOURS.get(name, OTHER_MATERIAL), "wall" if plain else name
                axes.add_collection(LineCollection(lines, colors=colour, linewidths=1.0 if plain else 2.2, label=label))
        _draw_route(axes, scenario, line, scale, "route" if driven is None else "driven path")
        for person in scenario.people:
            strolls = len(person.waypoints) == 1
            look = {"color": PERSON, "mfc": "white" if strolls else PERSON, "mec": PERSON, "lw": 1.2}
            look["label"] = "person, strolls about" if strolls else "person, there and back"
            axes.plot(*np.transpose(person.waypoints), "o" if strolls else "o:", markevery=[0], ms=5, **look)
        if scenario.crowd is not None:
            label = f"+ {scenario.crowd.count} who stroll anywhere"
            axes.plot([], [], "o", color="none", mec=PERSON, ms=5, label=label)
        for door in scenario.doors:
            axes.plot(*np.array((door.hinge, door.end)).T, color=DOOR, lw=2.4, label="door, shut")
            axes.plot(*_opening(door).T, "--", color=DOOR, lw=1.0, label="door, as it opens")


def _draw_unreached(axes: style.Axes, world: World, start: Array) -> None:
    """Fill all but what can be reached from the robot's start."""
    from matplotlib.colors import ListedColormap

    x0, y0, x1, y1 = world.bounds
    reached = true_map(world, max(x1 - x0, y1 - y0) / RASTER, seen_from=start)
    look: dict[str, Any] = {"cmap": ListedColormap([UNREACHED]), "origin": "lower", "interpolation": "nearest"}
    axes.imshow(np.ma.masked_equal(reached.values, FREE), extent=reached.extent, zorder=0.4, **look)
    axes.plot([], [], "s", mfc=FREE_SPACE, mec="0.6", ms=8, label="free space")


def _draw_route(axes: style.Axes, scenario: Scenario, line: Array | None, scale: float, name: str) -> None:
    start = scenario.start
    style.mark_start(axes, start[None])
    if line is None:
        wander = scenario.wander
        task = "drives by commands" if wander is None else f"wanders {wander.distance:g} m at random"
        axes.plot([], [], " ", label=task)
        return
    length = float(np.hypot(*np.diff(line, axis=0).T).sum())
    axes.plot(line[:, 0], line[:, 1], color=style.SLAM, lw=1.0, label=f"{name}, {length:.0f} m")
    places, directions = along(line, ARROWS_APART / scale)
    beside = places + ARROW_BESIDE / scale * np.stack((directions[:, 1], -directions[:, 0]), axis=-1)
    axes.quiver(*beside.T, *directions.T, color=style.SLAM, pivot="mid", zorder=3, **ARROW)
    style.mark_ends(axes, (line, style.SLAM), label="goal")


def along(line: Array, spacing: float) -> tuple[Array, Array]:
    """Places [n, 2] on a line [k, 2], k at least 2, about a spacing apart, and its unit directions there [n, 2]."""
    steps = np.diff(line, axis=0)
    lengths = np.hypot(*steps.T)
    travelled = np.concatenate(([0.0], np.cumsum(lengths)))
    count = max(1, round(travelled[-1] / spacing))
    at = (np.arange(count) + 0.5) * travelled[-1] / count
    leg = np.clip(np.searchsorted(travelled, at, side="right") - 1, 0, len(steps) - 1)
    directions = steps[leg] / np.maximum(lengths[leg], 1e-12)[:, None]
    return line[leg] + (at - travelled[leg])[:, None] * directions, directions


def _opening(door: Door) -> Array:
    """What the free end of a door's leaf goes through, and back to the hinge [k, 2] [m]."""
    hinge, end = np.array(door.hinge), np.array(door.end)
    if door.kind == "slide":
        return np.stack((hinge, 2 * hinge - end))
    arc = [transform_points((*hinge, angle), end - hinge) for angle in np.linspace(0.0, door.opening, 16)]
    return np.array([*arc, hinge])
