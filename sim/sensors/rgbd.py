"""The Kinect: when its two cameras fire, and what they see.

Two minutes of frames are gigabytes, so nothing is drawn until it is asked for: ``schedule_frames`` settles when and
from where every frame is taken, and `CameraFrames` draws the images of some of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.formats.ucsd_rgbd import (
    DISPARITY,
    RGB,
    Draw,
    check_space,
    estimate_bytes,
    size_in_words,
    write_images,
)
from moteslam.robot.platform import CameraSettings, CameraSpec
from moteslam.robot.recording import RgbdStream
from moteslam.robot.se2 import interpolate
from moteslam.robot.values import Summarised
from moteslam.sim.robot.drive import Drive
from moteslam.sim.robot.limits import Interval
from moteslam.sim.sensors.checks import check_camera
from moteslam.sim.sensors.clock import readings
from moteslam.sim.sensors.echoes import Scene
from moteslam.sim.sensors.renderer import Renderer
from moteslam.sim.world.floor import FloorSettings


@dataclass(frozen=True, eq=False, repr=False)
class CameraFrames(Summarised):
    """All the frames of a run, drawn when they are asked for. It knows the truth, and is never part of a recording.

    Attributes:
        rgb_stamps, disparity_stamps: [m], [n] as the host stamps them [s].
        rgb_poses, disparity_poses: [m, 3], [n, 3] the robot's true poses when they are taken.
        rgb_times, disparity_times: [m], [n] when they are taken [s], from the drive's first moment.
        mount: where the camera is.
        settings: of the camera.
        scene: walls, people and doors that it sees.
        floor: what it drives on.
        seed: of the images' noise.
        rgb_numbers, disparity_numbers: [m], [n] of each frame among all that reached the host, whose noise it has.
        reached: how many colour and disparity images these were.
    """

    rgb_stamps: NDArray[np.float64]
    disparity_stamps: NDArray[np.float64]
    rgb_poses: NDArray[np.float64]
    disparity_poses: NDArray[np.float64]
    rgb_times: NDArray[np.float64]
    disparity_times: NDArray[np.float64]
    mount: CameraSpec
    settings: CameraSettings
    scene: Scene = field(repr=False)
    floor: FloorSettings
    seed: tuple[int, ...]
    rgb_numbers: NDArray[np.intp]
    disparity_numbers: NDArray[np.intp]
    reached: tuple[int, int]

    def without(self, gap: Interval, epoch: float) -> CameraFrames:
        """The frames whose stamps are not in an interval; they look as they did. ``epoch`` is its time 0 [s]."""
        rgb, disparity = (~gap.covers(stamps - epoch) for stamps in (self.rgb_stamps, self.disparity_stamps))
        return replace(
            self,
            rgb_stamps=self.rgb_stamps[rgb],
            rgb_poses=self.rgb_poses[rgb],
            rgb_times=self.rgb_times[rgb],
            rgb_numbers=self.rgb_numbers[rgb],
            disparity_stamps=self.disparity_stamps[disparity],
            disparity_poses=self.disparity_poses[disparity],
            disparity_times=self.disparity_times[disparity],
            disparity_numbers=self.disparity_numbers[disparity],
        )

    @property
    def stream(self) -> RgbdStream:
        """What a recording holds of them: the stamps."""
        return RgbdStream(self.rgb_stamps, self.disparity_stamps)

    @cached_property
    def renderer(self) -> Renderer:
        """Draws them; made when first asked for."""
        return Renderer(
            self.mount,
            self.settings,
            self.scene,
            self.floor,
            path=self.rgb_poses[:, :2],
            frames=self.reached,
            seed=self.seed,
        )

    def draw_rgb(self, indices: NDArray[np.intp]) -> NDArray[np.uint8]:
        """The colour images [k, 480, 640, 3] (red, green, blue) of frames [k]."""
        return self.renderer.rgb(self.rgb_numbers[indices], self.rgb_poses[indices], self.rgb_times[indices])

    def draw_disparity(self, indices: NDArray[np.intp]) -> NDArray[np.uint16]:
        """The raw disparity images [k, 480, 640] of frames [k]."""
        return self.renderer.disparity(
            self.disparity_numbers[indices], self.disparity_poses[indices], self.disparity_times[indices]
        )


def schedule_frames(
    drive: Drive,
    scene: Scene,
    floor: FloorSettings,
    mount: CameraSpec | None,
    settings: CameraSettings,
    seed: int,
    *,
    epoch: float = 0.0,
) -> CameraFrames:
    """Settle when the cameras fire and where the robot is then.

    Both tick at the same rate, out of phase by up to half a period, and each loses frames of its own.

    Args:
        drive: how the robot truly moved.
        scene, floor: what it drives in and on.
        mount: where the camera is.
        settings: of the camera.
        seed: of the run; the camera draws from a stream of its own, so that it does not change the other sensors.
        epoch: added to the stamps [s].

    Raises:
        ConfigError: the platform has no camera, or not above the floor.
    """
    mount = check_camera(mount)
    clock, images = np.random.SeedSequence((seed, 0x52474244)).spawn(2)
    rng = np.random.default_rng(clock)
    start = 0.3 + rng.uniform(0.0, 0.2)
    end = float(drive.stamps[-1]) - rng.uniform(0.2, 0.6)
    period = 1 / settings.rate
    phase = rng.uniform(-0.5, 0.5) * period
    taken = []
    for first in (start, start + phase):
        times, stamps = readings(settings.rate, first, max(end, first), settings.clock, rng)
        kept = _kept(len(times), settings, rng)
        taken.append((epoch + stamps[kept], interpolate(drive.stamps, drive.poses, times[kept]), times[kept]))
    (rgb, rgb_poses, rgb_times), (disparity, disparity_poses, disparity_times) = taken
    words = tuple(int(word) for word in images.generate_state(2))
    return CameraFrames(
        rgb_stamps=rgb,
        disparity_stamps=disparity,
        rgb_poses=rgb_poses,
        disparity_poses=disparity_poses,
        rgb_times=rgb_times,
        disparity_times=disparity_times,
        mount=mount,
        settings=settings,
        scene=scene,
        floor=floor,
        seed=words,
        rgb_numbers=np.arange(len(rgb)),
        disparity_numbers=np.arange(len(disparity)),
        reached=(len(rgb), len(disparity)),
    )


def write_frames(
    folder: Path,
    frames: CameraFrames,
    sequence: str,
    *,
    announce: Callable[[str], None] | None = None,
    progress: Callable[[float], None] | None = None,
) -> int:
    """Draw all frames and write them as ``dataRGBD/`` of the UCSD layout.

    Args:
        folder: of the recording; it exists.
        frames: to draw.
        sequence: the number in the file names.
        announce: called, before the first is written, with a line on how many and how large they will be.
        progress: called with the share of them that is written.

    Returns:
        the bytes written.

    Raises:
        OutputError: too little space on the disk, or a file cannot be written.
        ConfigError: the floor's picture cannot be read.
    """
    kinds: list[tuple[str, Draw, int]] = [
        (RGB, frames.draw_rgb, len(frames.rgb_stamps)),
        (DISPARITY, frames.draw_disparity, len(frames.disparity_stamps)),
    ]
    total = sum(count for _, _, count in kinds)
    wanted = sum(estimate_bytes(draw, count) for _, draw, count in kinds)
    if announce is not None:
        announce(f"{total} images of about {size_in_words(wanted)} are to be written")
    check_space(folder, wanted)
    written, before = 0, 0
    for kind, draw, count in kinds:

        def report(done: int, before: int = before) -> None:
            if progress is not None:
                progress((before + done) / total)

        written += write_images(folder, kind, sequence, draw, count, progress=report)
        before += count
    return written


def _kept(count: int, settings: CameraSettings, rng: np.random.Generator) -> NDArray[np.intp]:
    """Which frames reach the host: after some of them, several in a row are lost."""
    gaps = rng.random(count) < settings.gap
    kept, i = [], 0
    while i < count:
        kept.append(i)
        i += 1 + (settings.gap_frames if gaps[i] else 0)
    return np.asarray(kept, np.intp)
