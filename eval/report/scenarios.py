"""A scenario as a picture: what stands in it, what it is made of, who moves, and the path through it."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from moteslam.eval.report import style
from moteslam.sim.scenario import Scenario
from moteslam.sim.world.world import World

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MATERIAL_COLOURS = {"glass": "#56B4E9", "black": "black", "shiny": "#E69F00"}
PLAIN_COLOUR, OTHER, PERSON, DOOR, ROUTE = "0.25", "#CC79A7", "#D55E00", "#009E73", style.SLAM


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
    line = driven if driven is not None else None if scenario.route is None else scenario.route.path()
    label = "route" if driven is None else "driven path"
    points = world.segments.reshape(-1, 2)
    with style.saved_figure(path, size=style.plan_size(points, longest=11.0)) as figure:
        axes = figure.subplots()
        draw_world(axes, world)
        for patch in scenario.world.slippery:
            _rectangle(axes, patch.corner, patch.size)
        if line is not None:
            axes.plot(line[:, 0], line[:, 1], color=ROUTE, lw=1.1, label=label)
        axes.plot(*scenario.start[:2], "o", color=ROUTE, ms=6, label="robot's start")
        _draw_moving(axes, scenario)
        style.plan(axes)
        style.show_everything(axes, points)
        style.legend_below(figure, axes)
        style.heading(figure, scenario.name)


def draw_world(axes: Axes, world: World) -> None:
    """Draw what stands, a colour a material."""
    from matplotlib.collections import LineCollection
    from matplotlib.patches import Polygon

    surfaces = np.zeros(len(world.segments), np.int64) if world.surfaces is None else world.surfaces
    for polygon in world.solids:
        axes.add_patch(Polygon(polygon, facecolor="0.85", edgecolor="none", zorder=0.5))
    for i, name in enumerate(world.palette):
        lines = world.segments[surfaces == i].reshape(-1, 2, 2)
        if len(lines):
            plain = name == "plain"
            colour = PLAIN_COLOUR if plain else MATERIAL_COLOURS.get(name, OTHER)
            label = "wall" if plain else name
            axes.add_collection(LineCollection(lines, colors=colour, linewidths=1.0 if plain else 2.2, label=label))


def _draw_moving(axes: Axes, scenario: Scenario) -> None:
    for i, person in enumerate(scenario.people):
        waypoints = np.asarray(person.waypoints)
        label = "people, where they walk" if i == 0 else None
        axes.plot(waypoints[:, 0], waypoints[:, 1], ":", color=PERSON, lw=1.2, label=label)
        axes.plot(*waypoints[0], "o", color=PERSON, ms=4)
    for i, door in enumerate(scenario.doors):
        leaf = np.array((door.hinge, door.end))
        axes.plot(leaf[:, 0], leaf[:, 1], color=DOOR, lw=2.2, label="door, shut" if i == 0 else None)
        axes.plot(*door.hinge, "o", color=DOOR, ms=3.5)
    if scenario.crowd is not None:
        axes.plot([], [], " ", label=f"and {scenario.crowd.count} people who stroll anywhere")


def _rectangle(axes: Axes, corner: tuple[float, float], size: tuple[float, float]) -> None:
    from matplotlib.patches import Rectangle

    known = any(handle.get_label() == "slippery floor" for handle in axes.patches)
    label = None if known else "slippery floor"
    axes.add_patch(Rectangle(corner, *size, facecolor="#F0E442", alpha=0.6, edgecolor="none", zorder=0.3, label=label))
