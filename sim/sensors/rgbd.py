"""The Kinect: when its two cameras fire, what they see, and their images as PNG files of the UCSD layout.

Two minutes of frames are gigabytes, so nothing is drawn until it is asked for: ``schedule_frames`` settles when and
from where every frame is taken, and `CameraFrames` draws the images of some of them.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import ConfigError, OutputError
from moteslam.robot.formats.ucsd import DISPARITY, RGB, image_path
from moteslam.robot.platform import CameraSettings, CameraSpec
from moteslam.robot.raster import encode_png
from moteslam.robot.recording import RgbdStream
from moteslam.robot.se2 import interpolate
from moteslam.robot.values import Summarised, processor_count
from moteslam.sim.robot.drive import Drive
from moteslam.sim.robot.mishaps import Interval
from moteslam.sim.sensors.clock import EPOCH, readings
from moteslam.sim.sensors.echoes import Scene
from moteslam.sim.sensors.renderer import Renderer, Shots
from moteslam.sim.world.floor import FloorSettings

MAX_HEIGHT = 10.0
"""Of the camera above the floor [m]."""
SAMPLE = 6
"""Images of each kind that are drawn to estimate the space that all will take."""
BATCH = 8
"""Images that are drawn at a time."""

Draw = Callable[[NDArray[np.intp]], NDArray[Any]]
"""Draws the images [k, ...] of these frames [k]."""


def check_camera(camera: CameraSpec | None) -> CameraSpec:
    """A camera that can record: the platform's, above the floor."""
    if camera is None:
        raise ConfigError("none, expected a camera to simulate", field="platform.camera")
    if not 0 < camera.z <= MAX_HEIGHT:
        raise ConfigError(f"{camera.z:g} m, expected above 0, up to {MAX_HEIGHT:g}", field="platform.camera.z")
    return camera


@dataclass(frozen=True, eq=False, repr=False)
class CameraFrames(Summarised):
    """All the frames of a run. It knows the truth, and is never part of a recording.

    Attributes:
        renderer: draws them; made when it is first called.
    """

    rgb: Shots
    disparity: Shots
    renderer: Callable[[], Renderer]

    def without(self, gap: Interval) -> CameraFrames:
        """The frames whose stamps are not in an interval; they look as they did."""
        rgb, disparity = (shots[~gap.covers(shots.stamps - EPOCH)] for shots in (self.rgb, self.disparity))
        return replace(self, rgb=rgb, disparity=disparity)

    @property
    def stream(self) -> RgbdStream:
        """What a recording holds of them: the stamps."""
        return RgbdStream(self.rgb.stamps, self.disparity.stamps)

    def draw_rgb(self, indices: NDArray[np.intp]) -> NDArray[np.uint8]:
        """The colour images [k, 480, 640, 3] (red, green, blue) of frames [k]."""
        return self.renderer().rgb(self.rgb[indices])

    def draw_disparity(self, indices: NDArray[np.intp]) -> NDArray[np.uint16]:
        """The raw disparity images [k, 480, 640] of frames [k]."""
        return self.renderer().disparity(self.disparity[indices])


def schedule_frames(
    drive: Drive, scene: Scene, floor: FloorSettings, mount: CameraSpec | None, settings: CameraSettings, seed: int
) -> CameraFrames:
    """Settle when the cameras fire and where the robot is then.

    Both tick at the same rate, out of phase by up to half a period, and each loses frames of its own. The camera draws
    from a stream of its own, so that it does not change the other sensors.
    """
    mount = check_camera(mount)
    clock, images = np.random.SeedSequence((seed, 0x52474244)).spawn(2)
    rng = np.random.default_rng(clock)
    start = 0.3 + rng.uniform(0.0, 0.2)
    end = float(drive.stamps[-1]) - rng.uniform(0.2, 0.6)
    phase = rng.uniform(-0.5, 0.5) * (1 / settings.rate)
    taken = []
    for first in (start, start + phase):
        times, stamps = readings(settings.rate, first, max(end, first), settings.clock, rng)
        kept = _kept(len(times), settings, rng)
        poses = interpolate(drive.stamps, drive.poses, times[kept])
        taken.append(Shots(EPOCH + stamps[kept], poses, times[kept], np.arange(len(kept))))
    rgb, disparity = taken
    words = tuple(int(word) for word in images.generate_state(2))
    counts, path = (len(rgb.stamps), len(disparity.stamps)), rgb.poses[:, :2]
    return CameraFrames(
        rgb, disparity, cache(partial(Renderer, mount, settings, scene, floor, path=path, frames=counts, seed=words))
    )


