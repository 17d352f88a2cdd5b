"""Colour and depth images of a bag, as the frames of the Kinect that the pipeline takes.

That camera is `moteslam.robot.rgbd`: 480 x 640 pixels, a depth camera and a colour camera beside it, each with its
own intrinsics. Images of cameras whose intrinsics (``sensor_msgs/CameraInfo``) are those, within some pixels, are
read; of others they would be laid on the wrong floor. Depths (REP 118) become the raw disparities nearest to them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.formats.bags.bag import Bag, Table, Topic
from moteslam.robot.formats.bags.frames import Frames
from moteslam.robot.formats.bags.times import Times
from moteslam.robot.pictures import PNG, decode_picture, picture_size
from moteslam.robot.platform import CameraSpec
from moteslam.robot.recording import RgbdStream
from moteslam.robot.rgbd import CENTRE, FOCAL, HEIGHT, RGB_CENTRE, RGB_FOCAL, WIDTH, disparity_of, mount_of
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
    """The images of two topics, read and decoded when they are asked for (an `ImageSource`).

    Attributes:
        bag: to read from.
        colour, depth: the topics.
        colour_places, depth_places: [m, 3], [n, 3] where the image of each stamp lies.
    """

    bag: Bag
    colour: Topic
    depth: Topic
    colour_places: NDArray[np.int64]
    depth_places: NDArray[np.int64]

    def rgb(self, index: int) -> NDArray[np.uint8]:
        """The colour image [480, 640, 3] of a stamp.

        Raises:
            InputError: it is damaged, or of another size or kind.
        """
        image: NDArray[np.uint8] = self._image(self.colour, self.colour_places, index, _colour_image)
        return image

    def disparity(self, index: int) -> NDArray[np.uint16]:
        """The raw disparities [480, 640] of a stamp; raises as `rgb`."""
        return disparity_of(self._image(self.depth, self.depth_places, index, _depth_image))

    def _image(self, topic: Topic, places: NDArray[np.int64], index: int, decode: Any) -> Any:
        (data,) = self.bag.payloads(places[index : index + 1])
        try:
            return decode(self.bag.decode(topic, data), topic.kind)
        except ValueError as error:
            raise InputError(f"image {index}: {error}", file=self.bag.path, field=topic.name) from error


def image_table(topic: Topic) -> Table:
    """Of images: their stamps."""
    return Table(topic, lambda _: (), 0)


def image_topics(bag: Bag, named: dict[str, Topic], issues: list[Issue]) -> tuple[Topic, Topic] | None:
    """The topics of colour and depth images of a Kinect: those named, else the first with intrinsics that agree.

    Images that are not read are an issue, with the reason.
    """
    topics = bag.of_kind(COMPRESSED_IMAGE, IMAGE)
    infos = {info.name: info for info in bag.of_kind(CAMERA_INFO)}
    firsts = _firsts(bag, [*topics, *infos.values()]) if topics else {}
    found: dict[str, Topic] = {}
    reasons = []
    for topic in topics:
        kind, problem = _kind_of(topic, infos, firsts)
        if problem is not None:
            reasons.append(f"{topic.name} ({problem})")
        elif topic == named.get(kind, topic):
            found.setdefault(kind, topic)
    if len(found) == 2:
        return found["rgb"], found["depth"]
    if topics:
        alone = [f"{one.name} (no {'depth' if kind == 'rgb' else 'colour'} beside it)" for kind, one in found.items()]
        text = f"{bag.path.name}: images left out: {', '.join((reasons + alone)[:4]) or topics[0].name}"
        issues.append(Issue("images-left", text, len(topics)))
    return None


def _firsts(bag: Bag, topics: list[Topic]) -> dict[Topic, Any]:
    """The first message of each topic, or why it is none."""
    found: dict[Topic, Any] = {}
    for topic, _, _, data in bag.sweep(topics):
        if topic not in found:
            try:
                found[topic] = bag.decode(topic, data)
            except ValueError as error:
                found[topic] = str(error)
            if len(found) == len(topics):
                break
    return found


def rgbd_stream(bag: Bag, tables: tuple[Table, Table], times: Times) -> RgbdStream:
    """The frames of colour and depth images.

    Raises:
        InputError: too many broken messages, or absurd stamps.
    """
    (colour, rgb), (depth, disparity) = (times.used(table) for table in tables)
    places = [np.array(table.places).reshape(-1, 3) for table in tables]
    images = BagImages(bag, tables[0].topic, tables[1].topic, places[0][colour], places[1][depth])
    return RgbdStream(rgb, disparity, images=images)


def camera_mount(table: Table, frames: Frames, base: str | None) -> CameraSpec | None:
    """Where the depth camera stands on the robot; None where no transforms lead there."""
    placed = frames.place(table.frame(), base) if base is not None else None
    if placed is None:
        return None
    x, y, z = placed[0][:3, 3].tolist()
    roll, pitch, yaw = mount_of(placed[0][:3, :3])
    return CameraSpec(x=x, y=y, z=z, roll=roll, pitch=pitch, yaw=yaw)


def _kind_of(topic: Topic, infos: dict[str, Topic], firsts: dict[Topic, Any]) -> tuple[str, str | None]:
    """Whether a topic's images are ``rgb`` or ``depth``, ``""`` if neither; and why they cannot be read, or None."""
    image = firsts.get(topic, "no message")
    if isinstance(image, str):
        return "", image
    text = str(image.format if topic.kind == COMPRESSED_IMAGE else image.encoding)
    if topic.kind == IMAGE and text not in _COLOURS and text not in _DEPTHS:
        return "", f"encoding {text[:20]!r}"
    kind = "depth" if any(word in text for word in ("compressedDepth", *_DEPTHS)) else "rgb"
    above = [
        topic.name.rsplit("/", level)[0] + "/camera_info" for level in (1, 2)
    ]  # beside it, or what it is packed of
    info = next((firsts.get(infos[name], "") for name in above if name in infos), None)
    if info is None:
        return kind, "no CameraInfo beside it"
    if isinstance(info, str):
        return kind, f"CameraInfo {info}"
    if (info.height, info.width) != (HEIGHT, WIDTH):
        return kind, f"{info.height} x {info.width} pixels, expected {HEIGHT} x {WIDTH}"
    matrix = np.asarray(info.K if hasattr(info, "K") else info.k, np.float64)
    off = _off(matrix, *((RGB_FOCAL, RGB_CENTRE) if kind == "rgb" else (FOCAL, CENTRE)))
    if not off <= TOLERANCE:
        return kind, f"its corners lie {off:.0f} pixels from the Kinect's, expected at most {TOLERANCE:g}"
    return kind, None


