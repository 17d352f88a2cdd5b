"""The images of a recording as messages: packed as PNG, each with the CameraInfo of the Kinect, and its frames.

Depths are whole millimetres, as REP 118 has them in 16 bits: nearer than 0.6 m, where a step of the raw disparity is
less than one, a disparity reads back as one of those within a millimetre.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.formats.bags.choice import CAMERA_INFO, COMPRESSED_IMAGE
from moteslam.robot.formats.bags.events import BASE, Event, Values, header, transform
from moteslam.robot.formats.bags.times import nanoseconds
from moteslam.robot.formats.not_written import left_out
from moteslam.robot.formats.ucsd_rgbd import read_disparity, read_rgb
from moteslam.robot.frames import has_images
from moteslam.robot.issues import Issue
from moteslam.robot.kinect import (
    CENTRE,
    FOCAL,
    HEIGHT,
    RGB_CENTRE,
    RGB_FOCAL,
    RGB_OFFSET,
    WIDTH,
    depth_of,
    mount_rotation,
)
from moteslam.robot.pictures import encode_png
from moteslam.robot.recording import Recording, RgbdStream
from moteslam.robot.specs import CameraSpec
from moteslam.robot.wording import counted

RGB, DEPTH = "/camera/rgb", "/camera/depth"
_RGB_FRAME, _DEPTH_FRAME = "camera_rgb_optical_frame", "camera_depth_optical_frame"
_FORMATS = {RGB: "rgb8; png compressed bgr8", DEPTH: "16UC1; png compressed"}
_FARTHEST = 65.535


class ImageEvents:
    """The messages of a recording's images.

    Args:
        recording: with or without images.
    """

    def __init__(self, recording: Recording) -> None:
        self._recording, self._stream, self._name = recording, recording.rgbd, recording.name
        self._missing = 0
        self._has_images = has_images(recording.rgbd)

    def streams(self) -> list[Iterator[Event]]:
        """The messages of the colour and of the depth images, each in the order of time; none without images."""
        stream = self._stream
        if stream is None or not self._has_images:
            return []
        return [
            self._images(stream.rgb_stamps, RGB, _RGB_FRAME, lambda index: _colour(stream, index)),
            self._images(stream.disparity_stamps, DEPTH, _DEPTH_FRAME, lambda index: _depth(stream, index)),
        ]

    def issues(self) -> tuple[Issue, ...]:
        """What was not written, once all the messages were."""
        if self._stream is None:
            return ()
        if not self._has_images:
            count = len(self._stream.rgb_stamps) + len(self._stream.disparity_stamps)
            stamps = counted(count, "stamp") + " of images"
            return (left_out(self._recording, "a bag without the images themselves", stamps, count),)
        text = f"{self._name}: depths are written in millimetres: nearer than 0.6 m disparities may be rounded"
        found = [Issue("depths-rounded", text, len(self._stream.disparity_stamps))]
        if self._missing:
            text = f"{self._name}: {counted(self._missing, 'image')} missing or unreadable: not written"
            found.append(Issue("images-missing", text, self._missing))
        return tuple(found)

    def _images(
        self, stamps: NDArray[np.float64], camera: str, frame: str, image: Callable[[int], NDArray[Any] | None]
    ) -> Iterator[Event]:
        for index, time in enumerate(nanoseconds(stamps).tolist()):
            try:
                pixels = image(index)
            except InputError:
                pixels = None
            if pixels is None:
                self._missing += 1
                continue
            head = header(time, frame)
            yield Event(time, f"{camera}/camera_info", CAMERA_INFO, {"header": head, **_camera_info(camera)})
            content = np.frombuffer(encode_png(pixels, fast=True), np.uint8)
            values = {"header": head, "format": _FORMATS[camera], "data": content}
            yield Event(time, f"{camera}/image_raw/compressed", COMPRESSED_IMAGE, values)


def camera_transforms(time: int, mount: CameraSpec) -> list[Values]:
    """Where the two cameras stand: the depth camera on the robot, the colour camera to the right of it."""
    from scipy.spatial.transform import Rotation

    names = ("x", "y", "z", "w")
    turn = dict(zip(names, Rotation.from_matrix(mount_rotation(mount)).as_quat().tolist(), strict=True))
    none = dict(zip(names, (0.0, 0.0, 0.0, 1.0), strict=True))
    return [
        transform(time, BASE, _DEPTH_FRAME, (mount.x, mount.y, mount.z), turn),
        transform(time, _DEPTH_FRAME, _RGB_FRAME, (RGB_OFFSET, 0.0, 0.0), none),
    ]


def _colour(stream: RgbdStream, index: int) -> NDArray[np.uint8] | None:
    if stream.images is not None:
        return stream.images.rgb(index)
    path = stream.rgb_files[index]
    return None if path is None else read_rgb(path)


def _depth(stream: RgbdStream, index: int) -> NDArray[np.uint16] | None:
    """Depths [480, 640] in millimetres, 0 where nothing was seen."""
    if stream.images is not None:
        disparity = stream.images.disparity(index)
    else:
        path = stream.disparity_files[index]
        if path is None:
            return None
        disparity = read_disparity(path)
    depth = depth_of(disparity)
    millimetres: NDArray[np.uint16] = np.rint(1000 * np.where(depth <= _FARTHEST, depth, 0.0)).astype(np.uint16)
    return millimetres


def _camera_info(camera: str) -> Values:
    """A pinhole camera without distortion; its matrices by the names of ROS 1 and of ROS 2."""
    focal, (column, row) = (RGB_FOCAL, RGB_CENTRE) if camera == RGB else (FOCAL, CENTRE)
    matrix = np.array((focal, 0, column, 0, focal, row, 0, 0, 1))
    straight = np.eye(3).ravel()
    projection = np.array((focal, 0, column, 0, 0, focal, row, 0, 0, 0, 1, 0))
    matrices = {"d": np.zeros(5), "k": matrix, "r": straight, "p": projection}
    region = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
    return {
        "height": HEIGHT,
        "width": WIDTH,
        "distortion_model": "plumb_bob",
        **matrices,
        **{name.upper(): value for name, value in matrices.items()},
        "binning_x": 0,
        "binning_y": 0,
        "roi": region,
    }