def _kept(count: int, settings: CameraSettings, rng: np.random.Generator) -> NDArray[np.intp]:
    """Which frames reach the host: after some of them, several in a row are lost."""
    gaps = rng.random(count) < settings.gap
    kept, i = [], 0
    while i < count:
        kept.append(i)
        i += 1 + (settings.gap_frames if gaps[i] else 0)
    return np.asarray(kept, np.intp)


def write_frames(
    folder: Path,
    frames: CameraFrames,
    sequence: str,
    *,
    announce: Callable[[str], None] | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> None:
    """Draw all frames and write them as ``dataRGBD/`` of the UCSD layout.

    ``announce`` is called, before the first is written, with a line on how many and how large they will be.
    """
    kinds: tuple[tuple[str, Draw, int], ...] = (
        (RGB, frames.draw_rgb, len(frames.rgb.stamps)),
        (DISPARITY, frames.draw_disparity, len(frames.disparity.stamps)),
    )
    total = sum(count for _, _, count in kinds)
    wanted = sum(estimate_bytes(draw, count) for _, draw, count in kinds)
    if announce is not None:
        announce(f"{total} images of about {_in_words(wanted)} are to be written")
    check_space(folder, wanted)
    before = 0
    for kind, draw, count in kinds:

        def report(done: int, before: int = before) -> None:
            progress((before + done) / total)

        write_images(folder, kind, sequence, draw, count, progress=report)
        before += count


def estimate_bytes(draw: Draw, count: int) -> int:
    """About what ``count`` images will take as PNG files [bytes], from a few of them, with a tenth to spare."""
    if not count:
        return 0
    chosen = np.unique(np.linspace(0, count - 1, min(count, SAMPLE)).astype(np.intp))
    sizes = [len(encode_png(image, fast=True)) for image in draw(chosen)]
    return int(1.1 * count * (sum(sizes) / len(sizes) + 2048))  # and half a block of the disk each


def _in_words(size: float) -> str:
    """Bytes as megabytes, or gigabytes where they are one or more."""
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.1f} MB"


def check_space(folder: Path, wanted: int) -> None:
    """Refuse to begin where fewer bytes than ``wanted`` are free."""
    free = shutil.disk_usage(folder).free
    if wanted > free:
        raise OutputError(f"{_in_words(free)} free, expected {_in_words(wanted)} for the images", file=folder)


def write_images(
    folder: Path, kind: str, sequence: str, draw: Draw, count: int, *, progress: Callable[[int], None] = lambda _: None
) -> None:
    """Draw images and write them, encoding on all cores while the next are drawn; few are held at a time.

    Args:
        folder: of the recording; it exists.
        kind: ``RGB`` or ``DISPARITY``.
        sequence: the number in the file names.
        count: of frames.
        progress: called with the number already written.

    Raises:
        OutputError: the folder cannot be made, or the disk is full.
    """
    place = image_path(folder, kind, sequence, 0).parent
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot be made: {error.strerror or error}", file=place) from error

    def write(index: int, image: NDArray[Any]) -> None:
        path, data = image_path(folder, kind, sequence, index), encode_png(image, fast=True)
        try:
            path.write_bytes(data)
        except OSError as error:
            raise OutputError(f"cannot be written: {error.strerror or error}", file=path) from error

    with ThreadPoolExecutor(processor_count()) as pool:
        waiting: list[Future[None]] = []
        try:
            for start in range(0, count, BATCH):
                frames = np.arange(start, min(start + BATCH, count))
                images = draw(frames)
                for future in waiting:
                    future.result()
                progress(start)
                waiting = [pool.submit(write, int(i), image) for i, image in zip(frames, images, strict=True)]
            for future in waiting:
                future.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    progress(count)
