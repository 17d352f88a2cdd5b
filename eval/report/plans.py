"""Figures seen from above: paths on the map, the map over time, dead reckoning."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from moteslam.eval.report import style
from moteslam.eval.report.snapshots import Snapshot
from moteslam.robot.raster import Raster
from moteslam.robot.recording import Recording
from moteslam.robot.se2 import compose
from moteslam.robot.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SCANS_DRAWN, BEAMS_DRAWN = 400, 180
"""At most this number of a recording's scans, and of the beams of each, is drawn under dead reckoning."""
STRAY = 0.002
"""Share of the endpoints at either end of x and y that the limits of the axes may leave out: single far readings."""


def draw_trajectories(
    path: str | PathLike[str],
    occupancy: Raster,
    *,
    slam: Trajectory,
    dead_reckoning: Trajectory | None = None,
    truth: Trajectory | None = None,
    title: str = "",
) -> None:
    """The map, and on it the paths of the truth, of SLAM as known at the end, and of dead reckoning.

    Args:
        path: of the PNG.
        occupancy: the map.
        slam, dead_reckoning, truth: all in the frame of the map.
        title: over the figure.

    Raises:
        OutputError: it cannot be written.
    """
    shown = [t.poses[:, :2] for t in (slam, dead_reckoning, truth) if t is not None]
    points = np.concatenate([*shown, map_corners(occupancy)])
    with style.saved_figure(path, size=style.plan_size(points)) as figure:
        axes = figure.subplots()
        draw_map(axes, occupancy)
        if truth is not None:
            _draw_path(axes, truth, style.TRUTH, "truth", width=4.0, alpha=0.55)
        if dead_reckoning is not None:
            _draw_path(axes, dead_reckoning, style.DEAD_RECKONING, "dead reckoning", width=1.1, dashes="--")
        _draw_path(axes, slam, style.SLAM, style.FINAL, width=1.3)
        style.mark_start(axes, slam.poses)
        drawn = ((truth, style.TRUTH), (dead_reckoning, style.DEAD_RECKONING), (slam, style.SLAM))
        style.mark_ends(axes, *((t.poses, colour) for t, colour in drawn if t is not None))
        style.plan(axes)
        style.show_everything(axes, points, margin=0.5)
        style.legend_below(figure, axes)
        style.heading(figure, title)


