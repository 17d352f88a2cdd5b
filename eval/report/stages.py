"""The map and the coloured floor at stages of a run, kept and drawn side by side; the coloured floor as files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from moteslam.eval.report import style
from moteslam.eval.report.maps import draw_map, map_corners
from moteslam.robot.formats.map_server import write_picture
from moteslam.robot.raster import MapArrays, Raster
from moteslam.robot.trajectory import Trajectory
from moteslam.slam.run import SlamSession
from moteslam.slam.scan_records import Update
from moteslam.slam.texture.floor_map import TextureMap, TextureMapper

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STAGES = 6
"""Of a run."""
SCANS = 250
"""At most this many scans are drawn into the map of a stage but the last: its panel is small."""


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The map after the scan of this index and stamp [s]."""

    index: int
    stamp: float
    map: Raster


@dataclass(eq=False)
class Snapshots:
    """Watches a session and keeps its map after each sixth of the scans.

    Attributes:
        session: what is watched.
        kept: the maps so far.
    """

    session: SlamSession
    kept: list[Snapshot] = field(default_factory=list)

    def look(self, update: Update) -> None:
        """Keep the map if this scan ends a stage."""
        total = len(self.session)
        if update.index in np.arange(1, STAGES + 1) * total // STAGES - 1:
            occupancy = self.session.map if update.index == total - 1 else self.session.preview(SCANS)
            self.kept.append(Snapshot(update.index, update.stamp, occupancy))


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


def draw_over_time(
    path: str | PathLike[str], snapshots: Sequence[Snapshot], *, trajectory: Trajectory, title: str = ""
) -> None:
    """The trajectory and the map at stages of the run (figures 1 and 2 of the paper), all at one scale.

    Args:
        path: of the PNG.
        snapshots: of the map, at least one.
        trajectory: as it was known at each scan.
        title: over the figure.
    """
    points = np.concatenate([trajectory.poses[:, :2], map_corners(snapshots[-1].map)])
    with _panels(path, len(snapshots), points, width=11.0, columns=(6, 3), title=title) as (figure, panels):
        for axes, snapshot in zip(panels, snapshots, strict=True):
            until = trajectory.poses[: snapshot.index + 1]
            draw_map(axes, snapshot.map)
            axes.plot(until[:, 0], until[:, 1], color=style.SLAM, lw=1.1, label=style.ONLINE)
            style.mark_start(axes, until)
            style.mark_ends(axes, (until, style.SLAM), label="robot")
            axes.set_title(f"{snapshot.stamp - trajectory.stamps[0]:.0f} s")
        style.legend_below(figure, panels[0])


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
    """
    belief = np.tanh(occupancy.values / 2)
    dark = np.zeros((*belief.shape, 4))
    dark[..., 3] = np.where(belief > 0, 0.8 * belief, 0.0)
    known = [texture.extent for _, texture in stages]
    corners = np.array([(e[0], e[2]) for e in known] + [(e[1], e[3]) for e in known])
    points = np.concatenate((trajectory.poses[:, :2], corners))
    with _panels(path, len(stages) + 1, points, width=13.0, columns=(7, 4), title=title) as (figure, panels):
        draw_map(panels[0], occupancy)
        panels[0].plot(*trajectory.poses[:, :2].T, color=style.SLAM, lw=1.0, label="SLAM")
        style.mark_start(panels[0], trajectory.poses)
        style.mark_ends(panels[0], (trajectory.poses, style.SLAM))
        panels[0].set_title("the map")
        for axes, (stamp, texture), extent in zip(panels[1:], stages, known, strict=True):
            style.show_unknown(axes)
            axes.imshow(with_opacity(texture), origin="lower", extent=extent, interpolation="antialiased")
            axes.imshow(dark, origin="lower", extent=occupancy.extent, interpolation="antialiased")
            until = trajectory.poses[trajectory.stamps <= stamp]
            axes.plot(until[:, 0], until[:, 1], color=style.SLAM, lw=0.8)
            style.mark_start(axes, trajectory.poses)
            if len(until):
                style.mark_ends(axes, (until, style.SLAM), label="robot")
            axes.set_title(f"{stamp - trajectory.stamps[0]:.0f} s")
        style.legend_below(figure, *panels[:2])


@contextmanager
def _panels(
    path: str | PathLike[str],
    count: int,
    points: NDArray[np.float64],
    *,
    width: float,
    columns: tuple[int, int],
    title: str,
) -> Iterator[tuple[Figure, list[Axes]]]:
    """A figure of floor plans that share their limits, and their axes.

    Args:
        path: of the PNG.
        count: of the plans.
        points: [n, 2] that all of them show [m].
        width: of the figure [inch].
        columns: of plans at most, where they are high, and where they are not; 2 of wide ones.
        title: over the figure.
    """
    wide, high = np.ptp(points, axis=0) + 1.0
    across = min(count, columns[0] if high > 2 * wide else 2 if high < 0.3 * wide else columns[1])
    rows = -(-count // across)
    panel_height = min(max(width / across * high / wide, 0.7), 8.0)
    with style.saved_figure(path, size=(width, rows * (panel_height + 0.25) + 0.9)) as figure:
        grid = figure.subplots(rows, across, sharex=True, sharey=True, squeeze=False)
        panels = list(grid.flat)
        for axes in panels[:count]:
            style.plan(axes, labels=False)
        for axes in panels[count:]:
            axes.set_visible(False)
        yield figure, panels[:count]
        style.show_everything(panels[0], points, margin=0.5)
        for axes in grid[-1]:
            axes.set_xlabel("x [m]")
        for axes in grid[:, 0]:
            axes.set_ylabel("y [m]")
        style.heading(figure, title)
