"""The RGB-D camera: the geometry of the UCSD robot's Kinect, and the frames of a stream, decoded as they are needed.

Optical axes: x right, y down, z forward; pixels (column i, row j) of images 480 high and 640 wide. The depth camera
has the intrinsics (``FOCAL``, ``CENTRE``); a depth pixel whose disparity is known belongs to one pixel of the colour
image, by the published calibration

    dd = -0.00304 d + 3.31,  depth = 1.03 / dd,
    rgb_i = (526.37 i - 4.5 * 1750.46 dd + 19276) / 585.051,  rgb_j = (526.37 j + 16662) / 585.051.

Put into metres that is itself a pinhole camera (``RGB_FOCAL``, ``RGB_CENTRE``), 26 mm to the right of the depth
camera (``RGB_OFFSET``): what the simulator draws and what the texture mapping undoes are one and the same geometry.
"""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.files import read_bytes
from moteslam.robot.platform import CameraSpec
from moteslam.robot.raster import PNG, decode_picture, picture_size
from moteslam.robot.recording import RgbdStream, nearest_stamp
from moteslam.robot.values import Issue, Summarised, counted, processor_count

T = TypeVar("T", bound=np.generic)

HEIGHT, WIDTH = 480, 640  # Rows and columns of both images
FOCAL = 585.05108211  # Of the depth camera, in both directions [pixels]
CENTRE = (315.83800193, 242.94140713)
"""Principal point of the depth camera: column, row. Several public copies swap them, which turns the floor by 7 deg."""
DISPARITY_SLOPE, DISPARITY_OFFSET = -0.00304, 3.31  # dd = slope * d + offset
DEPTH_SCALE = 1.03  # depth = scale / dd [m]
NO_DISPARITY = 2047  # The raw disparity of a pixel that saw nothing: all eleven bits
ALIGN_SCALE, ALIGN_DIVISOR, ALIGN_DISPARITY = 526.37, 585.051, 4.5 * 1750.46
ALIGN_COLUMN, ALIGN_ROW = 19276.0, 16662.0

RGB_FOCAL = ALIGN_SCALE / ALIGN_DIVISOR * FOCAL
RGB_CENTRE = (
    (ALIGN_SCALE * CENTRE[0] + ALIGN_COLUMN) / ALIGN_DIVISOR,
    (ALIGN_SCALE * CENTRE[1] + ALIGN_ROW) / ALIGN_DIVISOR,
)
RGB_OFFSET = ALIGN_DISPARITY * DEPTH_SCALE / ALIGN_DIVISOR / RGB_FOCAL
"""How far the colour camera stands to the right of the depth camera, along its x axis [m]."""

OPTICAL_TO_BODY: NDArray[np.float64] = np.array(((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0)))
"""Equation III.7 with the sign that makes it a rotation (the paper's has determinant -1)."""
OPTICAL_TO_BODY.setflags(write=False)


def depth_of(disparity: NDArray[np.uint16]) -> NDArray[np.float64]:
    """Depths [m] of raw disparities of any shape; NaN where nothing was seen, or behind what can be."""
    dd = DISPARITY_SLOPE * disparity.astype(np.float64) + DISPARITY_OFFSET
    return np.where((disparity < NO_DISPARITY) & (dd > 0), DEPTH_SCALE / np.where(dd > 0, dd, 1.0), np.nan)


def disparity_of(depth: NDArray[np.floating]) -> NDArray[np.uint16]:
    """The nearest raw disparities of depths [m] of any shape: 2047 where a depth is not positive, or not finite."""
    known = np.isfinite(depth) & (depth > 0)
    raw = (DEPTH_SCALE / np.where(known, depth, 1.0).astype(np.float64) - DISPARITY_OFFSET) / DISPARITY_SLOPE
    seen = known & (raw > -0.5) & (raw < NO_DISPARITY - 0.5)
    return np.where(seen, np.rint(np.where(seen, raw, 0.0)), NO_DISPARITY).astype(np.uint16)


