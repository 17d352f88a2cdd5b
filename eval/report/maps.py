"""The map: as files, and figures of paths, dead reckoning and loops seen from above."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from moteslam.eval.report import style
from moteslam.eval.run_tables import loop_counts
from moteslam.robot.files import write_atomically
from moteslam.robot.formats.map_server import map_image, trinary, write_map
from moteslam.robot.pictures import encode_png
from moteslam.robot.raster import MapArrays, Raster
from moteslam.robot.recording import Recording
from moteslam.robot.se2 import compose
from moteslam.robot.trajectory import Trajectory
from moteslam.slam.backend.ledger import LoopCandidate

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SCANS_DRAWN, BEAMS_DRAWN = 400, 180
"""At most this number of a recording's scans, and of the beams of each, is drawn under dead reckoning."""
STRAY = 0.002
"""Share of the endpoints at either end of x and y that the limits of the axes may leave out: single far readings."""
ACCEPTED, REJECTED = "#D55E00", "#CC79A7"
"""Of loops; from the palette of Okabe and Ito, as the path's blue."""
REJECTED_DRAWN = ("overruled", "contradicted", "ambiguous")
"""Verdicts of the rejected candidates that are drawn: a place was found there. The others are counted alone."""


def write_map_png(path: str | PathLike[str], occupancy: Raster) -> None:
    """Write the map as a grey PNG, a pixel a cell.

    Raises:
        OutputError: it cannot be written.
    """
    write_atomically(path, encode_png(map_image(occupancy.values)))


def write_map_server(path: str | PathLike[str], occupancy: Raster) -> None:
    """Write ``map.pgm`` and, beside it, ``map.yaml`` as map_server and nav2 read them (trinary).

    Raises:
        OutputError: one of them cannot be written.
    """
    write_map(path, Raster(trinary(occupancy.values), occupancy.cell_size, occupancy.origin))


def log_odds_arrays(occupancy: Raster) -> MapArrays:
    """The map as it goes into ``map.npz``: log-odds as they are."""
    return MapArrays(
        kind="log_odds",
        arrays={"log_odds": occupancy.values},
        cell_size=occupancy.cell_size,
        origin=occupancy.origin,
    )


def draw_map(axes: Axes, occupancy: Raster) -> None:
    """The map: white where free, a light grey where unknown, dark where occupied."""
    style.show_unknown(axes)
    look: dict[str, Any] = {"cmap": "gray", "vmin": 0, "vmax": 1, "interpolation": "antialiased"}
    axes.imshow(style.map_greys(occupancy.values), origin="lower", extent=occupancy.extent, zorder=0, **look)


def map_corners(occupancy: Raster) -> NDArray[np.float64]:
    """Lower left and upper right corner [2, 2] of what the map knows [m]; none [0, 2] of an empty map."""
    known = occupancy.values != 0
    rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    if not len(rows):
        return np.zeros((0, 2))
    cells = np.array([[columns[0], rows[0]], [columns[-1] + 1, rows[-1] + 1]])
    return np.asarray(occupancy.to_world(cells))


