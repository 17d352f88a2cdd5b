"""The frames of a film of a run: the robot, its beams and particles, and the map as it grows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from moteslam.eval.report import style
from moteslam.eval.report.pace import Pace
from moteslam.robot import se2
from moteslam.robot.picture_style import PictureStyle
from moteslam.sim.sensors.clock import EPOCH
from moteslam.sim.simulate import Simulation
from moteslam.slam.run import SlamSession
from moteslam.slam.scan_records import Update

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BEAMS_DRAWN = 90
PERSON, DOOR = "#D55E00", "#CC79A7"

STYLE = PictureStyle(font_size=12.0, dpi=100.0)
"""Text is 12 pixels high or more where a player shows a film 480 pixels high."""
PLAN = (9.0, 4.6)
"""Width and height that the plan takes at most [inch]."""
NARROWEST = 6.4
"""Width of the plan at least, for the legend and the caption [inch]."""
MARGINS = (0.75, 0.3, 1.35, 0.4)
"""Left, right, below (the legend) and above (the caption) of the plan [inch]."""
NAME_SHOWN = 30
"""Characters of the scenario's name that the caption holds at most."""


@dataclass(eq=False)
class Film:
    """Draws frames of a SLAM session over a simulation, in SLAM's own frame: the robot starts at the origin.

    Attributes:
        simulation: what was so.
        session: what is watched.
        pace: which moments are shown.
    """

    simulation: Simulation
    session: SlamSession
    pace: Pace
    _artists: dict[str, Any] = field(default_factory=dict)

    def play(self) -> Iterator[tuple[Update, tuple[NDArray[np.uint8], ...]]]:
        """Run the session; each update, and the frames [height, width, 3] (RGB) that show it: mostly one or none."""
        import matplotlib
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        lidar = self.simulation.recording.lidar
        assert lidar is not None
        shown = np.bincount(self.pace.moments(lidar.stamps), minlength=len(lidar))
        with matplotlib.rc_context(STYLE.rc_params()):
            walls = self._to_slam(self.simulation.world.segments.reshape(-1, 2))
            figure = Figure(figsize=_size(walls))
            canvas: Any = FigureCanvasAgg(figure)
            self._set_up(figure, walls)
            path = []
            for update in self.session:
                path.append(update.pose)
                if not shown[update.index]:
                    yield update, ()
                    continue
                self._show(update, np.array(path))
                canvas.draw()
                yield update, (np.asarray(canvas.buffer_rgba())[..., :3].copy(),) * int(shown[update.index])

    def _to_slam(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points [n, 2] of the world as SLAM's frame has them, whose origin is the robot at the first scan."""
        lidar = self.simulation.recording.lidar
        assert lidar is not None
        x, y, theta = self.simulation.truth.at(lidar.stamps[:1]).poses[0]
        cos, sin = np.cos(theta), np.sin(theta)
        return np.asarray((points - (x, y)) @ np.array([(cos, -sin), (sin, cos)]))

    def _set_up(self, figure: Figure, walls: NDArray[np.float64]) -> None:
        from matplotlib.collections import LineCollection
        from matplotlib.lines import Line2D
        from matplotlib.patches import Polygon

        width, height = figure.get_size_inches()
        left, right, below, above = MARGINS
        axes = figure.add_axes((left / width, below / height, 1 - (left + right) / width, 1 - (below + above) / height))
        style.show_unknown(axes)
        self._artists["map"] = axes.imshow(
            np.ones((1, 1)), cmap="gray", vmin=0, vmax=1, origin="lower", zorder=0, interpolation="nearest"
        )
        axes.add_collection(
            LineCollection(
                list(walls.reshape(-1, 2, 2)), colors=style.TRUTH, linewidths=0.7, alpha=0.6, label="true walls"
            )
        )
        self._artists["beams"] = LineCollection([], colors="#E69F00", linewidths=0.5, alpha=0.6, label="beams")
        axes.add_collection(self._artists["beams"])
        lines: tuple[tuple[str, dict[str, Any], str | None], ...] = (
            ("truth", {"color": style.TRUTH, "lw": 1.2}, "truth"),
            ("slam", {"color": style.SLAM, "lw": 1.2}, style.ONLINE),
            ("people", {"color": PERSON, "ls": "", "marker": "o", "ms": 4}, "people"),
            ("leaves", {"color": DOOR, "lw": 2.0}, "doors"),
            ("particles", {"color": style.PARTICLE, "ls": "", "marker": ".", "ms": 3, "zorder": 6}, "particles"),
        )
        tracks = self.simulation.tracks
        for name, look, label in lines:
            if name == "people" and (tracks is None or not tracks.people.shape[1]):
                label = None
            if name == "leaves" and (tracks is None or not tracks.lines.shape[1]):
                label = None
            self._artists[name] = axes.plot([], [], label=label, **look)[0]
        self._artists["robot"] = Polygon(np.zeros((4, 2)), facecolor="black", zorder=5, label="robot")
        axes.add_patch(self._artists["robot"])
        style.plan(axes, labels=False)
        axes.set_xlabel("x [m]")
        axes.set_ylabel("y [m]")
        style.show_everything(axes, walls)
        handles, labels = axes.get_legend_handles_labels()
        legend = figure.legend(handles, labels, loc="lower center", ncols=4 if width > 8 else 3, markerscale=2.5)
        for handle in legend.legend_handles:
            if isinstance(handle, Line2D):
                handle.set_linewidth(2.0)
        self._artists["title"] = figure.text(0.5, 1 - 0.1 / height, "", ha="center", va="top", parse_math=False)

    def _show(self, update: Update, path: NDArray[np.float64]) -> None:
        """Bring everything to the moment of an update."""
        simulation, artists = self.simulation, self._artists
        lidar, platform = simulation.recording.lidar, simulation.recording.platform
        assert lidar is not None
        occupancy = self.session.map
        artists["map"].set_data(style.map_greys(occupancy.values))
        artists["map"].set_extent(occupancy.extent)
        true = simulation.truth.poses[simulation.truth.stamps <= update.stamp, :2]
        artists["truth"].set_data(*self._to_slam(true).T)
        artists["slam"].set_data(path[:, 0], path[:, 1])
        artists["particles"].set_data(update.poses[:, 0], update.poses[:, 1])
        ranges = lidar.ranges[update.index]
        beams = np.flatnonzero(np.isfinite(ranges))[:: max(1, len(ranges) // BEAMS_DRAWN)]
        sensor = se2.compose(update.pose, platform.lidar.pose)
        angles = sensor[2] + lidar.angles[beams]
        ends = sensor[:2] + ranges[beams, None] * np.stack((np.cos(angles), np.sin(angles)), axis=-1)
        artists["beams"].set_segments(np.stack((np.broadcast_to(sensor[:2], ends.shape), ends), axis=1))
        half = np.array((platform.length, platform.width)) / 2
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half
        artists["robot"].set_xy(se2.compose(update.pose, np.column_stack((corners, np.zeros(4))))[:, :2])
        if simulation.tracks is not None:
            self._show_tracks(update.stamp - EPOCH)
        name = style.shortened(simulation.scenario.name, NAME_SHOWN)
        artists["title"].set_text(f"{name}: t = {update.stamp - lidar.stamps[0]:.1f} s, {self.pace}")

    def _show_tracks(self, time: float) -> None:
        tracks = self.simulation.tracks
        assert tracks is not None
        row = int(np.clip(round(time * tracks.rate), 0, len(tracks.people) - 1))
        self._artists["people"].set_data(*self._to_slam(tracks.people[row]).T)
        leaves = self._to_slam(tracks.lines[row].reshape(-1, 2).astype(np.float64)).reshape(-1, 2, 2)
        gaps = np.full((len(leaves), 1, 2), np.nan)
        self._artists["leaves"].set_data(*np.concatenate((leaves, gaps), axis=1).reshape(-1, 2).T)


def _size(points: NDArray[np.float64]) -> tuple[float, float]:
    """Width and height [inch] of a frame with a plan of these points [n, 2] [m]."""
    extent = np.ptp(points, axis=0) + 2.0
    width, height = extent * (np.array(PLAN) / extent).min()
    left, right, below, above = MARGINS
    return max(float(width), NARROWEST) + left + right, max(float(height), 1.0) + below + above