def mount_rotation(mount: CameraSpec) -> NDArray[np.float64]:
    """The rotation [3, 3] from optical axes to the robot's: III.7, then roll, pitch and yaw of the mount.

    They turn about the robot's x, y and z, so that a positive pitch looks down.
    """
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("ZYX", (mount.yaw, mount.pitch, mount.roll)).as_matrix() @ OPTICAL_TO_BODY)


MAX_BYTES = 16 << 20  # Images are files of at most this size: more than 640 x 480 pixels take
LARGEST_GAP = 0.05
"""A colour image further from the disparity image than this [s] shows another view (the real one's cameras lose
frames of their own, for 0.2 s at a time)."""


@dataclass(frozen=True, eq=False, repr=False)
class CameraFrame(Summarised):
    """What the camera saw at a moment."""

    stamp: float  # of the disparity image [s]
    rgb_stamp: float  # of the colour image [s]
    disparity: NDArray[np.uint16]  # [480, 640], raw
    rgb: NDArray[np.uint8]  # [480, 640, 3], red, green, blue


@dataclass(eq=False)
class FrameCount:
    """What became of the frames while they were read."""

    used: int = 0  # handed out
    missing: int = 0  # without a file for one of the images
    unreadable: int = 0  # an image of which could not be decoded
    first_unreadable: str = ""  # what was wrong with the first of them

    def note(self, frame: CameraFrame | str | None) -> None:
        """Count what ``read_frame`` gave."""
        if isinstance(frame, CameraFrame):
            self.used += 1
        elif frame is None:
            self.missing += 1
        else:
            self.unreadable += 1
            self.first_unreadable = self.first_unreadable or frame

    def losses(self, reader: str) -> list[Issue]:
        """One for each kind of loss that happened, by what reads the frames."""
        lost = (
            ("frames-incomplete", self.missing, "an image of theirs is missing"),
            ("frames-unreadable", self.unreadable, f"unreadable; the first: {self.first_unreadable}"),
        )
        return [Issue(code, f"{reader}: {counted(n, 'frame')} left out, {why}", n) for code, n, why in lost if n]

    def issues(self) -> tuple[Issue, ...]:
        """One for each kind of loss that happened, and where no frame is left."""
        none = () if self.used else (Issue("no-frames", "camera: no two images of one moment that can be read"),)
        return (*self.losses("camera"), *none)


def has_images(stream: RgbdStream | None) -> bool:
    """Whether there are both colour and disparity images, and not just stamps."""
    return stream is not None and (stream.images is not None or (any(stream.rgb_files) and any(stream.disparity_files)))


class FrameChoice:
    """Which disparity images are used: those at least an interval [s] apart, give or take a quarter of the latest
    frames', and from their colour image, the nearest in time, by at most the largest gap [s].
    """

    def __init__(self, interval: float, largest_gap: float) -> None:
        self._interval, self._largest_gap, self._last = interval, largest_gap, -np.inf
        self._latest: deque[float] = deque(maxlen=31)

    def takes(self, stamp: float, colour: float) -> bool:
        """Whether the next disparity image is used, by its stamp and its colour image's [s]."""
        self._latest.append(stamp)
        slack = 0.25 * float(np.median(np.diff(self._latest))) if self._interval and len(self._latest) > 1 else 0.0
        taken = abs(stamp - colour) <= self._largest_gap and stamp - self._last >= self._interval - slack
        self._last = stamp if taken else self._last
        return taken


