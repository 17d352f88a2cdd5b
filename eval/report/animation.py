"""The frames of a film of a run: the robot, its beams and particles, and the map as it grows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import ConfigError
from moteslam.eval.report import style
from moteslam.robot import se2
from moteslam.robot.pictures import PictureStyle
from moteslam.sim.sensors.clock import EPOCH
from moteslam.sim.simulate import Simulation
from moteslam.slam.run import SlamSession
from moteslam.slam.scan_records import Update

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

MAX_FPS = 50.0
"""Frames a second. Browsers slow GIFs down that have more."""
MAX_SPEED = 10000.0
USUAL_LENGTH = 15.0
"""A film is at most this long where nobody asks for a speed [s]."""
SPEEDS = tuple(step for step in style.STEPS if 1 <= step <= 5000)
"""The speeds to choose from then."""
MAX_FRAMES = 2000
BEAMS_DRAWN = 90
PERSON, DOOR, BEAM = "#D55E00", "#CC79A7", "#E69F00"
STYLE = PictureStyle(font_size=12.0, dpi=100.0)
"""Text is 12 pixels high or more where a player shows a film 480 pixels high."""
PLAN = (9.0, 4.6)
"""Width and height that the plan takes at most [inch]."""
NARROWEST = 6.4
"""Width of the plan at least, for the legend and the caption [inch]."""
LEFT, RIGHT, BELOW, ABOVE = 0.75, 0.3, 1.35, 0.4
"""Beside the plan, below it (the legend) and above it (the caption) [inch]."""
NAME_SHOWN = 30
"""Characters of the scenario's name that the caption holds at most."""


@dataclass(frozen=True)
class Pace:
    """How fast a film goes.

    Attributes:
        fps: frames a second.
        speed: seconds of the run in a second of the film: 1 is real time.
    """

    fps: float
    speed: float

    def __post_init__(self) -> None:
        if not 1 <= self.fps <= MAX_FPS:
            raise ConfigError(f"{self.fps:g}, expected 1 to {MAX_FPS:g} frames a second", field="fps")
        if not 0.1 <= self.speed <= MAX_SPEED:
            raise ConfigError(f"{self.speed:g}, expected 0.1 to {MAX_SPEED:g} times real time", field="speed")

    @classmethod
    def of(cls, duration: float, *, fps: float = 15.0, speed: float | None = None) -> Pace:
        """The pace of a film of a run of this duration [s]; without a speed it takes at most ``USUAL_LENGTH``.

        Raises:
            ConfigError: a value out of bounds, or more than ``MAX_FRAMES`` frames.
        """
        if speed is None:
            speed = next((speed for speed in SPEEDS if duration / speed <= USUAL_LENGTH), SPEEDS[-1])
        pace = cls(fps, speed)
        if duration * fps / speed > MAX_FRAMES:
            found = f"{duration:.0f} s at {fps:g} frames a second and {speed:g} times real time"
            raise ConfigError(f"{found}, expected a speed for at most {MAX_FRAMES} frames", field="speed")
        return pace

    def moments(self, stamps: Array) -> NDArray[np.int64]:
        """For each frame [k] the index of the last scan before it, of scans with these stamps [n] [s].

        The last frame shows the last scan.
        """
        times = np.arange(stamps[0], stamps[-1], self.speed / self.fps)
        return np.append(np.searchsorted(stamps, times, side="right") - 1, len(stamps) - 1)

    def __str__(self) -> str:
        return f"{self.speed:g} × real time, {self.fps:g} frames/s"


