"""Draws what the two cameras of the Kinect see: their rays, the floor's picture and the noise, prepared once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import rgbd
from moteslam.robot.platform import CameraSettings, CameraSpec
from moteslam.robot.se2 import transform_points
from moteslam.robot.values import Summarised
from moteslam.sim.sensors.echoes import Rays, Scene
from moteslam.sim.world.floor import FloorSettings, rasterise

FLOOR_CELL = 0.01
"""The floor is drawn from a picture of cells this large [m], or larger ones in a world of hectares."""

FLOOR_PIXELS = 60_000_000
"""Most cells of that picture."""

FARTHEST = 200.0
"""Walls further away than this are not drawn [m]."""

_NOISE_LENGTH = 1 << 20
"""Normal numbers drawn once; every frame reads them from a place of its own on."""


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


class Renderer:
    """Draws frames of a run.

    Args:
        path: [m, 2] where the robot is when the colour camera fires [m]: the floor is drawn around it.
        frames: how many colour and disparity images there are; each has noise of its own.
        seed: of the noise.

    Attributes:
        mount, settings: as given.
        views: of the depth camera, False, and of the colour camera, True.
    """

    def __init__(
        self,
        mount: CameraSpec,
        settings: CameraSettings,
        scene: Scene,
        floor: FloorSettings,
        *,
        path: NDArray[np.float64],
        frames: tuple[int, int],
        seed: tuple[int, ...],
    ) -> None:
        from moteslam.kernels.camera import depth_view_of, view_of  # imports Taichi

        rotation = rgbd.mount_rotation(mount)
        self.mount, self.settings, self._scene = mount, settings, scene
        # each camera's place in the robot's frame: the colour camera stands to the right of the depth camera
        place = np.array((mount.x, mount.y, mount.z))
        self._places = {False: place, True: place + rotation @ np.array((rgbd.RGB_OFFSET, 0.0, 0.0))}
        self.views = {}
        for colour in (False, True):
            optical = rgbd.optical_rays(colour=colour)
            directions = np.concatenate((optical @ rotation.T, optical[..., 2:]), axis=-1)
            self.views[colour] = view_of(directions, height=float(self._places[colour][2]))
        ground = _bounds(scene, path, settings.farthest + 2.0)
        width, height = ground[2] - ground[0], ground[3] - ground[1]
        cell = max(FLOOR_CELL, float(np.sqrt(width * height / FLOOR_PIXELS)))
        self._ground = rasterise(floor, ground, cell)
        self._packed = _pack(self._ground.values)
        rng = np.random.default_rng(np.random.SeedSequence(seed))
        reads = rgbd.HEIGHT * rgbd.WIDTH + 2 * rgbd.WIDTH
        normal = rng.standard_normal(_NOISE_LENGTH + reads, np.float32)
        lost = rng.random(len(normal), np.float32) < settings.dropout
        self._colour_noise = np.float32(settings.colour_noise) * normal
        self._disparity_noise = np.where(lost, np.float32(np.inf), np.float32(settings.disparity_noise) * normal)
        self._rgb_starts, self._disparity_starts = (rng.integers(_NOISE_LENGTH, size=count) for count in frames)
        self._depth_view = depth_view_of(
            self.views[False],
            scale=rgbd.DEPTH_SCALE,
            offset=rgbd.DISPARITY_OFFSET,
            slope=rgbd.DISPARITY_SLOPE,
            nothing=rgbd.NO_DISPARITY,
            nearest=settings.nearest,
            farthest=settings.farthest,
            grazing=settings.grazing,
        )

    def rgb(self, shots: Shots) -> NDArray[np.uint8]:
        """The colour images [k, 480, 640, 3] (RGB) of k shots."""
        import cv2

        from moteslam.kernels.camera import render_colour

        cameras, reaches = self.reaches(shots, colour=True)
        packed = render_colour(
            self.views[True],
            cameras,
            reaches,
            self._packed,
            corner=self._ground.origin[:2],
            cell_size=self._ground.cell_size,
            noise=self._colour_noise,
            starts=self._rgb_starts[shots.numbers],
        )
        bytes_ = packed.astype("<i4", copy=False).view(np.uint8).reshape(-1, rgbd.WIDTH, 4)
        images = cv2.cvtColor(bytes_, cv2.COLOR_RGBA2RGB) if len(bytes_) else bytes_[..., :3]
        return np.asarray(images, np.uint8).reshape(-1, rgbd.HEIGHT, rgbd.WIDTH, 3)

    def disparity(self, shots: Shots) -> NDArray[np.uint16]:
        """The raw disparity images [k, 480, 640] of k shots."""
        from moteslam.kernels.camera import render_disparity

        _, reaches = self.reaches(shots, colour=False)
        starts = self._disparity_starts[shots.numbers]
        images = render_disparity(self._depth_view, reaches, noise=self._disparity_noise, starts=starts)
        return images.reshape(-1, rgbd.HEIGHT, rgbd.WIDTH)

    def reaches(self, shots: Shots, *, colour: bool) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """The camera's poses [k, 3] at k shots, and how far [k, b] [m] it sees at the bearings [b] of its view."""
        place, bearings = self._places[colour], self.views[colour].bearings
        cameras = np.array(shots.poses)
        for camera in cameras:
            camera[:2] = transform_points(camera, place[:2])
        angles = (cameras[:, 2:] + bearings).reshape(-1)
        origins = np.repeat(cameras[:, :2], len(bearings), axis=0)
        rays = Rays(origins, angles, np.repeat(shots.times, len(bearings)))
        ranges = self._scene.exact(rays, max_range=FARTHEST)
        return cameras, ranges.reshape(len(cameras), len(bearings))


def _bounds(scene: Scene, path: NDArray[np.float64], reach: float) -> tuple[float, float, float, float]:
    """x_min, y_min, x_max, y_max [m] of the floor that is seen: the world, but at most ``reach`` from the path."""
    x0, y0, x1, y1 = scene.world.bounds
    low = np.minimum((x0, y0), path.min(axis=0)) - 0.5
    high = np.maximum((x1, y1), path.max(axis=0)) + 0.5
    low, high = np.maximum(low, path.min(axis=0) - reach), np.minimum(high, path.max(axis=0) + reach)
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _pack(colours: NDArray[np.uint8]) -> NDArray[np.int32]:
    """Colours [H, W, 3] as one number each: red + 256 green + 65536 blue."""
    red, green, blue = (colours[..., k].astype(np.int32) for k in range(3))
    return np.ascontiguousarray(red | green << 8 | blue << 16)
