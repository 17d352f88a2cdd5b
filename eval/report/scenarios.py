"""A scenario as a plan: free space, what stands in it and of what material, who moves, and the robot's route."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from moteslam.eval.report import style
from moteslam.eval.report.arrows import APART, draw_arrows
from moteslam.eval.report.labels import Label, draw_labels
from moteslam.robot.formats.map_server import FREE
from moteslam.sim.actors.doors import Door
from moteslam.sim.scenario import Scenario
from moteslam.sim.world.layout import Layout
from moteslam.sim.world.pieces import Polygon
from moteslam.sim.world.true_map import true_map
from moteslam.sim.world.world import World

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MATERIAL_COLOURS = {"glass": "#56B4E9", "black": "black", "shiny": "#E69F00"}
PLAIN_COLOUR, OTHER_MATERIAL, PERSON, DOOR, SLIPPERY = "0.25", "#CC79A7", "#D55E00", "#009E73", "#F0E442"
UNREACHED, FREE_SPACE = "0.9", "white"
FURNITURE_COLOURS = {"box": "0.75", "pillar": "0.55", "table": "#E8D5B5", "chair": "#F4E8D2", "shelf": "#CDB08A"}
"""By kind; of tables and chairs it is the board that is filled, which the lidar does not see."""

LONGEST = 11.0
"""The longer side of the plan [inch]."""
RASTER = 1500
"""Cells along the longer side of the raster of free space."""


def draw_scenario(path: str | PathLike[str], scenario: Scenario, *, driven: NDArray[np.float64] | None = None) -> None:
    """Draw a scenario as a plan in metres, its legend below the axes.

    Args:
        path: of the PNG.
        scenario: to draw.
        driven: [n, 2] the path that was driven, drawn in place of the route [m].

    Raises:
        InputError: a floor plan that cannot be read.
        OutputError: it cannot be written.
    """
    world = World.of(scenario.world)
    points = world.segments.reshape(-1, 2)
    scale = LONGEST / (float(np.ptp(points, axis=0).max()) + 2.0)  # as in plan_size
    line = driven if driven is not None else None if scenario.route is None else scenario.route.path()
    with style.saved_figure(path, size=style.plan_size(points, longest=LONGEST)) as figure:
        axes = figure.subplots()
        axes.set_facecolor(FREE_SPACE)
        _draw_unreached(axes, world, scenario.start[:2])
        labels = _draw_slippery(axes, scenario.world)
        _draw_furniture(axes, scenario.world)
        _draw_walls(axes, world)
        labels += _draw_route(axes, scenario, line, scale, "route" if driven is None else "driven path")
        labels += _draw_people(axes, scenario) + _draw_doors(axes, scenario)
        style.plan(axes)
        style.show_everything(axes, points, margin=0.5)
        draw_labels(axes, labels, scale)
        style.legend_below(figure, axes)
        style.heading(figure, scenario.name)


def _draw_unreached(axes: Axes, world: World, start: NDArray[np.float64]) -> None:
    """Fill all but what can be reached from the robot's start."""
    from matplotlib.colors import ListedColormap

    x0, y0, x1, y1 = world.bounds
    reached = true_map(world, max(x1 - x0, y1 - y0) / RASTER, seen_from=start)
    left, right, bottom, top = reached.extent
    rest = np.ma.masked_equal(reached.values, FREE)
    look: dict[str, Any] = {
        "cmap": ListedColormap([UNREACHED]),
        "origin": "lower",
        "interpolation": "nearest",
        "zorder": 0.4,
    }
    axes.imshow(rest, extent=(left, right, bottom, top), **look)
    axes.plot([], [], "s", mfc=FREE_SPACE, mec="0.6", ms=8, label="free space")


def _draw_slippery(axes: Axes, layout: Layout) -> list[Label]:
    """Patches of slippery floor; their labels."""
    from matplotlib.patches import Rectangle

    labels = []
    for i, patch in enumerate(layout.slippery):
        label = "slippery floor" if i == 0 else None
        axes.add_patch(Rectangle(patch.corner, *patch.size, facecolor=SLIPPERY, alpha=0.6, zorder=0.3, label=label))
        x, y = np.add(patch.corner, np.multiply(0.5, patch.size)).tolist()
        labels.append(Label(f"grip {patch.grip:g}", (x, y), "0.3"))
    return labels


def _furniture(layout: Layout) -> dict[str, list[Polygon]]:
    """The areas that pieces take on the floor, by kind; those that may stand on another one come after it."""
    return {
        "shelf": [piece.polygon() for piece in layout.shelves],
        "table": [piece.board() for piece in layout.tables],
        "chair": [piece.board() for piece in layout.chairs],
        "box": [piece.polygon() for piece in layout.boxes],
        "pillar": [piece.polygon() for piece in layout.pillars],
    }