def draw_over_time(
    path: str | PathLike[str], snapshots: Sequence[Snapshot], *, trajectory: Trajectory, title: str = ""
) -> None:
    """The trajectory and the map at stages of the run (figures 1 and 2 of the paper), all at one scale.

    Args:
        path: of the PNG.
        snapshots: of the map, at least one.
        trajectory: as it was known at each scan.
        title: over the figure.

    Raises:
        OutputError: it cannot be written.
    """
    points = np.concatenate([trajectory.poses[:, :2], map_corners(snapshots[-1].map)])
    width, height = np.ptp(points, axis=0) + 1.0
    columns = min(len(snapshots), 6 if height > 2 * width else 2 if height < 0.3 * width else 3)
    rows = -(-len(snapshots) // columns)
    panel_height = min(max(11.0 / columns * height / width, 0.7), 8.0)
    with style.saved_figure(path, size=(11.0, rows * (panel_height + 0.25) + 0.9)) as figure:
        grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        for axes, snapshot in zip(grid.flat, snapshots, strict=False):
            until = trajectory.poses[: snapshot.index + 1]
            draw_map(axes, snapshot.map)
            axes.plot(until[:, 0], until[:, 1], color=style.SLAM, lw=1.1, label=style.ONLINE)
            style.mark_start(axes, until)
            style.mark_ends(axes, (until, style.SLAM), label="robot")
            axes.set_title(f"{snapshot.stamp - trajectory.stamps[0]:.0f} s")
            style.plan(axes, labels=False)
        for axes in list(grid.flat)[len(snapshots) :]:
            axes.set_visible(False)
        style.show_everything(grid[0, 0], points, margin=0.5)
        for axes in grid[-1]:
            axes.set_xlabel("x [m]")
        for axes in grid[:, 0]:
            axes.set_ylabel("y [m]")
        style.legend_below(figure, grid[0, 0])
        style.heading(figure, title)


def draw_dead_reckoning(
    path: str | PathLike[str],
    trajectory: Trajectory,
    *,
    recording: Recording | None = None,
    truth: Trajectory | None = None,
    title: str = "",
) -> None:
    """Dead reckoning, with the scans where it would put them (figures 5 and 6): their walls drift apart.

    Args:
        path: of the PNG.
        trajectory: of dead reckoning; at every scan where there are scans.
        recording: whose scans are drawn; None, or one without, draws the path alone.
        truth: in the frame of dead reckoning: both start at the same pose.
        title: over the figure.

    Raises:
        OutputError: it cannot be written.
    """
    walls = np.zeros((0, 2))
    if recording is not None and recording.lidar is not None and len(recording.lidar) == len(trajectory):
        walls = _endpoints(recording, trajectory)
    paths = [] if truth is None else [(truth.poses, style.TRUTH)]
    paths.append((trajectory.poses, style.DEAD_RECKONING))
    points = np.concatenate([*(poses[:, :2] for poses, _ in paths), _without_stray(walls)])
    with style.saved_figure(path, size=style.plan_size(points)) as figure:
        axes = figure.subplots()
        if len(walls):
            axes.plot(walls[:, 0], walls[:, 1], ",", color="0.45", alpha=0.5)
            axes.plot([], [], ".", color="0.45", label="endpoints of scans")
        if truth is not None:
            _draw_path(axes, truth, style.TRUTH, "truth", width=4.0, alpha=0.55)
        _draw_path(axes, trajectory, style.DEAD_RECKONING, "dead reckoning", width=1.4)
        style.mark_start(axes, trajectory.poses)
        style.mark_ends(axes, *paths)
        style.plan(axes)
        style.show_everything(axes, points)
        style.legend_below(figure, axes)
        style.heading(figure, title)


def draw_map(axes: Axes, occupancy: Raster) -> None:
    """The map: white where free, a light grey where unknown, dark where occupied."""
    style.show_unknown(axes)
    look: dict[str, Any] = {"cmap": "gray", "vmin": 0, "vmax": 1, "interpolation": "antialiased"}
    axes.imshow(style.map_greys(occupancy.values), origin="lower", extent=occupancy.extent, zorder=0, **look)


def _draw_path(
    axes: Axes, trajectory: Trajectory, colour: str, label: str, *, width: float, dashes: str = "-", alpha: float = 1.0
) -> None:
    axes.plot(
        trajectory.poses[:, 0],
        trajectory.poses[:, 1],
        dashes,
        color=colour,
        lw=width,
        alpha=alpha,
        label=label,
    )


def map_corners(occupancy: Raster) -> NDArray[np.float64]:
    """Lower left and upper right corner [2, 2] of what the map knows [m]."""
    known = occupancy.values != 0
    rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    if not len(rows):
        return np.zeros((0, 2))
    cells = np.array([[columns[0], rows[0]], [columns[-1] + 1, rows[-1] + 1]])
    return np.asarray(occupancy.to_world(cells))


def _endpoints(recording: Recording, trajectory: Trajectory) -> NDArray[np.float64]:
    """Endpoints [k, 2] of an even choice of scans and beams, where the trajectory puts them [m]."""
    lidar = recording.lidar
    assert lidar is not None
    scans = np.unique(np.linspace(0, len(lidar) - 1, min(len(lidar), SCANS_DRAWN)).round().astype(int))
    beams = slice(None, None, max(1, -(-lidar.ranges.shape[1] // BEAMS_DRAWN)))
    ranges, angles = lidar.ranges[scans, beams].astype(np.float64), lidar.angles[beams]
    mounts = compose(trajectory.poses[scans], recording.platform.lidar.pose)
    directions = mounts[:, 2:] + angles
    scan, beam = np.nonzero(np.isfinite(ranges))
    reach, direction = ranges[scan, beam], directions[scan, beam]
    return np.stack((mounts[scan, 0] + reach * np.cos(direction), mounts[scan, 1] + reach * np.sin(direction)), axis=-1)


def _without_stray(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The corners [2, 2] of the rectangle that holds almost all points [k, 2]; none of no points."""
    return np.quantile(points, (STRAY, 1 - STRAY), axis=0) if len(points) else points
