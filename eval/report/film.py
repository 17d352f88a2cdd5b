"""A film of a run: the robot, its beams and particles, and the map as it grows; as GIF, WebP or MP4."""

from __future__ import annotations

import io
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import ConfigError, File, OutputError
from moteslam.eval.report import style
from moteslam.eval.report.maps import draw_map
from moteslam.eval.tables import shortened
from moteslam.files import write_atomically
from moteslam.robot import se2
from moteslam.robot.se2 import Array
from moteslam.sim.sensors.clock import EPOCH
from moteslam.sim.simulate import Simulation
from moteslam.slam.online import OnlineSlam
from moteslam.slam.scan_records import Update

Frame = NDArray[np.uint8]  # [height, width, 3]: red, green, blue

MAX_FPS, MAX_SPEED, MAX_FRAMES = 50.0, 10000.0, 2000
"""Frames a second (browsers slow GIFs down that have more), times real time, and frames in all."""
USUAL_LENGTH = 15.0  # A film is at most this long where nobody asks for a speed [s]
BEAMS_DRAWN = 90
PERSON, DOOR, BEAM = "#D55E00", "#CC79A7", "#E69F00"
STYLE = style.PictureStyle(font_size=12.0, dpi=100.0)
"""Text is 12 pixels high or more where a player shows a film 480 pixels high."""
PLAN, NARROWEST = (9.0, 4.6), 6.4
"""Width and height that the plan takes at most, and its width at least, for the legend and the caption [inch]."""
LEFT, RIGHT, BELOW, ABOVE = 0.75, 0.3, 1.35, 0.4
"""Beside the plan, below it (the legend) and above it (the caption) [inch]."""
NAME_SHOWN = 30  # Characters of the scenario's name that the caption holds at most
CODECS = {"avc1": "H.264", "vp09": "VP9", "av01": "AV1"}
"""What browsers play in an MP4, in the order in which they are tried: most builds of OpenCV do not encode H.264."""
GIF_TICK = 0.01  # Frames of a GIF last whole multiples of this [s]


@dataclass(frozen=True)
class Pace:
    """How fast a film goes: frames a second, and seconds of the run in a second of the film (1 is real time)."""

    fps: float
    speed: float

    @classmethod
    def of(cls, duration: float, *, fps: float = 15.0, speed: float | None = None) -> Pace:
        """The pace of a film of a run of this duration [s]; without a speed it takes at most ``USUAL_LENGTH``."""
        if speed is None:
            speed = next((speed for speed in style.STEPS if duration / speed <= USUAL_LENGTH), style.STEPS[-1])
        if not 1 <= fps <= MAX_FPS:
            raise ConfigError(f"{fps:g}, expected 1 to {MAX_FPS:g} frames a second", field="fps")
        if not 0.1 <= speed <= MAX_SPEED:
            raise ConfigError(f"{speed:g}, expected 0.1 to {MAX_SPEED:g} times real time", field="speed")
        if duration * fps / speed > MAX_FRAMES:
            found = f"{duration:.0f} s at {fps:g} frames a second and {speed:g} times real time"
            raise ConfigError(f"{found}, expected a speed for at most {MAX_FRAMES} frames", field="speed")
        return cls(fps, speed)

    def moments(self, stamps: Array) -> NDArray[np.int64]:
        """For each frame [k] the index of the last scan before it, of scans at stamps [n] [s]; the last at last."""
        times = np.arange(stamps[0], stamps[-1], self.speed / self.fps)
        return np.append(np.searchsorted(stamps, times, side="right") - 1, len(stamps) - 1)

    def __str__(self) -> str:
        return f"{self.speed:g} × real time, {self.fps:g} frames/s"


def film(simulation: Simulation, session: OnlineSlam, pace: Pace, progress: Callable[[float], None]) -> Iterator[Frame]:
    """The frames of a session over a simulation, in SLAM's frame; ``progress`` is called with how many scans are in."""
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    lidar = simulation.recording.lidar
    assert lidar is not None
    start = simulation.truth.at(lidar.stamps[:1]).poses[0]
    walls = _seen_from(start, simulation.world.segments.reshape(-1, 2, 2))
    everything = np.vstack((walls.reshape(-1, 2), _seen_from(start, simulation.truth.poses[:, :2])))
    extent = np.ptp(everything, axis=0) + 2.0
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
            progress(update.index + 1)
            path.append(update.pose)
            if not shown[update.index]:
                continue
            axes.clear()
            draw_map(axes, session.map)
            _draw(axes, simulation, start, walls, update, np.array(path))
            style.plan(axes)
            style.show_everything(axes, everything, margin=1.0)
            if not figure.legends:
                handles, labels = axes.get_legend_handles_labels()
                columns = 4 if width > 8 else 3
                legend = figure.legend(handles, labels, loc="lower center", ncols=columns, markerscale=2.5)
                for line in legend.get_lines():
                    line.set_linewidth(2.0)
            name = shortened(simulation.scenario.name, NAME_SHOWN)
            caption.set_text(f"{name}: t = {update.stamp - lidar.stamps[0]:.1f} s, {pace}")
            canvas.draw()
            yield from (np.asarray(canvas.buffer_rgba())[..., :3].copy(),) * int(shown[update.index])


