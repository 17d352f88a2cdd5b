"""Images of an RGB-D camera as they come: the latest ones, and a file of those that the floor is coloured by."""

from __future__ import annotations

import os
import weakref
from collections import deque
from tempfile import TemporaryFile
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.robot.raster import encode_png
from moteslam.robot.recording import Images, RgbdStream, nearest_stamp
from moteslam.robot.rgbd import HEIGHT, WIDTH, FrameChoice, decode_disparity, decode_rgb, disparity_of

BEHIND = 1.0  # Images are kept for so much longer than a scan waits [s]: a filter asks for frames from before a scan
RGB, DISPARITY = "rgb", "disparity"


class LiveCamera:
    """Takes in images; what is held in memory does not grow with their number.

    Args:
        interval, largest_gap: of the frames that colour the floor [s]: see `FrameChoice`.
        kept: how long images are kept in memory [s].
    """

    def __init__(self, interval: float, largest_gap: float, kept: float) -> None:
        self._choice, self._kept = FrameChoice(interval, largest_gap), kept
        self._latest: dict[str, deque[tuple[float, NDArray[Any]]]] = {RGB: deque(), DISPARITY: deque()}
        self._undecided = 0  # of the latest disparity images: their colours may be still to come
        self._newest = -np.inf
        self._file = TemporaryFile(buffering=0)  # noqa: SIM115 - it goes with this object
        weakref.finalize(self, self._file.close)
        self._places: dict[str, list[tuple[float, int, int]]] = {RGB: [], DISPARITY: []}  # stamp, offset, bytes

    def add(self, kind: str, stamp: float, image: NDArray[Any]) -> None:
        """Take in an image of a kind."""
        self._latest[kind].append((stamp, image))
        self._undecided += kind == DISPARITY
        self._newest = max(self._newest, stamp)
        self.decide(self._newest - self._kept)
        for images in self._latest.values():
            while images and images[0][0] < self._newest - self._kept:
                images.popleft()

    @property
    def latest(self) -> RgbdStream:
        """The images that are in memory."""
        rgb, disparity = (list(self._latest[kind]) for kind in (RGB, DISPARITY))
        colours, shown = (np.array([stamp for stamp, _ in images]) for images in (rgb, disparity))
        return RgbdStream(colours, shown, images=Images(lambda k: rgb[k][1], lambda k: disparity[k][1]))

    def used(self) -> RgbdStream:
        """The frames that the floor is coloured by, as far as they are chosen."""
        colours, shown = (np.array([stamp for stamp, _, _ in self._places[kind]]) for kind in (RGB, DISPARITY))
        read = Images(lambda k: decode_rgb(self._read(RGB, k)), lambda k: decode_disparity(self._read(DISPARITY, k)))
        return RgbdStream(colours, shown, images=read)

    def decide(self, waited: float) -> None:
        """Choose among the disparity images whose colours have come, or that are older than a stamp [s]."""
        colours = self._latest[RGB]
        while self._undecided:
            stamp, image = self._latest[DISPARITY][-self._undecided]
            if not (colours and colours[-1][0] >= stamp) and stamp >= waited:
                return
            self._undecided -= 1
            stamps = np.array([each for each, _ in colours])
            shown, colour = colours[int(nearest_stamp(stamps, np.array([stamp]))[0])] if colours else (np.inf, image)
            if self._choice.takes(stamp, shown):
                self._write(RGB, shown, colour)
                self._write(DISPARITY, stamp, image)

    def _write(self, kind: str, stamp: float, image: NDArray[Any]) -> None:
        content = encode_png(image, fast=True)
        self._places[kind].append((stamp, self._file.seek(0, os.SEEK_END), len(content)))
        self._file.write(content)

    def _read(self, kind: str, index: int) -> bytes:
        _, offset, size = self._places[kind][index]
        return os.pread(self._file.fileno(), size, offset)  # of several threads at once


def checked_image(image: ArrayLike) -> tuple[str, NDArray[Any]]:
    """The kind of an image and a copy of it, depths [m] as disparities."""
    given = np.array(image)
    if given.shape == (HEIGHT, WIDTH, 3) and given.dtype == np.uint8:
        return RGB, given
    if given.shape == (HEIGHT, WIDTH) and (given.dtype == np.uint16 or given.dtype.kind == "f"):
        return DISPARITY, given if given.dtype == np.uint16 else disparity_of(given)
    expected = f"[{HEIGHT}, {WIDTH}, 3] uint8 colours, or [{HEIGHT}, {WIDTH}] uint16 disparities or depths in m"
    raise InputError(f"{given.dtype} {list(given.shape)}, expected {expected}", field="image")
