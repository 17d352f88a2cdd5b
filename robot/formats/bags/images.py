"""Colour and depth images of a bag, as the frames of the Kinect that the pipeline takes.

That camera is `moteslam.robot.kinect`: 480 x 640 pixels, a depth camera and a colour camera beside it, each with its
own intrinsics. Images of cameras whose intrinsics (``sensor_msgs/CameraInfo``) are those, within some pixels, are
read; of others they would be laid on the wrong floor. Depths (REP 118) become the raw disparities nearest to them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.formats.bags.bag import Bag, Topic
from moteslam.robot.formats.bags.choice import CAMERA_INFO, COMPRESSED_IMAGE, IMAGE, Chosen, is_readable
from moteslam.robot.formats.bags.cursor import BrokenMessageError, Cursor
from moteslam.robot.formats.bags.heads import HeadReader
from moteslam.robot.formats.bags.times import used_messages
from moteslam.robot.formats.bags.transforms import FrameTree, frame_name
from moteslam.robot.issues import Issue
from moteslam.robot.kinect import CENTRE, FOCAL, HEIGHT, RGB_CENTRE, RGB_FOCAL, WIDTH, disparity_of, mount_of
from moteslam.robot.pictures import PNG, decode_picture, picture_size
from moteslam.robot.recording import RgbdStream
from moteslam.robot.specs import CameraSpec

TOLERANCE = 4.0
"""Pixels by which a camera may see a corner of the image elsewhere than the Kinect does."""

INFO = 4096
"""Bytes of a CameraInfo that are read, and of an image for its size and encoding."""

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
        colour_indices, depth_indices: the message of each stamp.
    """

    bag: Bag
    colour: Topic
    depth: Topic
    colour_indices: NDArray[np.intp]
    depth_indices: NDArray[np.intp]

    def rgb(self, index: int) -> NDArray[np.uint8]:
        """The colour image [480, 640, 3] of a stamp.

        Raises:
            InputError: it is damaged, or of another size or kind.
        """
        image: NDArray[np.uint8] = self._image(self.colour, int(self.colour_indices[index]), _colour_image)
        return image

    def disparity(self, index: int) -> NDArray[np.uint16]:
        """The raw disparities [480, 640] of a stamp.

        Raises:
            InputError: as `rgb`.
        """
        return disparity_of(self._image(self.depth, int(self.depth_indices[index]), _depth_image))

    def _image(self, topic: Topic, index: int, decode: Any) -> Any:
        data = next(iter(self.bag.messages(topic, np.array([index]))))
        try:
            return decode(data, topic.kind, ros1=self.bag.ros1)
        except (BrokenMessageError, ValueError) as error:
            raise InputError(f"image {index}: {error}", file=self.bag.path, field=topic.name) from error


def image_reader(topic: Topic, *, ros1: bool) -> HeadReader:
    """What reads the stamps of images."""
    return HeadReader(len(topic), ros1=ros1, texts=1, kind="u4", width=0)


def image_topics(bag: Bag, chosen: Chosen, issues: list[Issue]) -> tuple[Topic, Topic] | None:
    """The topics of colour and depth images of a Kinect: those named, else the first with intrinsics that agree.

    Images that are not read are an issue, with the reason.
    """
    topics = [topic for topic in bag.of_kind(COMPRESSED_IMAGE, IMAGE) if is_readable(topic)]
    found: dict[str, Topic] = {}
    reasons = []
    for topic in topics:
        kind, problem = _kind_of(bag, topic)
        named = {"rgb": chosen.rgb, "depth": chosen.depth}
        wanted = [named[kind]] if kind and named[kind] is not None else topics
        if problem is None and kind and topic in wanted:
            found.setdefault(kind, topic)
        elif problem is not None:
            reasons.append(f"{topic.name} ({problem})")
    if "rgb" in found and "depth" in found:
        return found["rgb"], found["depth"]
    if topics:
        only = [
            f"{topic.name} (no {'depth' if kind == 'rgb' else 'colour'} beside it)" for kind, topic in found.items()
        ]
        text = f"{bag.path.name}: images left out: {', '.join((reasons + only)[:4]) or topics[0].name}"
        issues.append(Issue("images-left", text, len(topics)))
    return None