def draw_trajectories(
    path: str | PathLike[str],
    occupancy: Raster,
    *,
    slam: Trajectory,
    dead_reckoning: Trajectory | None = None,
    truth: Trajectory | None = None,
    title: str = "",
) -> None:
    """The map, and on it the paths of the truth, of SLAM as known at the end, and of dead reckoning, in its frame."""
    shown = [t.poses[:, :2] for t in (slam, dead_reckoning, truth) if t is not None]
    points = np.concatenate([*shown, map_corners(occupancy)])
    with style.saved_figure(path, size=style.plan_size(points)) as figure:
        axes = figure.subplots()
        draw_map(axes, occupancy)
        if truth is not None:
            _draw_truth(axes, truth)
        if dead_reckoning is not None:
            look: dict[str, Any] = {"color": style.DEAD_RECKONING, "lw": 1.1, "ls": "--"}
            axes.plot(*dead_reckoning.poses[:, :2].T, label="dead reckoning", **look)
        axes.plot(*slam.poses[:, :2].T, color=style.SLAM, lw=1.3, label=style.FINAL)
        style.mark_start(axes, slam.poses)
        drawn = ((truth, style.TRUTH), (dead_reckoning, style.DEAD_RECKONING), (slam, style.SLAM))
        style.mark_ends(axes, *((t.poses, colour) for t, colour in drawn if t is not None))
        style.plan(axes)
        style.show_everything(axes, points, margin=0.5)
        style.legend_below(figure, axes)
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
    """
    walls = np.zeros((0, 2))
    if recording is not None and recording.lidar is not None and len(recording.lidar) == len(trajectory):
        walls = _endpoints(recording, trajectory)
    paths = [] if truth is None else [(truth.poses, style.TRUTH)]
    paths.append((trajectory.poses, style.DEAD_RECKONING))
    limits = np.quantile(walls, (STRAY, 1 - STRAY), axis=0) if len(walls) else walls
    points = np.concatenate([*(poses[:, :2] for poses, _ in paths), limits])
    with style.saved_figure(path, size=style.plan_size(points)) as figure:
        axes = figure.subplots()
        if len(walls):
            axes.plot(walls[:, 0], walls[:, 1], ",", color="0.45", alpha=0.5)
            axes.plot([], [], ".", color="0.45", label="endpoints of scans")
        if truth is not None:
            _draw_truth(axes, truth)
        axes.plot(*trajectory.poses[:, :2].T, color=style.DEAD_RECKONING, lw=1.4, label="dead reckoning")
        style.mark_start(axes, trajectory.poses)
        style.mark_ends(axes, *paths)
        style.plan(axes)
        style.show_everything(axes, points)
        style.legend_below(figure, axes)
        style.heading(figure, title)


def draw_loops(
    path: str | PathLike[str],
    occupancy: Raster,
    loops: Sequence[LoopCandidate],
    *,
    trajectory: Trajectory,
    title: str = "",
) -> None:
    """The map, on it the final path (a pose at every scan), and lines between the two poses of every loop."""
    poses = trajectory.poses[:, :2]
    points = np.concatenate((poses, map_corners(occupancy)))
    accepted = [loop for loop in loops if loop.accepted]
    rejected = [loop for loop in loops if loop.verdict in REJECTED_DRAWN]
    counts = loop_counts(loops)
    drawn = ("candidates", "accepted", *REJECTED_DRAWN)
    others = ", ".join(f"{count} {name}" for name, count in counts.items() if name not in drawn and count)
    with style.saved_figure(path, size=style.plan_size(points)) as figure:
        axes = figure.subplots()
        draw_map(axes, occupancy)
        axes.plot(*poses.T, color=style.SLAM, lw=0.7, label=style.FINAL)
        look: dict[str, Any] = {"color": ACCEPTED, "lw": 1.6, "ls": "-", "ms": 3.5, "zorder": 5}
        axes.plot(*_lines(trajectory, accepted).T, marker="o", mew=0, label=f"accepted: {len(accepted)}", **look)
        look = {"color": REJECTED, "lw": 0.8, "ls": "--", "ms": 2.5, "zorder": 4}
        label = f"rejected: {', '.join(f'{counts[verdict]} {verdict}' for verdict in REJECTED_DRAWN)}"
        axes.plot(*_lines(trajectory, rejected).T, marker="o", mew=0, label=label, **look)
        if others:
            axes.plot([], [], ls="", label=f"not drawn: {others}")
        style.mark_start(axes, poses)
        style.mark_ends(axes, (poses, style.SLAM))
        style.plan(axes)
        style.show_everything(axes, points, margin=0.5)
        style.legend_below(figure, axes, columns=3 if figure.get_figwidth() > 7 else 1)
        style.heading(figure, title)


def _lines(trajectory: Trajectory, loops: Sequence[LoopCandidate]) -> NDArray[np.float64]:
    """The two ends of every loop and a NaN [3 n, 2]: lines as one artist, each apart from the next."""
    scans = np.array([(loop.earlier, loop.later) for loop in loops], np.intp).reshape(-1, 2)
    ends = np.full((len(loops), 3, 2), np.nan)
    ends[:, :2] = trajectory.poses[scans, :2]
    return ends.reshape(-1, 2)


def _draw_truth(axes: Axes, truth: Trajectory) -> None:
    axes.plot(*truth.poses[:, :2].T, color=style.TRUTH, lw=4.0, alpha=0.55, label="truth")


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
