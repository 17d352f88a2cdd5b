"""The Kinect: when its two cameras fire, and what they see.

Two minutes of frames are gigabytes, so nothing is drawn until it is asked for: ``plan_shots`` settles when and from
where every frame is taken, ``draw`` makes the images of some of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import kinect
from moteslam.robot.formats.ucsd_rgbd import (
    DISPARITY,
    RGB,
    Draw,
    check_space,
    estimate_bytes,
    size_in_words,
    write_images,
)
from moteslam.robot.platform import CameraMount
from moteslam.robot.recording import RgbdStream
from moteslam.robot.se2 import interpolate, transform_points
from moteslam.sim.camera import CameraSettings, check_mount
from moteslam.sim.drive import Drive
from moteslam.sim.floor import FloorImage, FloorSettings, rasterise
from moteslam.sim.movers import Movers
from moteslam.sim.sensors.clock import readings
from moteslam.sim.sensors.echoes import Scene
from moteslam.sim.world import World

FLOOR_CELL = 0.01
"""The floor is drawn from a picture of cells this large [m], or larger ones in a world of hectares."""

FLOOR_PIXELS = 60_000_000
"""Most cells of that picture."""

FARTHEST = 200.0
"""Walls further away than this are not drawn [m]."""

_NOISE_LENGTH = 1 << 20
"""Normal numbers drawn once; every frame reads them from a place of its own on."""


@dataclass(frozen=True, eq=False)
class Shots:
    """All the frames of a run, not drawn yet. It knows the truth, and is never part of a recording.

    Attributes:
        rgb_stamps, disparity_stamps: [m], [n] as the host stamps them [s].
        rgb_poses, disparity_poses: [m, 3], [n, 3] the robot's true poses when they are taken.
        mount: where the camera is.
        settings: what it is like.
        world, floor: what it sees; ``movers``: the people and doors among it.
        rgb_times, disparity_times: [m], [n] when they are taken [s], from the drive's first moment.
        seed: of the images' noise.
    """

    rgb_stamps: NDArray[np.float64]
    disparity_stamps: NDArray[np.float64]
    rgb_poses: NDArray[np.float64]
    disparity_poses: NDArray[np.float64]
    mount: CameraMount
    settings: CameraSettings
    world: World = field(repr=False)
    floor: FloorSettings
    seed: tuple[int, ...]
    rgb_times: NDArray[np.float64]
    disparity_times: NDArray[np.float64]
    movers: Movers | None = field(default=None, repr=False)

    @property
    def stream(self) -> RgbdStream:
        """What a recording is told of them: the stamps."""
        return RgbdStream(self.rgb_stamps, self.disparity_stamps)

    @cached_property
    def artist(self) -> Artist:
        """Draws them; made when first asked for."""
        return Artist(self)

    def draw_rgb(self, indices: NDArray[np.intp]) -> NDArray[np.uint8]:
        """The colour images [k, 480, 640, 3] (red, green, blue) of these frames."""
        return self.artist.rgb(indices)

    def draw_disparity(self, indices: NDArray[np.intp]) -> NDArray[np.uint16]:
        """The raw disparity images [k, 480, 640] of these frames."""
        return self.artist.disparity(indices)


def plan_shots(
    drive: Drive,
    world: World,
    floor: FloorSettings,
    mount: CameraMount | None,
    settings: CameraSettings,
    seed: int,
    *,
    epoch: float = 0.0,
) -> Shots:
    """Settle when the cameras fire and where the robot is then.

    Both tick at the same rate, out of phase by up to half a period, and each loses frames of its own.

    Args:
        drive: how the robot truly moved.
        world, floor: what it drives in and on.
        mount: where the camera is.
        settings: of the camera.
        seed: of the run; the camera draws from a stream of its own, so that no other sensor notices it.
        epoch: added to the stamps [s].

    Raises:
        ConfigError: the platform has no camera, or not above the floor.
    """
    mount = check_mount(mount)
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
    return Shots(
        rgb_stamps=rgb,
        disparity_stamps=disparity,
        rgb_poses=rgb_poses,
        disparity_poses=disparity_poses,
        mount=mount,
        settings=settings,
        world=world,
        floor=floor,
        seed=words,
        rgb_times=rgb_times,
        disparity_times=disparity_times,
        movers=drive.movers,
    )


def write_shots(
    folder: Path,
    shots: Shots,
    sequence: str,
    *,
    tell: Callable[[str], None] | None = None,
    progress: Callable[[float], None] | None = None,
) -> int:
    """Draw all frames and write them as ``dataRGBD/`` of the UCSD layout.

    Args:
        folder: of the recording; it exists.
        shots: what to draw.
        sequence: the number in the file names.
        tell: told, before the first is written, how many and how large they will be.
        progress: told the share of them that is written.

    Returns:
        the bytes written.

    Raises:
        OutputError: too little space on the disk, or a file cannot be written.
        ConfigError: the floor's picture cannot be read.
    """
    kinds: list[tuple[str, Draw, int]] = [
        (RGB, shots.draw_rgb, len(shots.rgb_stamps)),
        (DISPARITY, shots.draw_disparity, len(shots.disparity_stamps)),
    ]
    total = sum(count for _, _, count in kinds)
    wanted = sum(estimate_bytes(draw, count) for _, draw, count in kinds)
    if tell is not None:
        tell(f"{total} images of about {size_in_words(wanted)} are to be written")
    check_space(folder, wanted)
    written, before = 0, 0
    for kind, draw, count in kinds:

        def say(done: int, before: int = before) -> None:
            if progress is not None:
                progress((before + done) / total)

        written += write_images(folder, kind, sequence, draw, count, progress=say)
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


class Artist:
    """Draws the frames of a run: the views, the floor's picture and the noise, made once."""

    def __init__(self, shots: Shots) -> None:
        from moteslam.kernels.camera import depth_view_of, view_of  # imports Taichi

        self._shots = shots
        mount, settings = shots.mount, shots.settings
        rotation = kinect.mount_rotation(mount)
        self._scene = Scene(shots.world, shots.movers)
        # each camera's place in the robot's frame: the colour camera stands to the right of the depth camera
        place = np.array((mount.x, mount.y, mount.z))
        self._places = {False: place, True: place + rotation @ np.array((kinect.RGB_OFFSET, 0.0, 0.0))}
        self._views = {}
        for colour in (False, True):
            optical = kinect.optical_rays(colour=colour)
            directions = np.concatenate((optical @ rotation.T, optical[..., 2:]), axis=-1)
            self._views[colour] = view_of(directions, height=float(self._places[colour][2]))
        self._ground = _picture(shots)
        self._packed = _pack(self._ground.colours)
        rng = np.random.default_rng(np.random.SeedSequence(shots.seed))
        reads = kinect.HEIGHT * kinect.WIDTH + 2 * kinect.WIDTH
        normal = rng.standard_normal(_NOISE_LENGTH + reads, np.float32)
        lost = rng.random(len(normal), np.float32) < settings.dropout
        self._colour_noise = np.float32(settings.colour_noise) * normal
        self._disparity_noise = np.where(lost, np.float32(np.inf), np.float32(settings.disparity_noise) * normal)
        self._rgb_starts = rng.integers(_NOISE_LENGTH, size=len(shots.rgb_stamps))
        self._disparity_starts = rng.integers(_NOISE_LENGTH, size=len(shots.disparity_stamps))
        self._depth_view = depth_view_of(
            self._views[False],
            scale=kinect.DEPTH_SCALE,
            offset=kinect.DISPARITY_OFFSET,
            slope=kinect.DISPARITY_SLOPE,
            nothing=kinect.NO_DISPARITY,
            nearest=settings.nearest,
            farthest=settings.farthest,
            grazing=settings.grazing,
        )

    def rgb(self, indices: NDArray[np.intp]) -> NDArray[np.uint8]:
        """See ``Shots.draw_rgb``."""
        import cv2

        from moteslam.kernels.camera import render_colour

        cameras, reaches = self._looks(self._shots.rgb_poses[indices], self._shots.rgb_times[indices], colour=True)
        packed = render_colour(
            self._views[True],
            cameras,
            reaches,
            self._packed,
            corner=self._ground.origin,
            cell_size=self._ground.cell_size,
            noise=self._colour_noise,
            starts=self._rgb_starts[indices],
        )
        bytes_ = packed.astype("<i4", copy=False).view(np.uint8).reshape(-1, kinect.WIDTH, 4)
        images = cv2.cvtColor(bytes_, cv2.COLOR_RGBA2RGB) if len(bytes_) else bytes_[..., :3]
        return np.asarray(images, np.uint8).reshape(-1, kinect.HEIGHT, kinect.WIDTH, 3)

    def disparity(self, indices: NDArray[np.intp]) -> NDArray[np.uint16]:
        """See ``Shots.draw_disparity``."""
        from moteslam.kernels.camera import render_disparity

        _, reaches = self._looks(
            self._shots.disparity_poses[indices], self._shots.disparity_times[indices], colour=False
        )
        starts = self._disparity_starts[indices]
        images = render_disparity(self._depth_view, reaches, noise=self._disparity_noise, starts=starts)
        return images.reshape(-1, kinect.HEIGHT, kinect.WIDTH)

    def depth_look(self, index: int) -> tuple[NDArray[np.float64], NDArray[np.float32], NDArray[np.float64]]:
        """Where the depth camera is in a frame [3], and how far the floor reaches [b] at bearings [b] from its heading.

        The pose is the camera's place and the robot's heading [m, rad], reaches are in m, bearings in rad.
        """
        chosen = slice(index, index + 1)
        cameras, reaches = self._looks(
            self._shots.disparity_poses[chosen], self._shots.disparity_times[chosen], colour=False
        )
        return cameras[0], reaches[0], self._views[False].bearings

    def _looks(
        self, poses: NDArray[np.float64], times: NDArray[np.float64], *, colour: bool
    ) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Where the camera is with the robot at these poses [k, 3], and how far it sees at each bearing [k, b]."""
        place, bearings = self._places[colour], self._views[colour].bearings
        cameras = np.array(poses)
        for camera in cameras:
            camera[:2] = transform_points(camera, place[:2])
        angles = (cameras[:, 2:] + bearings).reshape(-1)
        origins = np.repeat(cameras[:, :2], len(bearings), axis=0)
        ranges = self._scene.exact(origins, angles, np.repeat(times, len(bearings)), max_range=FARTHEST)
        return cameras, ranges.reshape(len(cameras), len(bearings))


def _picture(shots: Shots) -> FloorImage:
    """The floor's picture wherever the cameras may see it: the world, and 10 m around the way where it is open."""
    x0, y0, x1, y1 = shots.world.bounds
    way = shots.rgb_poses[:, :2]
    around = shots.settings.farthest + 2.0
    low = np.minimum((x0, y0), way.min(axis=0)) - 0.5
    high = np.maximum((x1, y1), way.max(axis=0)) + 0.5
    low, high = np.maximum(low, way.min(axis=0) - around), np.minimum(high, way.max(axis=0) + around)
    width, height = high - low
    cell = max(FLOOR_CELL, float(np.sqrt(width * height / FLOOR_PIXELS)))
    return rasterise(shots.floor, (float(low[0]), float(low[1]), float(high[0]), float(high[1])), cell)


def _pack(colours: NDArray[np.uint8]) -> NDArray[np.int32]:
    """Colours [H, W, 3] as one number each: red + 256 green + 65536 blue."""
    red, green, blue = (colours[..., k].astype(np.int32) for k in range(3))
    return np.ascontiguousarray(red | green << 8 | blue << 16)