def pairs(
    stream: RgbdStream, *, interval: float = 0.0, largest_gap: float = LARGEST_GAP
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The disparity images that are used and the colour image of each, by their indices: see `FrameChoice`."""
    rgb, disparity, choice = stream.rgb_stamps, stream.disparity_stamps, FrameChoice(interval, largest_gap)
    if not len(rgb):
        return np.empty(0, np.intp), np.empty(0, np.intp)
    nearest = nearest_stamp(rgb, disparity)
    kept = np.flatnonzero([choice.takes(*each) for each in zip(disparity, rgb[nearest], strict=True)])
    return kept, nearest[kept]


def decode_rgb(content: bytes) -> NDArray[np.uint8]:
    """A colour image [480, 640, 3], red, green, blue, of a PNG or JPEG file; otherwise a ValueError."""
    return np.ascontiguousarray(_decoded(content, np.uint8, (3, 4))[..., 2::-1])


def decode_disparity(content: bytes) -> NDArray[np.uint16]:
    """An image [480, 640] of 16 bits; otherwise a ValueError."""
    return np.ascontiguousarray(_decoded(content, np.uint16, (1,))[..., 0])


def _decoded(content: bytes, dtype: type, channels: tuple[int, ...]) -> NDArray[Any]:
    """An image [480, 640, channels]."""
    import cv2

    size = picture_size(content) if content.startswith((PNG, b"\xff\xd8")) else None
    if size != (WIDTH, HEIGHT):  # before any memory is taken for it
        found = "no PNG or JPEG file" if size is None else f"{size[1]} x {size[0]} pixels"
        raise ValueError(f"{found}, expected {HEIGHT} x {WIDTH}")
    image = decode_picture(content, cv2.IMREAD_UNCHANGED)
    if image is None:
        raise ValueError("cut short or damaged, expected a whole PNG file")
    image = image.reshape(HEIGHT, WIDTH, -1)
    if image.dtype != dtype or image.shape[2] not in channels:
        found = f"{' x '.join(map(str, image.squeeze().shape))} of {8 * image.dtype.itemsize} bits"
        expected = f"expected {HEIGHT} x {WIDTH} x {channels[0]} of {8 * np.dtype(dtype).itemsize}"
        raise ValueError(f"{found}, {expected}")
    return image


def rgb_image(stream: RgbdStream, index: int) -> NDArray[np.uint8] | None:
    """The colour image of a stamp; None if missing."""
    return _read(stream.rgb_files, index, decode_rgb) if stream.images is None else stream.images.rgb(index)


def disparity_image(stream: RgbdStream, index: int) -> NDArray[np.uint16] | None:
    """The raw disparities of a stamp; None if missing."""
    files, source = stream.disparity_files, stream.images
    return _read(files, index, decode_disparity) if source is None else source.disparity(index)


def _read(files: tuple[Path | None, ...], index: int, decode: Callable[[bytes], NDArray[T]]) -> NDArray[T] | None:
    if not files or (path := files[index]) is None:
        return None
    try:
        return decode(read_bytes(path, "a PNG image", limit=MAX_BYTES))
    except ValueError as error:
        raise InputError(str(error), file=path) from error


def read_frame(stream: RgbdStream, disparity: int, rgb: int) -> CameraFrame | str | None:
    """The frame of two images, by their indices; None if one is missing, a text on one that cannot be decoded."""
    try:
        depth, colour = disparity_image(stream, disparity), rgb_image(stream, rgb)
    except InputError as error:
        return str(error)
    if depth is None or colour is None:
        return None
    return CameraFrame(float(stream.disparity_stamps[disparity]), float(stream.rgb_stamps[rgb]), depth, colour)


def camera_frames(
    stream: RgbdStream, *, interval: float = 0.0, largest_gap: float = LARGEST_GAP, count: FrameCount | None = None
) -> Iterator[CameraFrame]:
    """The frames in the order of their stamps, decoded on all cores, some ahead.

    An image that is missing or cannot be read leaves its frame out; ``count`` counts it.
    """
    count = count or FrameCount()
    depth, colour = pairs(stream, interval=interval, largest_gap=largest_gap)
    frames = list(zip(depth.tolist(), colour.tolist(), strict=True))
    cores = processor_count()
    with ThreadPoolExecutor(cores) as pool:
        ready: Iterator[CameraFrame | str | None] = iter(())
        for first in range(0, len(frames) + cores, cores):
            following = pool.map(lambda pair: read_frame(stream, *pair), frames[first : first + cores])
            for frame in ready:
                count.note(frame)
                if isinstance(frame, CameraFrame):
                    yield frame
            ready = following
