"""Colour and depth images of a bag, as the frames of the Kinect that the pipeline takes.

That camera is `moteslam.robot.rgbd`: 480 x 640 pixels, a depth camera and a colour camera beside it, each with its
own intrinsics. Images of cameras whose intrinsics (``sensor_msgs/CameraInfo``) are those, within some pixels, are
read; of others they would be laid on the wrong floor. Depths (REP 118) become the raw disparities nearest to them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.formats.bags.bag import Bag, Rows, Table
from moteslam.robot.formats.bags.motion import Frames
from moteslam.robot.platform import CameraSpec
from moteslam.robot.recording import RgbdStream
from moteslam.robot.rgbd import (
    CENTRE,
    FOCAL,
    HEIGHT,
    RGB_CENTRE,
    RGB_FOCAL,
    WIDTH,
    decode_disparity,
    decode_rgb,
    disparity_of,
    mount_of,
)
from moteslam.robot.values import Issue

IMAGE, COMPRESSED_IMAGE, CAMERA_INFO = "sensor_msgs/Image", "sensor_msgs/CompressedImage", "sensor_msgs/CameraInfo"

TOLERANCE = 4.0
"""Pixels by which a camera may see a corner of the image elsewhere than the Kinect does."""
_COLOURS = {"rgb8": (3, (0, 1, 2)), "bgr8": (3, (2, 1, 0)), "rgba8": (4, (0, 1, 2)), "bgra8": (4, (2, 1, 0))}
"""Bytes a pixel, and which of them are red, green and blue, by encoding."""
_DEPTHS = {"16UC1": ("u2", 0.001), "mono16": ("u2", 0.001), "32FC1": ("f4", 1.0)}
"""Of a pixel, and metres of a unit, by encoding."""
_DEPTH_HEADER = 12
"""Bytes before the PNG of an image packed by compressed_depth_image_transport."""


@dataclass(frozen=True, eq=False)
class BagImages:
    """The images of two topics, read and decoded when they are asked for (an `ImageSource`); the rows [m], [n] are the
    message of each stamp.
    """

    bag: Bag
    colour: Table
    depth: Table
    colour_rows: Rows
    depth_rows: Rows

    def rgb(self, index: int) -> NDArray[np.uint8]:
        """The colour image [480, 640, 3] of a stamp."""
        return self._image(self.colour, self.colour_rows, index)

    def disparity(self, index: int) -> NDArray[np.uint16]:
        """The raw disparities [480, 640] of a stamp; raises as `rgb`."""
        return disparity_of(self._image(self.depth, self.depth_rows, index))

    def _image(self, table: Table, rows: Rows, index: int) -> NDArray[Any]:
        (message,) = self.bag.messages(table, rows[index : index + 1])
        try:
            return _colour_image(message) if table is self.colour else _depth_image(message)
        except ValueError as error:
            raise InputError(f"image {index}: {error}", file=self.bag.path, field=table.topic.name) from error


def image_tables(bag: Bag, tables: Sequence[Table], named: Mapping[str, Sequence[str]]) -> tuple[Table, Table] | None:
    """Of all tables those of the colour and depth images of a Kinect: those named, else the first with intrinsics that
    agree. Images that are not read are an issue, with the reason.
    """
    images = [table for table in tables if table.topic.kind in (IMAGE, COMPRESSED_IMAGE)]
    if not images:
        return None
    infos = {table.topic.name: table.first for table in tables if table.topic.kind == CAMERA_INFO}
    found: dict[str, Table] = {}
    left = []
    for table in images:
        name, parent = table.topic.name, table.topic.name.rpartition("/")[0]
        # beside the image, or beside the one that it is packed of
        info = infos.get(f"{parent}/camera_info") or infos.get(f"{parent.rpartition('/')[0]}/camera_info")
        kind, problem = ("", table.problem) if table.first is None else _kind_of(table.first, info)
        if problem:
            left.append(f"{name} ({problem})")
        elif name in named.get(kind, (name,)):
            found.setdefault(kind, table)
    if len(found) == 2:
        return found["rgb"], found["depth"]
    left += [f"{one.topic.name} (no {'depth' if kind == 'rgb' else 'colour'} beside it)" for kind, one in found.items()]
    text = f"{bag.path.name}: images left out: {', '.join(left[:4]) or images[0].topic.name}"
    bag.issues.append(Issue("images-left", text, len(images)))
    return None


def _kind_of(image: Any, info: Any) -> tuple[str, str]:
    """Whether an image is ``rgb`` or ``depth``, and why it cannot be read, by its CameraInfo."""
    text = str(image.format if hasattr(image, "format") else image.encoding)
    if hasattr(image, "encoding") and text not in _COLOURS and text not in _DEPTHS:
        return "", f"encoding {text[:20]!r}"
    kind = "depth" if any(word in text for word in ("compressedDepth", *_DEPTHS)) else "rgb"
    if info is None:
        return kind, "CameraInfo: none beside it"
    if (info.height, info.width) != (HEIGHT, WIDTH):
        return kind, f"{info.height} x {info.width} pixels, expected {HEIGHT} x {WIDTH}"
    matrix = np.asarray(info.K if hasattr(info, "K") else info.k, np.float64).reshape(3, 3)
    focal, centre = (RGB_FOCAL, RGB_CENTRE) if kind == "rgb" else (FOCAL, CENTRE)
    corners = np.array([[0, 0], [WIDTH - 1, HEIGHT - 1]])  # of the Kinect's image, and of the rays through them here
    shifts = matrix[:2, 2] + np.diag(matrix)[:2] / focal * (corners - centre) - corners
    off = float(np.abs(shifts).max())
    if not off <= TOLERANCE:
        return kind, f"its corners lie {off:.0f} pixels from the Kinect's, expected at most {TOLERANCE:g}"
    return kind, ""


def rgbd_stream(bag: Bag, colour: Table, depth: Table) -> RgbdStream:
    """The frames of colour and depth images."""
    (rgb_rows, rgb), (depth_rows, disparity) = bag.used(colour), bag.used(depth)
    return RgbdStream(rgb, disparity, images=BagImages(bag, colour, depth, rgb_rows, depth_rows))


def camera_mount(table: Table, frames: Frames, base: str | None) -> CameraSpec | None:
    """Where the depth camera stands on the robot; None where no transforms lead there."""
    placed = frames.place(table.frame, base)
    if placed is None:
        return None
    x, y, z = placed[0][:3, 3].tolist()
    roll, pitch, yaw = mount_of(placed[0][:3, :3])
    return CameraSpec(x=x, y=y, z=z, roll=roll, pitch=pitch, yaw=yaw)


def _colour_image(image: Any) -> NDArray[np.uint8]:
    if hasattr(image, "format"):
        return decode_rgb(image.data.tobytes())
    if image.encoding not in _COLOURS:
        raise ValueError(f"encoding {image.encoding[:20]!r}, expected colours")
    size, order = _COLOURS[image.encoding]
    return np.ascontiguousarray(_pixels(image, size).reshape(HEIGHT, WIDTH, size)[..., order])


def _depth_image(image: Any) -> NDArray[np.float64]:
    """Depths [480, 640] [m]; 0 or NaN where nothing was seen."""
    if hasattr(image, "format"):
        header = _DEPTH_HEADER if "compressedDepth" in image.format else 0
        return 0.001 * decode_disparity(image.data.tobytes()[header:]).astype(np.float64)
    if image.encoding not in _DEPTHS:
        raise ValueError(f"encoding {image.encoding[:20]!r}, expected depths")
    name, unit = _DEPTHS[image.encoding]
    dtype = np.dtype(f"{'>' if image.is_bigendian else '<'}{name}")
    return _pixels(image, dtype.itemsize).view(dtype).astype(np.float64) * unit


def _pixels(image: Any, size: int) -> NDArray[np.uint8]:
    """The bytes [480, 640 * size] of an Image of ``size`` bytes a pixel."""
    height, width, step = image.height, image.width, image.step
    if (height, width) != (HEIGHT, WIDTH) or step < WIDTH * size or len(image.data) < step * HEIGHT:
        raise ValueError(f"{height} x {width} pixels, expected {HEIGHT} x {WIDTH}")
    return np.ascontiguousarray(image.data[: step * HEIGHT].reshape(HEIGHT, step)[:, : WIDTH * size])