def _draw(axes: style.Axes, simulation: Simulation, start: Array, walls: Array, update: Update, path: Array) -> None:
    """What there is at the moment of an update, and SLAM's path so far [k, 3]; ``start`` is the true pose at first."""
    from matplotlib.collections import LineCollection
    from matplotlib.patches import Polygon

    lidar, platform, tracks = simulation.recording.lidar, simulation.recording.platform, simulation.tracks
    assert lidar is not None
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
        if len(people := _seen_from(start, tracks.people[row])):
            axes.plot(*people.T, color=PERSON, ls="", marker="o", ms=4, label="people")
        for i, leaf in enumerate(_seen_from(start, tracks.lines[row].reshape(-1, 2, 2))):
            axes.plot(*leaf.T, color=DOOR, lw=2.0, label=None if i else "doors")
    axes.plot(*update.poses[:, :2].T, color=style.PARTICLE, ls="", marker=".", ms=3, zorder=6, label="particles")
    half = np.array((platform.length, platform.width)) / 2
    corners = se2.transform_points(update.pose, np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half)
    axes.add_patch(Polygon(corners, facecolor="black", zorder=5, label="robot"))


def _seen_from(start: Array, points: Array) -> Array:
    """Points [..., 2] of the world as SLAM's frame has them, whose origin is a pose [3] of the world."""
    return se2.transform_points(se2.inverse(start), points)


def check_film(path: File) -> None:
    """Refuse a film that cannot be written, before it is made."""
    kind = Path(path).suffix.lower()
    if kind not in (".gif", ".webp", ".mp4"):
        raise OutputError("expected a name that ends in .gif, .webp or .mp4", file=path)
    if kind == ".mp4" and not _mp4([np.full((64, 64, 3), 60, np.uint8)], 15.0):
        known = ", ".join(CODECS.values())
        raise OutputError(f"OpenCV here has no encoder that browsers play ({known}), expected .webp or .gif", file=path)


def write_film(path: File, frames: Iterable[Frame], *, fps: float = 15.0) -> None:
    """Write frames, all of one size, one at least, as a GIF, WebP or MP4, by the name's ending, as they come."""
    check_film(path)
    kind = Path(path).suffix.lower()
    write_atomically(path, _mp4(frames, fps) if kind == ".mp4" else _animated(kind, frames, fps))


def _animated(kind: str, frames: Iterable[Frame], fps: float) -> bytes:
    from PIL import Image

    # an octree keeps the colours of thin lines, which a median cut would take for those of their neighbours
    colours: dict[str, Any] = {"colors": 128, "method": Image.Quantize.FASTOCTREE, "dither": Image.Dither.NONE}

    def quantised() -> Iterator[Image.Image]:
        for i, frame in enumerate(frames):
            image = Image.fromarray(frame).quantize(**colours)
            ticks = round((i + 1) / fps / GIF_TICK) - round(i / fps / GIF_TICK)
            image.info["duration"] = round(1000 * GIF_TICK * ticks)
            yield image

    images: Iterator[Image.Image] = quantised() if kind == ".gif" else map(Image.fromarray, frames)
    look = {"optimize": False} if kind == ".gif" else {"duration": 1000 / fps, "quality": 80}
    content = io.BytesIO()
    next(images).save(content, kind[1:], save_all=True, append_images=images, loop=0, **look)
    return content.getvalue()


def _mp4(frames: Iterable[Frame], fps: float) -> bytes:
    """An MP4 by the first of ``CODECS`` that OpenCV encodes here; empty where there is none."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # it reports every encoder that is missing
    import cv2

    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    frames = iter(frames)
    first = next(frames)
    height, width = (size - size % 2 for size in first.shape[:2])  # of 4:2:0 colours: two by two pixels share one
    with tempfile.TemporaryDirectory(prefix="moteslam-") as folder:
        file = Path(folder) / "film.mp4"
        for codec in CODECS:
            form = cv2.VideoWriter.fourcc(*codec)
            writer = cv2.VideoWriter(str(file), cv2.CAP_FFMPEG, form, fps, (width, height))
            if writer.isOpened():
                for frame in chain((first,), frames):
                    writer.write(np.ascontiguousarray(frame[:height, :width, ::-1]))
                writer.release()
                return file.read_bytes()
    return b""
