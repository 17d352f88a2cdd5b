"""A run as a moving picture: the robot, its beams and particles, and the map as it grows, GIF or MP4."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import OutputError
from moteslam.eval.report import style
from moteslam.robot import se2
from moteslam.robot.files import write_atomically
from moteslam.sim.simulate import EPOCH, Simulation
from moteslam.slam.run import SlamSession, Update

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KINDS = (".gif", ".mp4")
BEAMS_DRAWN = 90
MAX_FRAMES = 2000
PERSON, DOOR = "#D55E00", "#CC79A7"


@dataclass(eq=False)
class Film:
    """Draws frames of a SLAM session over a simulation, in SLAM's own frame: the robot starts at the origin.

    Attributes:
        simulation: what was so.
        session: what is watched.
        frames: how many to draw, evenly over the run.
    """

    simulation: Simulation
    session: SlamSession
    frames: int = 150
    _artists: dict[str, Any] = field(default_factory=dict)

    def play(self) -> Iterator[tuple[Update, NDArray[np.uint8] | None]]:
        """Run the session; each update, and the frame [height, width, 3] (RGB) where one is due."""
        import matplotlib
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        total = len(self.session)
        due = set(np.unique(np.linspace(0, total - 1, min(self.frames, total)).round().astype(int)).tolist())
        with matplotlib.rc_context(style._SETTINGS):
            walls = self._to_slam(self.simulation.world.segments.reshape(-1, 2))
            extent = np.ptp(walls, axis=0) + 2.0
            width, height = np.maximum(8.0 * extent / extent.max(), (4.5, 1.5))
            figure = Figure(figsize=(width + 0.9, height + 1.4), dpi=90)  # the margins of the axes, see _set_up
            canvas: Any = FigureCanvasAgg(figure)
            self._set_up(figure, walls)
            path = []
            for update in self.session:
                path.append(update.pose)
                frame = None
                if update.index in due:
                    self._show(update, np.array(path))
                    canvas.draw()
                    frame = np.asarray(canvas.buffer_rgba())[..., :3].copy()
                yield update, frame

    def _to_slam(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points [n, 2] of the world as SLAM's frame has them, whose origin is the robot at the first scan."""
        lidar = self.simulation.recording.lidar
        assert lidar is not None
        x, y, theta = self.simulation.truth.at(lidar.stamps[:1]).poses[0]
        cos, sin = np.cos(theta), np.sin(theta)
        return np.asarray((points - (x, y)) @ np.array([(cos, -sin), (sin, cos)]))

    def _set_up(self, figure: Figure, walls: NDArray[np.float64]) -> None:
        from matplotlib.collections import LineCollection
        from matplotlib.patches import Polygon

        width, height = figure.get_size_inches()
        axes = figure.add_axes((0.7 / width, 1.0 / height, 1 - 0.9 / width, 1 - 1.4 / height))
        axes.set_facecolor("0.88")
        self._artists["map"] = axes.imshow(
            np.ones((1, 1)), cmap="gray", vmin=0, vmax=1, origin="lower", zorder=0, interpolation="nearest"
        )
        axes.add_collection(
            LineCollection(
                list(walls.reshape(-1, 2, 2)), colors=style.TRUTH, linewidths=0.5, alpha=0.6, label="true walls"
            )
        )
        self._artists["beams"] = LineCollection([], colors="#E69F00", linewidths=0.4, alpha=0.6, label="beams")
        axes.add_collection(self._artists["beams"])
        lines: tuple[tuple[str, dict[str, Any], str | None], ...] = (
            ("truth", {"color": style.TRUTH, "lw": 1.2}, "true path"),
            ("slam", {"color": style.SLAM, "lw": 1.2}, "SLAM, as known then"),
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
        figure.legend(handles, labels, loc="lower center", ncols=4, fontsize=8)
        self._artists["title"] = figure.text(0.5, 0.97, "", ha="center", va="top", parse_math=False)

    def _show(self, update: Update, path: NDArray[np.float64]) -> None:
        """Bring everything to the moment of an update."""
        simulation, artists = self.simulation, self._artists
        lidar, platform = simulation.recording.lidar, simulation.recording.platform
        assert lidar is not None
        occupancy = self.session.map
        belief = np.tanh(occupancy.values / 2)
        artists["map"].set_data(0.88 + np.where(belief < 0, -0.12 * belief, -0.73 * belief))
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
        artists["title"].set_text(f"{simulation.scenario.name}, {update.stamp - lidar.stamps[0]:.1f} s")

    def _show_tracks(self, time: float) -> None:
        tracks = self.simulation.tracks
        assert tracks is not None
        row = int(np.clip(round(time * tracks.rate), 0, len(tracks.people) - 1))
        self._artists["people"].set_data(*self._to_slam(tracks.people[row]).T)
        leaves = self._to_slam(tracks.lines[row].reshape(-1, 2).astype(np.float64)).reshape(-1, 2, 2)
        gaps = np.full((len(leaves), 1, 2), np.nan)
        self._artists["leaves"].set_data(*np.concatenate((leaves, gaps), axis=1).reshape(-1, 2).T)


def write_film(path: str | PathLike[str], frames: list[NDArray[np.uint8]], *, rate: float = 15.0) -> None:
    """Write frames [height, width, 3] (RGB) as a GIF or MP4, by the name's ending.

    Args:
        path: ends in ``.gif`` or ``.mp4``.
        frames: one at least.
        rate: frames a second.

    Raises:
        OutputError: another ending, or it cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() == ".gif":
        from PIL import Image

        # an octree keeps the colours of thin lines, which a median cut would take for those of their neighbours
        look: dict[str, Any] = {"colors": 128, "method": Image.Quantize.FASTOCTREE, "dither": Image.Dither.NONE}
        first, *others = (Image.fromarray(frame).quantize(**look) for frame in frames)
        content = io.BytesIO()
        first.save(
            content, "GIF", save_all=True, append_images=others, duration=round(1000 / rate), loop=0, optimize=False
        )
        write_atomically(path, content.getvalue())
    elif path.suffix.lower() == ".mp4":
        write_atomically(path, _mp4(frames, rate))
    else:
        raise OutputError("neither a .gif nor an .mp4 file, expected one to write", file=path)


def _mp4(frames: list[NDArray[np.uint8]], rate: float) -> bytes:
    import cv2

    height, width = (size - size % 2 for size in frames[0].shape[:2])  # the codec takes even sizes alone
    with tempfile.TemporaryDirectory(prefix="moteslam-") as folder:
        file = Path(folder) / "film.mp4"
        writer = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*"mp4v"), rate, (width, height))
        if not writer.isOpened():
            raise OutputError("OpenCV here writes no MP4, expected .gif instead", file=file.name)
        for frame in frames:
            writer.write(np.ascontiguousarray(frame[:height, :width, ::-1]))
        writer.release()
        return file.read_bytes()
