"""Figures of the map seen from above: paths, dead reckoning and loops on it."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from moteslam.eval.metrics.association import evenly
from moteslam.eval.report import style
from moteslam.eval.run_tables import loop_counts
from moteslam.robot.raster import Raster
from moteslam.robot.recording import Recording
from moteslam.robot.se2 import compose
from moteslam.robot.trajectory import Trajectory
from moteslam.slam.backend.ledger import LoopCandidate

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

SCANS_DRAWN, BEAMS_DRAWN = 400, 180
"""At most this number of a recording's scans, and of the beams of each, is drawn under dead reckoning."""
STRAY = 0.002
"""Share of the endpoints at either end of x and y that the limits of the axes may leave out: single far readings."""
ACCEPTED, REJECTED = "#D55E00", "#CC79A7"
"""Of loops; from the palette of Okabe and Ito, as the path's blue."""
REJECTED_DRAWN = ("overruled", "contradicted", "ambiguous")
"""Verdicts of the rejected candidates that are drawn: a place was found there. The others are counted alone."""


def draw_map(axes: Axes, occupancy: Raster) -> None:
    """The map: white where free, a light grey where unknown and beyond, dark where occupied."""
    axes.set_facecolor(style.UNKNOWN)
    look: dict[str, Any] = {"cmap": "gray", "vmin": 0, "vmax": 1, "interpolation": "antialiased"}
    axes.imshow(style.map_greys(occupancy.values), origin="lower", extent=occupancy.extent, zorder=0, **look)


def map_corners(occupancy: Raster) -> Array:
    """Lower left and upper right corner [2, 2] of what the map knows [m]; none [0, 2] of an empty map."""
    known = np.argwhere(occupancy.values != 0)[:, ::-1]
    if not len(known):
        return np.zeros((0, 2))
    return np.asarray(occupancy.to_world(np.array([known.min(axis=0), known.max(axis=0) + 1])))


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
    given: tuple[tuple[Trajectory | None, dict[str, Any]], ...] = (
        (truth, {**style.TRUTH_BAND, "label": "truth"}),
        (dead_reckoning, {"color": style.DEAD_RECKONING, "lw": 1.1, "ls": "--", "label": "dead reckoning"}),
        (slam, {"color": style.SLAM, "lw": 1.3, "label": style.FINAL}),
    )
    shown = [(trajectory.poses, look) for trajectory, look in given if trajectory is not None]
    points = np.concatenate([*(poses[:, :2] for poses, _ in shown), map_corners(occupancy)])
    with style.saved_plan(path, points, title=title) as axes:
        draw_map(axes, occupancy)
        for poses, look in shown:
            axes.plot(*poses[:, :2].T, **look)
        style.mark_start(axes, slam.poses)
        style.mark_ends(axes, *((poses, look["color"]) for poses, look in shown))


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
    with style.saved_plan(path, points, title=title, margin=1.0) as axes:
        if len(walls):
            axes.plot(walls[:, 0], walls[:, 1], ",", color="0.45", alpha=0.5)
            axes.plot([], [], ".", color="0.45", label="endpoints of scans")
        if truth is not None:
            axes.plot(*truth.poses[:, :2].T, label="truth", **style.TRUTH_BAND)
        axes.plot(*trajectory.poses[:, :2].T, color=style.DEAD_RECKONING, lw=1.4, label="dead reckoning")
        style.mark_start(axes, trajectory.poses)
        style.mark_ends(axes, *paths)


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
    counts = loop_counts(loops)
    accepted = [loop for loop in loops if loop.accepted]
    rejected = [loop for loop in loops if loop.verdict in REJECTED_DRAWN]
    others = [f"{counts[name]} {name}" for name in list(counts)[1:] if name not in ("accepted", *REJECTED_DRAWN)]
    others = [text for text in others if not text.startswith("0 ")]
    with style.saved_plan(path, np.concatenate((poses, map_corners(occupancy))), title=title, columns=(3, 1)) as axes:
        draw_map(axes, occupancy)
        axes.plot(*poses.T, color=style.SLAM, lw=0.7, label=style.FINAL)
        look: dict[str, Any] = {"color": ACCEPTED, "lw": 1.6, "ls": "-", "ms": 3.5, "zorder": 5}
        axes.plot(*_lines(trajectory, accepted).T, marker="o", mew=0, label=f"accepted: {len(accepted)}", **look)
        look = {"color": REJECTED, "lw": 0.8, "ls": "--", "ms": 2.5, "zorder": 4}
        label = f"rejected: {', '.join(f'{counts[verdict]} {verdict}' for verdict in REJECTED_DRAWN)}"
        axes.plot(*_lines(trajectory, rejected).T, marker="o", mew=0, label=label, **look)
        if others:
            axes.plot([], [], ls="", label=f"not drawn: {', '.join(others)}")
        style.mark_start(axes, poses)
        style.mark_ends(axes, (poses, style.SLAM))


def _lines(trajectory: Trajectory, loops: Sequence[LoopCandidate]) -> Array:
    """The two ends of every loop and a NaN [3 n, 2]: lines as one artist, each apart from the next."""
    scans = np.array([(loop.earlier, loop.later) for loop in loops], np.intp).reshape(-1, 2)
    ends = np.full((len(loops), 3, 2), np.nan)
    ends[:, :2] = trajectory.poses[scans, :2]
    return ends.reshape(-1, 2)


def _endpoints(recording: Recording, trajectory: Trajectory) -> Array:
    """Endpoints [k, 2] of an even choice of scans and beams, where the trajectory puts them [m]."""
    lidar = recording.lidar
    assert lidar is not None
    scans = evenly(np.arange(len(lidar)), SCANS_DRAWN)
    beams = slice(None, None, max(1, -(-lidar.ranges.shape[1] // BEAMS_DRAWN)))
    ranges = lidar.ranges[scans, beams].astype(np.float64)
    x, y, heading = compose(trajectory.poses[scans], recording.platform.lidar.pose).T[..., None]
    directions = heading + lidar.angles[beams]
    ends = np.stack((x + ranges * np.cos(directions), y + ranges * np.sin(directions)), axis=-1)
    return np.asarray(ends[np.isfinite(ranges)])