def _off(matrix: NDArray[np.float64], focal: float, centre: tuple[float, float]) -> float:
    """How far from the Kinect's corners the rays through these lie in another camera's image [pixels]."""
    scale = (matrix[0] / focal, matrix[4] / focal)
    shifts = [
        matrix[2 + 3 * axis] + scale[axis] * (corner - centre[axis]) - corner
        for axis, size in ((0, WIDTH), (1, HEIGHT))
        for corner in (0, size - 1)
    ]
    return float(np.abs(shifts).max())


def _colour_image(image: Any, kind: str) -> NDArray[np.uint8]:
    import cv2

    if kind == COMPRESSED_IMAGE:
        return np.ascontiguousarray(_decoded(image.data.tobytes(), cv2.IMREAD_COLOR)[..., ::-1])
    if image.encoding not in _COLOURS:
        raise ValueError(f"encoding {image.encoding[:20]!r}, expected colours")
    size, order = _COLOURS[image.encoding]
    rows = _raw_rows(image, size)
    return np.ascontiguousarray(rows[:, : WIDTH * size].reshape(HEIGHT, WIDTH, size)[..., order])


def _depth_image(image: Any, kind: str) -> NDArray[np.float64]:
    """Depths [480, 640] [m]; 0 or NaN where nothing was seen."""
    import cv2

    if kind == COMPRESSED_IMAGE:
        content = image.data.tobytes()
        pixels = _decoded(
            content[_DEPTH_HEADER:] if "compressedDepth" in image.format else content, cv2.IMREAD_UNCHANGED
        )
        if pixels.dtype != np.uint16 or pixels.ndim != 2:
            raise ValueError("no depths of 16 bits")
        return pixels * 0.001
    if image.encoding not in _DEPTHS:
        raise ValueError(f"encoding {image.encoding[:20]!r}, expected depths")
    name, unit = _DEPTHS[image.encoding]
    dtype = np.dtype(f"{'>' if image.is_bigendian else '<'}{name}")
    rows = _raw_rows(image, dtype.itemsize)
    return np.ascontiguousarray(rows[:, : WIDTH * dtype.itemsize]).view(dtype).astype(np.float64) * unit


def _raw_rows(image: Any, size: int) -> NDArray[np.uint8]:
    """The bytes [480, step] of an Image, ``size`` of them a pixel."""
    if (
        (image.height, image.width) != (HEIGHT, WIDTH)
        or image.step < WIDTH * size
        or len(image.data) < image.step * HEIGHT
    ):
        raise ValueError(f"{image.height} x {image.width} pixels, expected {HEIGHT} x {WIDTH}")
    rows: NDArray[np.uint8] = image.data[: image.step * HEIGHT].reshape(HEIGHT, image.step)
    return rows


def _decoded(content: bytes, how: int) -> NDArray[Any]:
    if not content.startswith((PNG, b"\xff\xd8")):
        raise ValueError("neither PNG nor JPEG")
    size = picture_size(content)
    if size != (WIDTH, HEIGHT):  # before any memory is taken for it
        raise ValueError(f"{size or 'no'} pixels, expected {HEIGHT} x {WIDTH}")
    image = decode_picture(content, how)
    if image is None:
        raise ValueError("cut short or damaged")
    return image