def _draw_furniture(axes: Axes, layout: Layout) -> None:
    """The areas of furniture, a colour a kind."""
    from matplotlib.collections import PolyCollection

    for kind, areas in _furniture(layout).items():
        if areas:
            look: dict[str, Any] = {
                "facecolors": FURNITURE_COLOURS[kind],
                "edgecolors": "0.6",
                "linewidths": 0.4,
                "zorder": 0.5,
            }
            axes.add_collection(PolyCollection(areas, label=f"{kind} ({len(areas)})", **look))


def _draw_walls(axes: Axes, world: World) -> None:
    """Walls and outlines of what stands, a colour a material."""
    from matplotlib.collections import LineCollection

    surfaces = np.zeros(len(world.segments), np.int64) if world.surfaces is None else world.surfaces
    for i, name in enumerate(world.palette):
        lines = world.segments[surfaces == i].reshape(-1, 2, 2)
        if len(lines):
            plain = name == "plain"
            colour = PLAIN_COLOUR if plain else MATERIAL_COLOURS.get(name, OTHER_MATERIAL)
            label = "wall" if plain else name
            axes.add_collection(LineCollection(lines, colors=colour, linewidths=1.0 if plain else 2.2, label=label))


def _draw_route(
    axes: Axes, scenario: Scenario, line: NDArray[np.float64] | None, scale: float, name: str
) -> list[Label]:
    """The route with arrows, its start and its goal; their labels."""
    start = scenario.start
    style.mark_start(axes, start[None])
    if line is None:
        axes.plot([], [], " ", label=_task_without_route(scenario))
        return [Label("start", (start[0], start[1]))]
    length = float(np.hypot(*np.diff(line, axis=0).T).sum())
    axes.plot(line[:, 0], line[:, 1], color=style.SLAM, lw=1.0, label=f"{name}, {length:.0f} m")
    draw_arrows(axes, line, scale, style.SLAM)
    style.mark_ends(axes, (line, style.SLAM), label="goal")
    goal = line[-1]
    if np.hypot(*(goal - start[:2])) * scale < APART / 3:
        return [Label("start and goal", (start[0], start[1]))]
    return [Label("start", (start[0], start[1])), Label("goal", (goal[0], goal[1]), style.SLAM)]


def _task_without_route(scenario: Scenario) -> str:
    """What a robot does that has no route, for the legend."""
    if scenario.wander is not None:
        return f"wanders {scenario.wander.distance:g} m at random"
    return "drives by commands"


def _draw_people(axes: Axes, scenario: Scenario) -> list[Label]:
    """Where people start and walk; their labels."""
    labels = []
    known = set()
    for i, person in enumerate(scenario.people):
        waypoints = np.asarray(person.waypoints)
        strolls = len(waypoints) == 1
        what = "person, strolls about" if strolls else "person, there and back"
        look: dict[str, Any] = {
            "color": PERSON,
            "mfc": "white" if strolls else PERSON,
            "mec": PERSON,
            "ms": 5,
            "lw": 1.2,
        }
        axes.plot(*waypoints.T, "o" if strolls else "o:", markevery=[0], label=None if what in known else what, **look)
        known.add(what)
        labels.append(Label(f"person {i + 1}", person.waypoints[0], PERSON))
    if scenario.crowd is not None:
        axes.plot([], [], "o", color="none", mec=PERSON, ms=5, label=f"+ {scenario.crowd.count} who stroll anywhere")
    return labels


def _draw_doors(axes: Axes, scenario: Scenario) -> list[Label]:
    """The leaves of doors, shut and open; their labels."""
    labels = []
    for i, door in enumerate(scenario.doors):
        leaf = np.array((door.hinge, door.end))
        axes.plot(*leaf.T, color=DOOR, lw=2.4, label="door, shut" if i == 0 else None)
        axes.plot(*_opening(door).T, "--", color=DOOR, lw=1.0, label="door, as it opens" if i == 0 else None)
        x, y = leaf.mean(axis=0).tolist()
        labels.append(Label(f"door {i + 1}", (x, y), DOOR))
    return labels


def _opening(door: Door) -> NDArray[np.float64]:
    """What the free end of a door's leaf goes through, and back to the hinge [k, 2] [m]."""
    hinge, end = np.array(door.hinge), np.array(door.end)
    if door.kind == "slide":
        return np.stack((hinge, 2 * hinge - end))
    angles = np.linspace(0.0, door.opening, 16)
    x, y = end - hinge
    arc = np.stack((x * np.cos(angles) - y * np.sin(angles), x * np.sin(angles) + y * np.cos(angles)), axis=-1)
    return np.concatenate((hinge + arc, hinge[None]))
