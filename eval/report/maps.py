"""Figures of the map seen from above: paths, dead reckoning and loops on it, and what it was at stages of the run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import File
from moteslam.eval.metrics.association import evenly
from moteslam.eval.metrics.ate import absolute_trajectory_error
from moteslam.eval.report import style
from moteslam.eval.report.style import STYLE
from moteslam.eval.run_tables import loop_counts
from moteslam.robot.raster import Raster
from moteslam.robot.recording import Recording
from moteslam.robot.se2 import Array, between, compose, inverse, umeyama
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import expect_type
from moteslam.slam.backend.protocol import LoopCandidate
from moteslam.slam.online import OnlineSlam
from moteslam.slam.scan_records import Update
from moteslam.slam.texture.floor_map import TextureMap, TextureMapper

Way = Trajectory | None
Snapshots = Sequence[tuple[int, Raster]]  # The map after scans of these indices
Stages = Sequence[tuple[float, TextureMap]]  # The coloured floor at stamps [s]

SCANS_DRAWN, BEAMS_DRAWN = 400, 180
"""At most this number of a recording's scans, and of the beams of each, is drawn under dead reckoning."""
STRAY = 0.002
"""Share of the endpoints at either end of x and y that the limits of the axes may leave out: single far readings."""
ACCEPTED, REJECTED = "#D55E00", "#CC79A7"
"""Of loops; from the palette of Okabe and Ito, as the path's blue."""
REJECTED_DRAWN = ("overruled", "contradicted", "ambiguous")
"""Verdicts of the rejected candidates that are drawn: a place was found there. The others are counted alone."""


def draw_map(axes: style.Axes, occupancy: Raster) -> None:
    """The map: white where free, a light grey where unknown and beyond, dark where occupied."""
    from matplotlib.axes import Axes

    expect_type(axes, Axes, "axes", "pyplot.subplots() makes them")
    expect_type(occupancy, Raster, "occupancy", "estimate.map is one")
    belief = np.tanh(np.asarray(occupancy.values, np.float64) / 2)  # 2 p - 1: -1 free, 0 unknown, 1 occupied
    end = np.where(belief < 0, STYLE.map_free, STYLE.map_occupied)
    greys = STYLE.map_unknown + (end - STYLE.map_unknown) * np.abs(belief)
    axes.set_facecolor(style.UNKNOWN)
    look: dict[str, Any] = {"cmap": "gray", "vmin": 0, "vmax": 1, "interpolation": "antialiased"}
    axes.imshow(greys, origin="lower", extent=occupancy.extent, zorder=0, **look)


def map_corners(occupancy: Raster) -> Array:
    """Lower left and upper right corner [2, 2] of what the map knows [m]; none [0, 2] of an empty map."""
    expect_type(occupancy, Raster, "occupancy", "estimate.map is one")
    known = np.argwhere(occupancy.values != 0)[:, ::-1]
    if not len(known):
        return np.zeros((0, 2))
    return np.asarray(occupancy.to_world(np.array([known.min(axis=0), known.max(axis=0) + 1])))


def draw_trajectories(
    path: File, occupancy: Raster, *, slam: Trajectory, dead_reckoning: Way = None, truth: Way = None, title: str = ""
) -> None:
    """The map, and on it the paths of the truth, of SLAM and of dead reckoning, in SLAM's frame; ``trajectory_final``
    is the path of SLAM that fits the map.

    With a truth both paths lie on it by least squares, as for the absolute error; without, they start at one pose.
    Dead reckoning without odometry, which stands still, is no path.
    """
    true, back = (None, slam.poses[0]) if truth is None else _in_frame_of(slam, truth)
    odometry = None
    if dead_reckoning is not None and dead_reckoning.length > 0:
        begin = dead_reckoning.poses[0] if truth is None else _in_frame_of(dead_reckoning, truth)[1]
        odometry = compose(back, between(begin, dead_reckoning.poses))
    given: tuple[tuple[Array | None, dict[str, Any]], ...] = (
        (true, {**style.TRUTH_BAND, "label": "reference"}),
        (odometry, {"color": style.DEAD_RECKONING, "lw": 1.1, "ls": "--", "label": "dead reckoning"}),
        (slam.poses, {"color": style.SLAM, "lw": 1.3, "label": "SLAM"}),
    )
    shown = [(poses, look) for poses, look in given if poses is not None]
    points = np.concatenate([*(poses[:, :2] for poses, _ in shown), map_corners(occupancy)])
    with style.saved_plan(path, points, title=title) as axes:
        draw_map(axes, occupancy)
        style.draw_paths(axes, *shown, start=slam.poses)


