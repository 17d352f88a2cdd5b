"""The map and the coloured floor at stages of a run, kept and drawn side by side."""

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
from moteslam.robot.raster import Raster
from moteslam.robot.trajectory import Trajectory
from moteslam.slam.run import SlamSession
from moteslam.slam.scan_records import Update
from moteslam.slam.texture.floor_map import TextureMap, TextureMapper

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
    """Watches a session and keeps its map after each sixth of the scans."""

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
    """Watches the colouring and keeps the coloured floor, with its stamp, at six moments from begin to end [s]."""

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
    known = texture.known[..., None]
    return np.concatenate((np.where(known, texture.values, 255), np.where(known, 255, 0)), axis=-1).astype(np.uint8)


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
    with _panels(path, len(snapshots), points, width=11.0, columns=(6, 3), title=title) as panels:
        for axes, snapshot in zip(panels, snapshots, strict=True):
            draw_map(axes, snapshot.map)
            _draw_path(axes, trajectory.poses[: snapshot.index + 1], style.ONLINE, "robot")
            axes.set_title(f"{snapshot.stamp - trajectory.stamps[0]:.0f} s")


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
    corners = [np.reshape(texture.extent, (2, 2)).T for _, texture in stages]
    points = np.concatenate((trajectory.poses[:, :2], *corners))
    with _panels(path, len(stages) + 1, points, width=13.0, columns=(7, 4), title=title) as panels:
        draw_map(panels[0], occupancy)
        _draw_path(panels[0], trajectory.poses, "SLAM", "end")
        panels[0].set_title("the map")
        for axes, (stamp, texture) in zip(panels[1:], stages, strict=True):
            axes.set_facecolor(style.UNKNOWN)
            for picture, extent in ((with_opacity(texture), texture.extent), (dark, occupancy.extent)):
                axes.imshow(picture, origin="lower", extent=extent, interpolation="antialiased")
            until = max(1, int(np.searchsorted(trajectory.stamps, stamp, side="right")))
            _draw_path(axes, trajectory.poses[:until], "SLAM", "robot")
            axes.set_title(f"{stamp - trajectory.stamps[0]:.0f} s")


def _draw_path(axes: Axes, poses: NDArray[np.float64], name: str, end: str) -> None:
    axes.plot(*poses[:, :2].T, color=style.SLAM, lw=1.0, label=name)
    style.mark_start(axes, poses)
    style.mark_ends(axes, (poses, style.SLAM), label=end)


@contextmanager
def _panels(
    path: str | PathLike[str],
    count: int,
    points: NDArray[np.float64],
    *,
    width: float,
    columns: tuple[int, int],
    title: str,
) -> Iterator[list[Axes]]:
    """The axes of a figure of floor plans that share their limits.

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
    with style.saved_figure(path, size=(width, rows * (panel_height + 0.25) + 0.9), title=title) as figure:
        grid = figure.subplots(rows, across, sharex=True, sharey=True, squeeze=False)
        for place, axes in enumerate(grid.flat):
            style.plan(axes)
            axes.label_outer()
            axes.set_visible(place < count)
        style.show_everything(grid[0, 0], points)
        yield list(grid.flat)[:count]