def rgbd_stream(
    bag: Bag, topics: tuple[Topic, Topic], readers: tuple[HeadReader, HeadReader], issues: list[Issue]
) -> RgbdStream:
    """The frames of colour and depth images.

    Raises:
        InputError: too many broken messages, or absurd stamps.
    """
    (colour, rgb), (depth, disparity) = (
        used_messages(bag.path, topic, reader.heads().stamps, reader.heads().broken, issues)
        for topic, reader in zip(topics, readers, strict=True)
    )
    return RgbdStream(rgb, disparity, images=BagImages(bag, *topics, colour, depth))


def camera_mount(reader: HeadReader, tree: FrameTree, base: str | None) -> CameraSpec | None:
    """Where the depth camera stands on the robot; None where no transforms lead there."""
    frame = next((frame_name(texts[0]) for texts in reader.heads().texts if texts), "")
    placed = tree.place(frame, base) if base is not None else None
    if placed is None:
        return None
    x, y, z = placed.pose[:3, 3].tolist()
    roll, pitch, yaw = mount_of(placed.pose[:3, :3])
    return CameraSpec(x=x, y=y, z=z, roll=roll, pitch=pitch, yaw=yaw)


def _kind_of(bag: Bag, topic: Topic) -> tuple[str, str | None]:
    """Whether a topic's images are ``rgb`` or ``depth``, ``""`` if neither; and why they cannot be read, or None."""
    try:
        kind = _declared_kind(next(iter(bag.messages(topic, np.arange(1), at_most=INFO))), topic.kind, ros1=bag.ros1)
    except (BrokenMessageError, ValueError) as error:
        return "", str(error)
    info = _info_of(bag, topic)
    if info is None:
        return kind, "no CameraInfo beside it"
    try:
        height, width, matrix = _intrinsics(next(iter(bag.messages(info, np.arange(1), at_most=INFO))), bag.ros1)
    except BrokenMessageError as error:
        return kind, f"CameraInfo {error}"
    if (height, width) != (HEIGHT, WIDTH):
        return kind, f"{height} x {width} pixels, expected {HEIGHT} x {WIDTH}"
    off = _off(matrix, *((RGB_FOCAL, RGB_CENTRE) if kind == "rgb" else (FOCAL, CENTRE)))
    if not off <= TOLERANCE:
        return kind, f"its corners lie {off:.0f} pixels from the Kinect's, expected at most {TOLERANCE:g}"
    return kind, None


def _declared_kind(data: bytes, message: str, *, ros1: bool) -> str:
    cursor = _behind_header(data, ros1=ros1)
    if message == COMPRESSED_IMAGE:
        text = cursor.text()
        is_depth = any(word in text for word in ("compressedDepth", "16UC1", "mono16", "32FC1"))
        return "depth" if is_depth else "rgb"
    cursor.numbers("II")
    encoding = cursor.text()
    if encoding not in _COLOURS and encoding not in _DEPTHS:
        raise BrokenMessageError(f"encoding {encoding[:20]!r}")
    return "rgb" if encoding in _COLOURS else "depth"


def _info_of(bag: Bag, topic: Topic) -> Topic | None:
    """The CameraInfo of an image topic: ``camera_info`` beside it, or beside what it is a packed form of."""
    above = [topic.name.rsplit("/", level)[0] + "/camera_info" for level in (1, 2)]
    infos = {info.name: info for info in bag.of_kind(CAMERA_INFO) if is_readable(info)}
    return next((infos[name] for name in above if name in infos), None)


def _intrinsics(data: bytes, ros1: bool) -> tuple[int, int, NDArray[np.float64]]:
    """Height, width and the matrix K [9] of a CameraInfo."""
    cursor = _behind_header(data, ros1=ros1)
    height, width = cursor.numbers("II")
    cursor.raw_text()
    cursor.array("f8")
    return height, width, cursor.array("f8", 9).astype(np.float64)