def _in_frame_of(trajectory: Trajectory, truth: Trajectory, *, from_start: bool = False) -> tuple[Array, Array]:
    """The truth [n, 3] where a trajectory has been laid on it, and the motion [3] that takes it there."""
    ate = absolute_trajectory_error(trajectory, truth, from_start=from_start)
    back = inverse(ate.transform)
    if ate.space is not None:  # its poses are those in the plane of motion
        back = umeyama(ate.aligned[:, :2], trajectory.at(ate.stamps).poses[:, :2])
    return compose(back, ate.reference), np.asarray(back)


def draw_dead_reckoning(
    path: File, trajectory: Trajectory, *, recording: Recording | None = None, truth: Way = None, title: str = ""
) -> None:
    """Dead reckoning, with the scans where it would put them (figures 5 and 6): their walls drift apart.

    Scans are drawn where the trajectory has a pose for each. The truth starts at the first pose that both have;
    without headings it is laid by least squares.
    """
    walls = np.zeros((0, 2))
    if recording is not None and recording.lidar is not None and len(recording.lidar) == len(trajectory):
        lidar = recording.lidar
        scans = evenly(np.arange(len(lidar)), SCANS_DRAWN)
        beams = slice(None, None, max(1, -(-lidar.ranges.shape[1] // BEAMS_DRAWN)))
        ranges = lidar.ranges[scans, beams].astype(np.float64)
        ranges[np.isinf(ranges)] = np.nan  # infinity times zero is a warning
        x, y, heading = compose(trajectory.poses[scans], recording.platform.lidar.pose).T[..., None]
        directions = heading + lidar.angles[beams]
        ends = np.stack((x + ranges * np.cos(directions), y + ranges * np.sin(directions)), axis=-1)
        walls = np.asarray(ends[np.isfinite(ranges)])
    true = None if truth is None else _in_frame_of(trajectory, truth, from_start=truth.oriented)[0]
    paths = [] if true is None else [(true, {**style.TRUTH_BAND, "label": "reference"})]
    paths.append((trajectory.poses, {"color": style.DEAD_RECKONING, "lw": 1.4, "label": "dead reckoning"}))
    limits = np.quantile(walls, (STRAY, 1 - STRAY), axis=0) if len(walls) else walls
    points = np.concatenate([*(poses[:, :2] for poses, _ in paths), limits])
    with style.saved_plan(path, points, title=title, margin=1.0) as axes:
        if len(walls):
            axes.plot(walls[:, 0], walls[:, 1], ",", color="0.45", alpha=0.5)
            axes.plot([], [], ".", color="0.45", label="endpoints of scans")
        style.draw_paths(axes, *paths, start=trajectory.poses)


def draw_loops(
    path: File, occupancy: Raster, loops: Sequence[LoopCandidate], *, trajectory: Trajectory, title: str = ""
) -> None:
    """The map, on it the final path (a pose at every scan), and lines between the two poses of every loop."""
    poses = trajectory.poses[:, :2]
    counts = loop_counts(loops)
    rejected = f"rejected: {', '.join(f'{counts[verdict]} {verdict}' for verdict in REJECTED_DRAWN)}"
    lines: tuple[tuple[tuple[str, ...], str, dict[str, Any]], ...] = (
        (("accepted",), f"accepted: {counts['accepted']}", {"color": ACCEPTED, "lw": 1.6, "ms": 3.5, "zorder": 5}),
        (REJECTED_DRAWN, rejected, {"color": REJECTED, "lw": 0.8, "ls": "--", "ms": 2.5, "zorder": 4}),
    )
    drawn = ("candidates", "accepted", *REJECTED_DRAWN)
    others = [f"{count} {verdict}" for verdict, count in counts.items() if count and verdict not in drawn]
    with style.saved_plan(path, np.concatenate((poses, map_corners(occupancy))), title=title, columns=(3, 1)) as axes:
        draw_map(axes, occupancy)
        style.draw_paths(axes, (poses, {"color": style.SLAM, "lw": 0.7, "label": style.FINAL}), start=poses)
        for verdicts, label, look in lines:
            scans = [(loop.earlier, loop.later) for loop in loops if loop.verdict in verdicts]
            ends = np.full((len(scans), 3, 2), np.nan)  # lines as one artist, each apart from the next
            ends[:, :2] = poses[np.reshape(scans, (-1, 2)).astype(np.intp)]
            axes.plot(*ends.reshape(-1, 2).T, marker="o", mew=0, label=label, **look)
        if others:
            axes.plot([], [], ls="", label=f"not drawn: {', '.join(others)}")


STAGES = 6  # Of a run
SCANS = 250
"""At most this many scans are drawn into the map of a stage but the last: its panel is small."""


def keep_map(kept: list[tuple[int, Raster]], session: OnlineSlam, update: Update) -> None:
    """Add the map of a session, with the index of the scan, if this ends a sixth of it."""
    total = len(session)
    if update.index in np.arange(1, STAGES + 1) * total // STAGES - 1:
        kept.append((update.index, session.map if update.index == total - 1 else session.preview(SCANS)))


def keep_floor(kept: list[tuple[float, TextureMap]], stamp: float, mapper: TextureMapper, span: Array) -> None:
    """Add the coloured floor, with its stamp, for each of six moments from begin to end, a span [2] [s], that a frame's
    stamp [s] has come to.
    """
    for due in np.linspace(span[0], span[1], STAGES + 1)[1:].tolist()[len(kept) :]:
        if stamp >= due:
            kept.append((due, mapper.snapshot()))


def with_opacity(texture: TextureMap) -> NDArray[np.uint8]:
    """The map as colours [H, W, 4]: red, green, blue, and an opacity of 0 where nothing is known; row 0 smallest y."""
    known = texture.known[..., None]
    return np.concatenate((np.where(known, texture.values, 255), np.where(known, 255, 0)), axis=-1).astype(np.uint8)


def draw_over_time(
    path: File, snapshots: Snapshots, *, trajectory: Trajectory, placed: NDArray[np.bool_], title: str = ""
) -> None:
    """The map at stages of the run, one at least, and the trajectory, as it was known at each scan, until then.

    All at one scale: figures 1 and 2 of the paper. Poses that are not ``placed`` [n] in the map are left out.
    """
    poses, first = np.where(placed[:, None], trajectory.poses, np.nan), int(placed.argmax())
    points = np.concatenate([poses[np.isfinite(poses).all(axis=1), :2], map_corners(snapshots[-1][1])])
    with _panels(path, len(snapshots), points, width=11.0, columns=(6, 3), title=title) as panels:
        for axes, (index, occupancy) in zip(panels, snapshots, strict=True):
            draw_map(axes, occupancy)
            _draw_path(axes, poses[min(first, index) : index + 1], style.ONLINE, "robot")
            axes.set_title(f"{trajectory.stamps[index] - trajectory.stamps[0]:.0f} s")


def draw_texture_over_time(
    path: File, stages: Stages, occupancy: Raster, *, trajectory: Trajectory, title: str = ""
) -> None:
    """The map and, beside it, the coloured floor at stages of the run (figures 3 and 4 of the paper).

    Over the colours are the walls of the map, and the trajectory along which the floor was coloured until then.
    """
    belief = np.tanh(occupancy.values / 2)
    dark = np.zeros((*belief.shape, 4), np.uint8)
    dark[..., 3] = 255 * np.where(belief > 0, 0.8 * belief, 0.0)
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


def _draw_path(axes: style.Axes, poses: Array, name: str, end: str) -> None:
    style.draw_paths(axes, (poses, {"color": style.SLAM, "lw": 1.0, "label": name}), start=poses, end=end)


@contextmanager
def _panels(
    path: File, count: int, points: Array, *, width: float, columns: tuple[int, int], title: str
) -> Iterator[list[style.Axes]]:
    """The axes of a figure of this width [inch] with that many floor plans, all of which show points [n, 2] [m].

    ``columns`` are as many plans as stand side by side where they are high, and where they are not; 2 of wide ones do.
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
