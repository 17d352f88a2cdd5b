"""The coloured map of the floor as a picture, and how it grew beside the map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from os import PathLike

import numpy as np
from numpy.typing import NDArray

from moteslam.eval.report import style
from moteslam.eval.report.snapshots import STAGES
from moteslam.robot.formats.map_arrays import MapArrays
from moteslam.robot.formats.map_server import write_picture
from moteslam.robot.raster import Raster
from moteslam.robot.trajectory import Trajectory
from moteslam.slam.texture.floor_map import TextureMap, TextureMapper


@dataclass(eq=False)
class TextureStages:
    """Watches the colouring and keeps the map at six moments, evenly over the run.

    Attributes:
        begin, end: of the run [s].
        kept: stamp and map so far.
    """

    begin: float
    end: float
    kept: list[tuple[float, TextureMap]] = field(default_factory=list)

    def look(self, stamp: float, mapper: TextureMapper) -> None:
        """Keep the map if a stage ends before this frame's stamp [s]."""
        while len(self.kept) < STAGES:
            due = self.begin + (len(self.kept) + 1) * (self.end - self.begin) / STAGES
            if stamp < due:
                return
            self.kept.append((due, mapper.snapshot()))


def with_opacity(texture: TextureMap) -> NDArray[np.uint8]:
    """The map as colours [H, W, 4]: red, green, blue, and an opacity of 0 where nothing is known; row 0 smallest y."""
    opacity = np.where(texture.known, 255, 0).astype(np.uint8)
    colours = np.where(texture.known[..., None], texture.values, 255).astype(np.uint8)
    return np.dstack((colours, opacity))


def write_texture(path: str | PathLike[str], texture: TextureMap) -> None:
    """Write the map as a PNG, a pixel a cell, transparent where nothing is known, and where it lies as ``.yaml``.

    Raises:
        OutputError: one of them cannot be written.
    """
    write_picture(path, Raster(with_opacity(texture), texture.cell_size, texture.origin), {"frames": texture.frames})


def texture_arrays(texture: TextureMap) -> MapArrays:
    """The coloured floor as it goes into ``texture.npz``: colours, and of how many points each is the mean."""
    return MapArrays(
        kind="texture",
        arrays={"colours": texture.values, "points": texture.points},
        cell_size=texture.cell_size,
        origin=texture.origin,
    )


def draw_texture_over_time(
    path: str | PathLike[str],
    stages: Sequence[tuple[float, TextureMap]],
    occupancy: Raster,
    *,
    trajectory: Trajectory,
    title: str = "",
) -> None:
    """The map and, beside it, the coloured floor at stages of the run (figures 3 and 4 of the paper).

    Args:
        path: of the PNG.
        stages: stamp [s] and coloured floor, at least one.
        occupancy: the map, drawn in the first panel and, its walls alone, over the colours.
        trajectory: along which the floor was coloured.
        title: over the figure.

    Raises:
        OutputError: it cannot be written.
    """
    belief = np.tanh(occupancy.values / 2)
    walls = occupancy.extent
    known = [texture.extent for _, texture in stages]
    corners = np.array([(e[0], e[2]) for e in known] + [(e[1], e[3]) for e in known])
    points = np.concatenate((trajectory.poses[:, :2], corners))
    width, height = np.ptp(points, axis=0) + 1.0
    count = len(stages) + 1
    columns = min(count, 7 if height > 2 * width else 2 if height < 0.3 * width else 4)
    rows = -(-count // columns)
    panel = min(max(13.0 / columns * height / width, 0.7), 8.0)
    with style.saved_figure(path, size=(13.0, rows * (panel + 0.25) + 0.9)) as figure:
        grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        panels = list(grid.flat)
        for axes in panels[:count]:
            style.show_unknown(axes)
            style.plan(axes, labels=False)
        grey = style.map_greys(occupancy.values)
        panels[0].imshow(grey, cmap="gray", vmin=0, vmax=1, origin="lower", extent=walls, interpolation="antialiased")
        panels[0].plot(*trajectory.poses[:, :2].T, color=style.SLAM, lw=1.0, label="SLAM")
        style.mark_start(panels[0], trajectory.poses)
        style.mark_ends(panels[0], (trajectory.poses, style.SLAM))
        panels[0].set_title("the map")
        dark = np.zeros((*belief.shape, 4))
        dark[..., 3] = np.where(belief > 0, 0.8 * belief, 0.0)
        for axes, (stamp, texture), extent in zip(panels[1:], stages, known, strict=False):
            axes.imshow(with_opacity(texture), origin="lower", extent=extent, interpolation="antialiased")
            axes.imshow(dark, origin="lower", extent=walls, interpolation="antialiased")
            until = trajectory.poses[trajectory.stamps <= stamp]
            axes.plot(until[:, 0], until[:, 1], color=style.SLAM, lw=0.8)
            style.mark_start(axes, trajectory.poses)
            if len(until):
                style.mark_ends(axes, (until, style.SLAM), label="robot")
            axes.set_title(f"{stamp - trajectory.stamps[0]:.0f} s")
        for axes in panels[count:]:
            axes.set_visible(False)
        style.show_everything(panels[0], points, margin=0.5)
        for axes in grid[-1]:
            axes.set_xlabel("x [m]")
        for axes in grid[:, 0]:
            axes.set_ylabel("y [m]")
        style.legend_below(figure, *panels[:2])
        style.heading(figure, title)