def _off(matrix: NDArray[np.float64], focal: float, centre: tuple[float, float]) -> float:
    """How far from the Kinect's corners the rays through these lie in another camera's image [pixels]."""
    scale = (matrix[0] / focal, matrix[4] / focal)
    shifts = [
        matrix[2 + 3 * axis] + scale[axis] * (corner - centre[axis]) - corner
        for axis, size in ((0, WIDTH), (1, HEIGHT))
        for corner in (0, size - 1)
    ]
    return float(np.abs(shifts).max())


def _behind_header(data: bytes, *, ros1: bool) -> Cursor:
    cursor = Cursor(data, ros1=ros1)
    cursor.position = 12
    cursor.raw_text()
    return cursor


def _colour_image(data: bytes, kind: str, *, ros1: bool) -> NDArray[np.uint8]:
    import cv2

    cursor = _behind_header(data, ros1=ros1)
    if kind == COMPRESSED_IMAGE:
        cursor.raw_text()
        image = _decoded(cursor.array("u1").tobytes(), cv2.IMREAD_COLOR)
        return np.ascontiguousarray(image[..., ::-1])
    encoding, rows, _ = _raw_rows(cursor)
    if encoding not in _COLOURS:
        raise BrokenMessageError(f"encoding {encoding[:20]!r}, expected colours")
    size, order = _COLOURS[encoding]
    return np.ascontiguousarray(rows[:, : WIDTH * size].reshape(HEIGHT, WIDTH, size)[..., order])


def _depth_image(data: bytes, kind: str, *, ros1: bool) -> NDArray[np.float64]:
    """Depths [480, 640] [m]; 0 or NaN where nothing was seen."""
    import cv2

    cursor = _behind_header(data, ros1=ros1)
    if kind == COMPRESSED_IMAGE:
        text = cursor.text()
        content = cursor.array("u1").tobytes()
        content = content[_DEPTH_HEADER:] if "compressedDepth" in text else content
        image = _decoded(content, cv2.IMREAD_UNCHANGED)
        if image.dtype != np.uint16 or image.ndim != 2:
            raise BrokenMessageError("no depths of 16 bits")
        return image * 0.001
    encoding, rows, order = _raw_rows(cursor)
    if encoding not in _DEPTHS:
        raise BrokenMessageError(f"encoding {encoding[:20]!r}, expected depths")
    name, unit = _DEPTHS[encoding]
    dtype = np.dtype(f"{order}{name}")
    values = np.ascontiguousarray(rows[:, : WIDTH * dtype.itemsize]).view(dtype)
    return values.astype(np.float64) * unit


def _raw_rows(cursor: Cursor) -> tuple[str, NDArray[np.uint8], str]:
    """Encoding, bytes [480, step] and byte order of an Image."""
    height, width = cursor.numbers("II")
    encoding = cursor.text()
    order = ">" if cursor.number("B") else "<"
    step = cursor.number("I")
    content = cursor.array("u1")
    size = _COLOURS[encoding][0] if encoding in _COLOURS else np.dtype(_DEPTHS.get(encoding, ("f4", 1))[0]).itemsize
    if (height, width) != (HEIGHT, WIDTH) or step < WIDTH * size or len(content) < step * HEIGHT:
        raise BrokenMessageError(f"{height} x {width} pixels, expected {HEIGHT} x {WIDTH}")
    return encoding, content[: step * HEIGHT].reshape(HEIGHT, step), order


def _decoded(content: bytes, how: int) -> NDArray[Any]:
    if not content.startswith((PNG, b"\xff\xd8")):
        raise BrokenMessageError("neither PNG nor JPEG")
    size = picture_size(content)
    if size != (WIDTH, HEIGHT):  # before any memory is taken for it
        raise BrokenMessageError(f"{size or 'no'} pixels, expected {HEIGHT} x {WIDTH}")
    image = decode_picture(content, how)
    if image is None:
        raise BrokenMessageError("cut short or damaged")
    return image
