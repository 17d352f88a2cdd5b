"""The Kinect: when its two cameras fire, and what they see.

Two minutes of frames are gigabytes, so nothing is drawn until it is asked for: ``schedule_frames`` settles when and
from where every frame is taken, and `CameraFrames` draws the images of some of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import ConfigError
from moteslam.robot.formats.ucsd import DISPARITY, RGB
from moteslam.robot.platform import CameraSettings, CameraSpec
from moteslam.robot.recording import RgbdStream
from moteslam.robot.se2 import interpolate
from moteslam.robot.values import Summarised
from moteslam.sim.robot.drive import Drive
from moteslam.sim.robot.limits import Interval
from moteslam.sim.sensors.clock import EPOCH, readings
from moteslam.sim.sensors.echoes import Scene
from moteslam.sim.sensors.image_files import Draw, check_space, estimate_bytes, size_in_words, write_images
from moteslam.sim.sensors.renderer import Renderer
from moteslam.sim.world.floor import FloorSettings

MAX_HEIGHT = 10.0
"""Of the camera above the floor [m]."""


def check_camera(camera: CameraSpec | None) -> CameraSpec:
    """A camera that can record: the platform's, above the floor."""
    if camera is None:
        raise ConfigError("none, expected a camera to simulate", field="platform.camera")
    if not 0 < camera.z <= MAX_HEIGHT:
        raise ConfigError(f"{camera.z:g} m, expected above 0, up to {MAX_HEIGHT:g}", field="platform.camera.z")
    return camera


@dataclass(frozen=True, eq=False, repr=False)
class Shots(Summarised):
    """What one camera takes.

    Attributes:
        stamps: [n] as the host stamps them [s].
        poses: [n, 3] the robot's true poses when they are taken.
        times: [n] when they are taken, from the drive's first moment [s].
        numbers: [n] of each among all that reached the host, whose noise it has.
    """

    stamps: NDArray[np.float64]
    poses: NDArray[np.float64]
    times: NDArray[np.float64]
    numbers: NDArray[np.intp]

    def __getitem__(self, chosen: NDArray[Any]) -> Shots:
        return Shots(self.stamps[chosen], self.poses[chosen], self.times[chosen], self.numbers[chosen])


@dataclass(frozen=True, eq=False, repr=False)
class CameraFrames(Summarised):
    """All the frames of a run, drawn when they are asked for. It knows the truth, and is never part of a recording.

    Attributes:
        seed: of the images' noise.
        reached: how many colour and disparity images reached the host.
    """

    rgb: Shots
    disparity: Shots
    mount: CameraSpec
    settings: CameraSettings
    scene: Scene = field(repr=False)
    floor: FloorSettings
    seed: tuple[int, ...]
    reached: tuple[int, int]

    def without(self, gap: Interval) -> CameraFrames:
        """The frames whose stamps are not in an interval; they look as they did."""
        rgb, disparity = (shots[~gap.covers(shots.stamps - EPOCH)] for shots in (self.rgb, self.disparity))
        return replace(self, rgb=rgb, disparity=disparity)

    @property
    def stream(self) -> RgbdStream:
        """What a recording holds of them: the stamps."""
        return RgbdStream(self.rgb.stamps, self.disparity.stamps)

    @cached_property
    def renderer(self) -> Renderer:
        """Draws them; made when first asked for."""
        path = self.rgb.poses[:, :2]
        return Renderer(
            self.mount, self.settings, self.scene, self.floor, path=path, frames=self.reached, seed=self.seed
        )

    def draw_rgb(self, indices: NDArray[np.intp]) -> NDArray[np.uint8]:
        """The colour images [k, 480, 640, 3] (red, green, blue) of frames [k]."""
        chosen = self.rgb[indices]
        return self.renderer.rgb(chosen.numbers, chosen.poses, chosen.times)

    def draw_disparity(self, indices: NDArray[np.intp]) -> NDArray[np.uint16]:
        """The raw disparity images [k, 480, 640] of frames [k]."""
        chosen = self.disparity[indices]
        return self.renderer.disparity(chosen.numbers, chosen.poses, chosen.times)


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
    reached = len(rgb.stamps), len(disparity.stamps)
    return CameraFrames(rgb, disparity, mount, settings, scene, floor, words, reached)


def write_frames(
    folder: Path,
    frames: CameraFrames,
    sequence: str,
    *,
    announce: Callable[[str], None] | None = None,
    progress: Callable[[float], None] | None = None,
) -> int:
    """Draw all frames and write them as ``dataRGBD/`` of the UCSD layout; the bytes written.

    ``announce`` is called, before the first is written, with a line on how many and how large they will be.
    """
    kinds: list[tuple[str, Draw, int]] = [
        (RGB, frames.draw_rgb, len(frames.rgb.stamps)),
        (DISPARITY, frames.draw_disparity, len(frames.disparity.stamps)),
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
