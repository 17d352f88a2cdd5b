"""The Kinect: when its two cameras fire, and what they see.

Two minutes of frames are gigabytes, so nothing is drawn until it is asked for: `Camera` settles when and from where
every frame is taken, and `CameraFrames` draws the images of some of them.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import ConfigError
from moteslam.robot import rgbd
from moteslam.robot.platform import CameraSettings, CameraSpec
from moteslam.robot.recording import Images, RgbdStream
from moteslam.robot.se2 import Array, interpolate, transform_points
from moteslam.robot.values import Summarised
from moteslam.sim.robot.drive import Drive
from moteslam.sim.robot.mishaps import Interval
from moteslam.sim.sensors.clock import EPOCH, arrived, readings
from moteslam.sim.sensors.echoes import Rays, Scene
from moteslam.sim.world.floor import FloorSettings, rasterise
from moteslam.sim.world.world import World

FLOOR_CELL = 0.01  # The floor is drawn from a picture of cells this large [m], or larger ones in a world of hectares
FLOOR_PIXELS = 60_000_000  # Most cells of that picture
FARTHEST = 200.0  # Walls further away than this are not drawn [m]
_NOISE_LENGTH = 1 << 20  # Normal numbers drawn once; every frame reads them from another index on


def optical_rays(*, colour: bool) -> Array:
    """Directions [480, 640, 3] of the pixels' centres in optical axes, with z = 1, of the colour or depth camera."""
    focal, (cx, cy) = (rgbd.RGB_FOCAL, rgbd.RGB_CENTRE) if colour else (rgbd.FOCAL, rgbd.CENTRE)
    rows, columns = np.mgrid[: rgbd.HEIGHT, : rgbd.WIDTH].astype(np.float64)
    return np.stack(((columns - cx) / focal, (rows - cy) / focal, np.ones_like(rows)), axis=-1)


@dataclass(frozen=True, eq=False, repr=False)
class Shots(Summarised):
    stamps: Array  # [n] as the host stamps them [s]
    poses: Array  # [n, 3] the robot's true poses when they are taken
    times: Array  # [n] when they are taken, from the drive's first moment [s]
    numbers: NDArray[np.intp]  # [n] of each among all that reached the host, whose noise it has
    scene: Scene  # that is seen

    def __getitem__(self, chosen: NDArray[Any]) -> "Shots":
        return Shots(self.stamps[chosen], self.poses[chosen], self.times[chosen], self.numbers[chosen], self.scene)


class Renderer:
    """Draws frames of a run: of so many colour and disparity images, the noise of each of which differs.

    The floor is drawn around ``path`` [m, 2], where the robot is when the colour camera fires [m]; all of it if None.
    """

    def __init__(
        self,
        mount: CameraSpec,
        settings: CameraSettings,
        world: World,
        floor: FloorSettings,
        *,
        path: Array | None,
        frames: tuple[int, int],
        seed: tuple[int, ...],
    ) -> None:
        from moteslam.kernels.camera import depth_view_of, view_of  # imports Taichi

        rotation = rgbd.mount_rotation(mount)
        self.mount, self.settings = mount, settings
        # each camera's place in the robot's frame: the colour camera stands to the right of the depth camera
        place = np.array((mount.x, mount.y, mount.z))
        self._places = {False: place, True: place + rotation @ np.array((rgbd.RGB_OFFSET, 0.0, 0.0))}
        self.views = {}  # of the depth camera, False, and of the colour camera, True
        for colour in (False, True):
            optical = optical_rays(colour=colour)
            directions = np.concatenate((optical @ rotation.T, optical[..., 2:]), axis=-1)
            self.views[colour] = view_of(directions, height=float(self._places[colour][2]))
        ground = _bounds(world, path, settings.farthest + 2.0)
        width, height = ground[2] - ground[0], ground[3] - ground[1]
        cell = max(FLOOR_CELL, float(np.sqrt(width * height / FLOOR_PIXELS)))
        self._ground = rasterise(floor, ground, cell)
        red, green, blue = np.moveaxis(self._ground.values.astype(np.int32), -1, 0)
        self._packed = np.ascontiguousarray(red | green << 8 | blue << 16)
        rng = np.random.default_rng(np.random.SeedSequence(seed))
        reads = rgbd.HEIGHT * rgbd.WIDTH + 2 * rgbd.WIDTH
        normal = rng.standard_normal(_NOISE_LENGTH + reads, np.float32)
        lost = rng.random(len(normal), np.float32) < settings.dropout
        self._colour_noise = np.float32(settings.colour_noise) * normal
        self._disparity_noise = np.where(lost, np.float32(np.inf), np.float32(settings.disparity_noise) * normal)
        self._rgb_starts, self._disparity_starts = (rng.integers(_NOISE_LENGTH, size=count) for count in frames)
        raw = {"scale": rgbd.DEPTH_SCALE, "offset": rgbd.DISPARITY_OFFSET, "slope": rgbd.DISPARITY_SLOPE}
        measured = {"nearest": settings.nearest, "farthest": settings.farthest, "grazing": settings.grazing}
        self._depth_view = depth_view_of(self.views[False], **raw, **measured, nothing=rgbd.NO_DISPARITY)

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

    def reaches(self, shots: Shots, *, colour: bool) -> tuple[Array, NDArray[np.float32]]:
        """The camera's poses [k, 3] at k shots, and how far [k, b] [m] it sees at the bearings [b] of its view."""
        place, bearings = self._places[colour], self.views[colour].bearings
        cameras = np.array(shots.poses)
        for camera in cameras:
            camera[:2] = transform_points(camera, place[:2])
        angles = (cameras[:, 2:] + bearings).reshape(-1)
        origins = np.repeat(cameras[:, :2], len(bearings), axis=0)
        rays = Rays(origins, angles, np.repeat(shots.times, len(bearings)))
        ranges = shots.scene.exact(rays, max_range=FARTHEST)
        return cameras, ranges.reshape(len(cameras), len(bearings))