def film(
    simulation: Simulation, session: SlamSession, pace: Pace
) -> Iterator[tuple[Update, tuple[NDArray[np.uint8], ...]]]:
    """Run a session over a simulation and film it, in SLAM's own frame: the robot starts at the origin.

    Yields:
        each update, and the frames [height, width, 3] (RGB) that show it: mostly one or none.
    """
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    lidar = simulation.recording.lidar
    assert lidar is not None
    start = simulation.truth.at(lidar.stamps[:1]).poses[0]
    walls = _seen_from(start, simulation.world.segments.reshape(-1, 2))
    extent = np.ptp(walls, axis=0) + 2.0
    width, height = extent * (np.array(PLAN) / extent).min()
    width, height = max(float(width), NARROWEST) + LEFT + RIGHT, max(float(height), 1.0) + BELOW + ABOVE
    shown = np.bincount(pace.moments(lidar.stamps), minlength=len(lidar))
    with matplotlib.rc_context(STYLE.rc_params()):
        figure = Figure(figsize=(width, height))
        canvas: Any = FigureCanvasAgg(figure)
        area = (LEFT / width, BELOW / height, 1 - (LEFT + RIGHT) / width, 1 - (BELOW + ABOVE) / height)
        axes = figure.add_axes(area)
        caption = figure.text(0.5, 1 - 0.1 / height, "", ha="center", va="top", parse_math=False)
        path = []
        for update in session:
            path.append(update.pose)
            if not shown[update.index]:
                yield update, ()
                continue
            axes.clear()
            axes.set_facecolor(str(STYLE.map_unknown))
            occupancy = session.map
            grey = style.map_greys(occupancy.values)
            look: dict[str, Any] = {"cmap": "gray", "vmin": 0, "vmax": 1, "origin": "lower"}
            axes.imshow(grey, extent=occupancy.extent, zorder=0, interpolation="nearest", **look)
            _draw(axes, simulation, start, update, np.array(path))
            style.plan(axes)
            style.show_everything(axes, walls)
            if not figure.legends:
                handles, labels = axes.get_legend_handles_labels()
                columns = 4 if width > 8 else 3
                legend = figure.legend(handles, labels, loc="lower center", ncols=columns, markerscale=2.5)
                for line in legend.get_lines():
                    line.set_linewidth(2.0)
            name = style.shortened(simulation.scenario.name, NAME_SHOWN)
            caption.set_text(f"{name}: t = {update.stamp - lidar.stamps[0]:.1f} s, {pace}")
            canvas.draw()
            yield update, (np.asarray(canvas.buffer_rgba())[..., :3].copy(),) * int(shown[update.index])


def _draw(axes: Axes, simulation: Simulation, start: Array, update: Update, path: Array) -> None:
    """What there is at the moment of an update, and SLAM's path so far [k, 3]; ``start`` is the true pose at first."""
    from matplotlib.collections import LineCollection
    from matplotlib.patches import Polygon

    lidar, platform, tracks = simulation.recording.lidar, simulation.recording.platform, simulation.tracks
    assert lidar is not None
    walls = _seen_from(start, simulation.world.segments.reshape(-1, 2)).reshape(-1, 2, 2)
    look: dict[str, Any] = {"linewidths": 0.7, "alpha": 0.6, "label": "true walls"}
    axes.add_collection(LineCollection(list(walls), colors=style.TRUTH, **look))
    ranges = lidar.ranges[update.index]
    beams = np.flatnonzero(np.isfinite(ranges))[:: max(1, len(ranges) // BEAMS_DRAWN)]
    x, y, heading = se2.compose(update.pose, platform.lidar.pose)
    angles = heading + lidar.angles[beams]
    ends = (x, y) + ranges[beams, None] * np.stack((np.cos(angles), np.sin(angles)), axis=-1)
    rays = np.stack((np.broadcast_to((x, y), ends.shape), ends), axis=1)
    axes.add_collection(LineCollection(list(rays), colors=BEAM, linewidths=0.5, alpha=0.6, label="beams"))
    true = _seen_from(start, simulation.truth.poses[simulation.truth.stamps <= update.stamp, :2])
    axes.plot(*true.T, color=style.TRUTH, lw=1.2, label="truth")
    axes.plot(*path[:, :2].T, color=style.SLAM, lw=1.2, label=style.ONLINE)
    if tracks is not None:
        row = int(np.clip(round((update.stamp - EPOCH) * tracks.rate), 0, len(tracks.people) - 1))
        people = _seen_from(start, tracks.people[row])
        leaves = _seen_from(start, tracks.lines[row].reshape(-1, 2).astype(np.float64)).reshape(-1, 2, 2)
        if len(people):
            axes.plot(*people.T, color=PERSON, ls="", marker="o", ms=4, label="people")
        for i, leaf in enumerate(leaves):
            axes.plot(*leaf.T, color=DOOR, lw=2.0, label=None if i else "doors")
    axes.plot(*update.poses[:, :2].T, color=style.PARTICLE, ls="", marker=".", ms=3, zorder=6, label="particles")
    half = np.array((platform.length, platform.width)) / 2
    corners = np.column_stack((np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half, np.zeros(4)))
    axes.add_patch(Polygon(se2.compose(update.pose, corners)[:, :2], facecolor="black", zorder=5, label="robot"))


def _seen_from(start: Array, points: Array) -> Array:
    """Points [n, 2] of the world as SLAM's frame has them, whose origin is a pose [3] of the world."""
    x, y, theta = start
    cos, sin = np.cos(theta), np.sin(theta)
    return np.asarray((points - (x, y)) @ np.array([(cos, -sin), (sin, cos)]))
