"""The coloured map of the floor: section III.E of the paper, along any trajectory; and its parameters.

Frames are read one after the other and added to the cells; what is held does not grow with their number.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from moteslam.errors import InputError
from moteslam.robot import rgbd, se2
from moteslam.robot.platform import CameraSpec
from moteslam.robot.raster import Raster
from moteslam.robot.recording import Recording
from moteslam.robot.rgbd import CameraFrame, FrameCount, camera_frames, has_images
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import Issue, NotNegative, Number, Section, Summarised, Truth, counted


class TextureConfig(Section):
    """The coloured map of the floor (section III.E of the paper), made of a recording that has camera images."""

    enabled: Truth = True  # Make one where there are images
    cell_size: Annotated[Number, Field(ge=0.005, le=1.0)] = 0.05  # Of the coloured map [m]
    height_limit: Number = 0.1  # Points at or above it are not floor [m]; the paper's 0.1
    # Points deeper than this are left out [m]: the error of a depth grows with its square
    max_depth: Annotated[Number, Field(gt=0, le=100)] = 8.0
    interval: NotNegative = 0.1  # Shortest time between two frames that are used [s]; 0 uses all
    largest_gap: NotNegative = 0.05  # Between the colour and the disparity image of a frame [s]
    # Take what is near the floor to lie on it, where its ray meets a flat floor, whatever its depth; the paper takes
    # the depth
    flat: Truth = False


MAX_CELLS = 40_000_000  # Of the sums, 32 bytes each
BEYOND_ENDS = 0.1  # Frames this long before the first or after the last pose still get that pose [s]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class TextureMap(Raster):
    """The floor in colours; its cells lie on the lattice of multiples of ``cell_size``.

    ``values`` [H, W, 3] uint8 are red, green, blue, the mean of the points in each cell.
    """

    points: NDArray[np.int64]  # [H, W] the number of these points; 0 where nothing is known
    frames: int  # that it was made of
    warnings: tuple[Issue, ...] = ()  # what was left out

    @property
    def known(self) -> NDArray[np.bool_]:
        """[H, W] which cells have a colour."""
        return self.points > 0


class TextureMapper:
    """Sums of the colours in each cell, frame by frame, between the corners ``low`` and ``high`` (x, y) of an area [m].

    Points outside are left out. An area of more than ``MAX_CELLS`` cells is refused.
    """

    def __init__(self, mount: CameraSpec, config: TextureConfig, low: ArrayLike, high: ArrayLike) -> None:
        self.config = config
        self._first = np.floor(np.asarray(low, np.float64) / config.cell_size).astype(np.int64)
        width, height = np.floor(np.asarray(high, np.float64) / config.cell_size).astype(np.int64) + 1 - self._first
        if width * height > MAX_CELLS:
            raise InputError(
                f"{width} x {height} cells of floor, expected at most {MAX_CELLS:.0e}; a larger cell_size helps",
                field="texture.cell_size",
            )
        self._sums = np.zeros((height, width, 4), np.int64)
        self._mount = np.column_stack((rgbd.mount_rotation(mount), (mount.x, mount.y, mount.z)))
        self.frames = 0

    def add(self, frame: CameraFrame, pose: ArrayLike) -> None:
        """Add a frame's points near the floor, seen from a pose [3] of the robot."""
        from moteslam.kernels.texture import add_frame  # imports Taichi

        c, (x, y) = self.config, (self._first * self.config.cell_size).tolist()
        add_frame(
            self._sums, frame.disparity, frame.rgb, pose, corner=(x, y), cell_size=c.cell_size, flat=c.flat,
            calibration=calibration(), mount=self._mount, height_limit=c.height_limit, max_depth=c.max_depth,
            nothing=rgbd.NO_DISPARITY,
        )  # fmt: skip
        self.frames += 1

    def snapshot(self, warnings: tuple[Issue, ...] = ()) -> TextureMap:
        """The map as it stands, cut to the cells that have a colour."""
        points = self._sums[..., 3]
        rows, columns = np.flatnonzero(points.any(axis=1)), np.flatnonzero(points.any(axis=0))
        if not len(rows):
            rows = columns = np.array([0])
        part = self._sums[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        count = np.maximum(part[..., 3:], 1)
        colours = ((part[..., :3] + count // 2) // count).astype(np.uint8)
        x, y = (self._first + np.array((columns[0], rows[0]))) * self.config.cell_size
        return TextureMap(
            values=colours,
            cell_size=self.config.cell_size,
            origin=(float(x), float(y), 0.0),
            points=part[..., 3].copy(),
            frames=self.frames,
            warnings=warnings,
        )


def calibration() -> NDArray[np.float64]:
    """The Kinect's numbers [10] as ``kernels.texture.add_frame`` takes them."""
    depth = rgbd.DISPARITY_SLOPE, rgbd.DISPARITY_OFFSET, rgbd.DEPTH_SCALE
    align = rgbd.ALIGN_SCALE, rgbd.ALIGN_DISPARITY, rgbd.ALIGN_COLUMN, rgbd.ALIGN_ROW
    return np.array((rgbd.FOCAL, *rgbd.CENTRE, *depth, *(each / rgbd.ALIGN_DIVISOR for each in align)))


def can_map(recording: Recording) -> bool:
    """Whether a recording has what a coloured map takes: images, and a camera on its robot."""
    return has_images(recording.rgbd) and recording.platform.camera is not None


def map_texture(
    recording: Recording,
    trajectory: Trajectory,
    config: TextureConfig | None = None,
    *,
    watch: Callable[[float, TextureMapper], None] | None = None,
) -> TextureMap:
    """Colour the floor along a trajectory of the robot, on the clock of the recording: an estimate, or the truth.

    Each frame's pose is the trajectory's, interpolated at the stamp of the disparity image. ``watch`` is called before
    each frame is added with its stamp and the mapper, and after the last with infinity. Refused are no images, no
    camera, no poses, and a trajectory that spans too large an area.
    """
    config = config or TextureConfig()
    stream, mount = recording.rgbd, recording.platform.camera
    if stream is None or not has_images(stream):
        raise InputError("no camera images, expected dataRGBD/ beside the arrays", file=recording.name, field="rgbd")
    if mount is None:
        raise InputError("none, expected where the camera is", file=recording.name, field="platform.camera")
    if not len(trajectory):
        raise InputError("no poses, expected a trajectory", file=recording.name, field="trajectory")
    x, y = (max(at, size - at) for at, size in zip(rgbd.CENTRE, (rgbd.WIDTH, rgbd.HEIGHT), strict=True))
    longest = float(np.sqrt(1 + (x / rgbd.FOCAL) ** 2 + (y / rgbd.FOCAL) ** 2))  # ray of the camera, for a depth of 1
    reach = np.hypot(mount.x, mount.y) + config.max_depth * longest
    xy = trajectory.poses[:, :2]
    mapper = TextureMapper(mount, config, xy.min(axis=0) - reach, xy.max(axis=0) + reach)
    count, outside = FrameCount(), 0
    first, last = trajectory.stamps[0] - BEYOND_ENDS, trajectory.stamps[-1] + BEYOND_ENDS
    for frame in camera_frames(stream, interval=config.interval, largest_gap=config.largest_gap, count=count):
        if not first <= frame.stamp <= last:
            outside += 1
            continue
        if watch is not None:
            watch(frame.stamp, mapper)
        mapper.add(frame, trajectory.at(np.array([frame.stamp])).poses[0])
    if watch is not None:
        watch(np.inf, mapper)
    lost = list(count.issues())
    if outside:
        text = f"camera: {counted(outside, 'frame')} left out, before the first pose or after the last"
        lost.append(Issue("frames-outside", text, outside))
    return mapper.snapshot(tuple(lost))


SLANT = 0.5
"""The turn of a patch's cells against the robot's axes [rad]. Were they parallel to a map's cells, all would move from
one to the next at the same shift, and nothing finer than a cell could be measured."""


@dataclass(frozen=True, eq=False, repr=False)
class FloorPatch(Summarised):
    """The floor that one frame shows."""

    points: NDArray[np.float32]  # [k, 2] centres of cells, in the robot's frame [m]; their rows are turned by `SLANT`
    colours: NDArray[np.int32]  # [k] int32 red + 256 green + 65536 blue, the mean of the points in each cell


def floor_patch(frame: CameraFrame, mount: CameraSpec, config: TextureConfig, *, max_depth: float) -> FloorPatch:
    """The floor near the robot as one frame shows it, no deeper than ``max_depth`` [m], a point a cell."""
    near = config.model_copy(update={"max_depth": max_depth})
    reach = 1.3 * max_depth + float(np.hypot(mount.x, mount.y))
    mapper = TextureMapper(mount, near, (-reach, -reach), (reach, reach))
    mapper.add(frame, (0.0, 0.0, SLANT))
    seen = mapper.snapshot()
    rows, columns = np.nonzero(seen.known)
    centres = (np.stack((columns, rows), axis=-1) + 0.5) * seen.cell_size + seen.origin[:2]
    centres = se2.transform_points(np.array((0.0, 0.0, -SLANT)), centres)
    return FloorPatch(centres.astype(np.float32), _packed(seen.values[rows, columns]))


def packed_map(texture: TextureMap) -> NDArray[np.int32]:
    """The map's colours as one number a cell [H, W], -1 where it has none."""
    return np.ascontiguousarray(np.where(texture.known, _packed(texture.values), -1), np.int32)


def colour_errors(
    patch: FloorPatch, poses: ArrayLike, texture: TextureMap, *, limit: int, packed: NDArray[np.int32] | None = None
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The mean difference of a patch's colours from the map's at each pose [n, 3], and the number of cells compared.

    A cell's difference is |r| + |g| + |b|, at most ``limit`` [levels]: robust against what has moved. The mean, float64
    [n] [levels], is over the cells that lie on known floor, half the limit where none does. ``packed_map(texture)`` may
    be made once for many frames. Poses that are not finite are refused.
    """
    from moteslam.kernels.texture import match_colours  # imports Taichi

    cells = packed_map(texture) if packed is None else packed
    sums = match_colours(
        patch.points, patch.colours, poses, cells, corner=texture.origin[:2], cell_size=texture.cell_size, limit=limit
    )
    difference, known = sums.T.astype(np.int64)
    return np.where(known > 0, difference / np.maximum(known, 1), limit / 2), known


def _packed(colours: NDArray[np.uint8]) -> NDArray[np.int32]:
    red, green, blue = np.moveaxis(colours.astype(np.int32), -1, 0)
    return np.ascontiguousarray(red | green << 8 | blue << 16)