def _bounds(world: World, path: Array | None, reach: float) -> tuple[float, float, float, float]:
    """x_min, y_min, x_max, y_max [m] of the floor that is seen: the world, but at most ``reach`` from the path."""
    x0, y0, x1, y1 = world.bounds
    if path is None:
        return x0 - 0.5, y0 - 0.5, x1 + 0.5, y1 + 0.5
    low = np.minimum((x0, y0), path.min(axis=0)) - 0.5
    high = np.maximum((x1, y1), path.max(axis=0)) + 0.5
    low, high = np.maximum(low, path.min(axis=0) - reach), np.minimum(high, path.max(axis=0) + reach)
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


MAX_HEIGHT = 10.0  # Of the camera above the floor [m]


def check_camera(camera: CameraSpec | None) -> CameraSpec:
    """A camera that can record: the platform's, above the floor."""
    if camera is None:
        raise ConfigError("none, expected a camera to simulate", field="platform.camera")
    if not 0 < camera.z <= MAX_HEIGHT:
        raise ConfigError(f"{camera.z:g} m, expected above 0, up to {MAX_HEIGHT:g}", field="platform.camera.z")
    return camera


@dataclass(frozen=True, eq=False, repr=False)
class CameraFrames(Summarised):
    """All the frames of a run. It knows the truth, and is never part of a recording."""

    rgb: Shots
    disparity: Shots
    renderer: Callable[[], Renderer]  # draws them; made when it is first called

    def without(self, gap: Interval) -> Self:
        """The frames whose stamps are not in an interval; they look as they did."""
        rgb, disparity = (shots[~gap.covers(shots.stamps - EPOCH)] for shots in (self.rgb, self.disparity))
        return replace(self, rgb=rgb, disparity=disparity)

    @property
    def stream(self) -> RgbdStream:
        """What a recording holds of them: the stamps."""
        return RgbdStream(self.rgb.stamps, self.disparity.stamps)

    @property
    def drawn(self) -> RgbdStream:
        """The same with the images, which are drawn when they are asked for, one at a time."""
        draw = (lambda k: self.draw_rgb(np.array([k]))[0], lambda k: self.draw_disparity(np.array([k]))[0])
        return replace(self.stream, images=Images(*draw))

    def draw_rgb(self, indices: NDArray[np.intp]) -> NDArray[np.uint8]:
        """The colour images [k, 480, 640, 3] (red, green, blue) of frames [k]."""
        return self.renderer().rgb(self.rgb[indices])

    def draw_disparity(self, indices: NDArray[np.intp]) -> NDArray[np.uint16]:
        """The raw disparity images [k, 480, 640] of frames [k]."""
        return self.renderer().disparity(self.disparity[indices])


class Camera:
    """When the two cameras fire, settled beforehand.

    Both tick at the same rate, out of phase by up to half a period, and each loses other frames. The camera's random
    numbers are apart, so that it does not change the other sensors.

    ``seconds``: its frames lie within so many of the drive's start.
    """

    def __init__(
        self, mount: CameraSpec | None, settings: CameraSettings, floor: FloorSettings, seconds: float, seed: int
    ) -> None:
        self._mount, self._settings, self._floor = check_camera(mount), settings, floor
        clock, self._images = np.random.SeedSequence((seed, 0x52474244)).spawn(2)
        rng = np.random.default_rng(clock)
        start = 0.3 + rng.uniform(0.0, 0.2)
        end = seconds - rng.uniform(0.2, 0.6)
        phase = rng.uniform(-0.5, 0.5) * (1 / settings.rate)
        self._ticks = []
        for first in (start, start + phase):
            times, stamps = readings(settings.rate, first, max(end, first), settings.clock, rng)
            kept = _kept(len(times), settings, rng)
            self._ticks.append((times[kept], stamps[kept]))
        self._read = [0, 0]
        self._renderer: Callable[[], Renderer] | None = None

    def read(self, drive: Drive, scene: Scene, until: float = np.inf) -> CameraFrames:
        """The frames that have arrived since this was asked last, until a time [s], and where the robot was then."""
        taken = []
        for k, (times, stamps) in enumerate(self._ticks):
            rows = np.arange(self._read[k], arrived(times, stamps, until))
            self._read[k] += len(rows)
            poses = interpolate(drive.stamps, drive.poses, times[rows])
            taken.append(Shots(EPOCH + stamps[rows], poses, times[rows], rows, scene))
        rgb, disparity = taken
        if self._renderer is None:
            words = tuple(int(word) for word in self._images.generate_state(2))
            path, counts = rgb.poses[:, :2] if until == np.inf else None, tuple(len(times) for times, _ in self._ticks)
            made = partial(Renderer, self._mount, self._settings, scene.world, self._floor)
            self._renderer = cache(partial(made, path=path, frames=counts, seed=words))
        return CameraFrames(rgb, disparity, self._renderer)


def _kept(count: int, settings: CameraSettings, rng: np.random.Generator) -> NDArray[np.intp]:
    """Which frames reach the host: after some of them, several in a row are lost."""
    gaps = rng.random(count) < settings.gap
    kept, i = [], 0
    while i < count:
        kept.append(i)
        i += 1 + (settings.gap_frames if gaps[i] else 0)
    return np.asarray(kept, np.intp)
