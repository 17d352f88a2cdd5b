"""The figure of the loops: between which places of the final path they were accepted, and where they were not."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from moteslam.eval.report import style
from moteslam.eval.report.plans import draw_map, map_corners
from moteslam.eval.run_tables import loop_counts
from moteslam.robot.raster import Raster
from moteslam.robot.trajectory import Trajectory
from moteslam.slam.backend.ledger import LoopCandidate

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ACCEPTED, REJECTED = "#D55E00", "#CC79A7"
"""From the palette of Okabe and Ito, as the path's blue."""
DRAWN = ("overruled", "contradicted", "ambiguous")
"""Verdicts of the rejected candidates that are drawn: a place was found there. The others are counted alone."""


def draw_loops(
    path: str | PathLike[str],
    occupancy: Raster,
    loops: Sequence[LoopCandidate],
    *,
    trajectory: Trajectory,
    title: str = "",
) -> None:
    """The map, on it the final path, and lines between the two poses of every loop.

    Args:
        path: of the PNG.
        occupancy: the map.
        loops: the candidates.
        trajectory: a pose at every scan, as known at the end.
        title: over the figure.

    Raises:
        OutputError: it cannot be written.
    """
    poses = trajectory.poses[:, :2]
    points = np.concatenate((poses, map_corners(occupancy)))
    accepted = [loop for loop in loops if loop.accepted]
    rejected = [loop for loop in loops if loop.verdict in DRAWN]
    counts = loop_counts(loops)
    others = {name: count for name, count in counts.items() if name not in ("candidates", "accepted", *DRAWN) and count}
    with style.saved_figure(path, size=style.plan_size(points)) as figure:
        axes = figure.subplots()
        draw_map(axes, occupancy)
        axes.plot(*poses.T, color=style.SLAM, lw=0.7, label=style.FINAL)
        look: dict[str, Any] = {"color": ACCEPTED, "lw": 1.6, "ls": "-", "ms": 3.5, "zorder": 5}
        _draw_lines(axes, trajectory, accepted, f"accepted: {len(accepted)}", look)
        look = {"color": REJECTED, "lw": 0.8, "ls": "--", "ms": 2.5, "zorder": 4}
        label = f"rejected: {', '.join(f'{counts[verdict]} {verdict}' for verdict in DRAWN)}"
        _draw_lines(axes, trajectory, rejected, label, look)
        if others:
            named = ", ".join(f"{count} {verdict}" for verdict, count in others.items())
            axes.plot([], [], ls="", label=f"not drawn: {named}")
        style.mark_start(axes, poses)
        style.mark_ends(axes, (poses, style.SLAM))
        style.plan(axes)
        style.show_everything(axes, points, margin=0.5)
        style.legend_below(figure, axes, columns=3 if figure.get_figwidth() > 7 else 1)
        style.heading(figure, title)


def _draw_lines(
    axes: Axes, trajectory: Trajectory, loops: Sequence[LoopCandidate], label: str, look: dict[str, Any]
) -> None:
    """Lines with dots at their ends, one a loop, as one artist: a loop of a metre is still seen on a large map."""
    scans = np.array([(loop.earlier, loop.later) for loop in loops], np.intp).reshape(-1, 2)
    ends = np.full((len(loops), 3, 2), np.nan)  # the gap after each line keeps it from the next
    ends[:, :2] = trajectory.poses[scans, :2]
    axes.plot(*ends.reshape(-1, 2).T, marker="o", mew=0, label=label, **look)
