"""Films as files: animated GIF and WebP, and MP4 in a format that browsers play."""

from __future__ import annotations

import io
import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import chain
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import OutputError
from moteslam.robot.files import write_atomically

KINDS = (".gif", ".webp", ".mp4")
CODECS = {"avc1": "H.264", "vp09": "VP9", "av01": "AV1"}
"""What browsers play in an MP4, by four-letter code, in the order in which they are tried. Most builds of OpenCV lack
an encoder for H.264, which players outside browsers know best."""
WEBP_QUALITY = 80
GIF_TICK = 0.01
"""Frames of a GIF last whole multiples of this [s]."""

Frame = NDArray[np.uint8]


def check_film(path: str | PathLike[str]) -> None:
    """Check that a film of this name can be written, before it is made.

    Raises:
        OutputError: another ending than those of ``KINDS``, or no encoder for it.
    """
    kind = Path(path).suffix.lower()
    if kind not in KINDS:
        raise OutputError("expected a name that ends in .gif, .webp or .mp4", file=path)
    if kind == ".webp":
        from PIL import features

        if not features.check("webp"):
            raise OutputError("Pillow here writes no WebP, expected .gif or .mp4", file=path)
    if kind == ".mp4" and video_codec() is None:
        known = ", ".join(CODECS.values())
        raise OutputError(f"OpenCV here has no encoder that browsers play ({known}), expected .webp or .gif", file=path)


def write_film(path: str | PathLike[str], frames: Iterable[Frame], *, fps: float = 15.0) -> None:
    """Write frames as a GIF, WebP or MP4, by the name's ending.

    Args:
        path: of the film.
        frames: [height, width, 3] red, green, blue, all of one size, one at least. They are encoded as they come.
        fps: frames a second.

    Raises:
        OutputError: see :func:`check_film`, or it cannot be written.
    """
    check_film(path)
    kind = Path(path).suffix.lower()
    content = _mp4(frames, fps, video_codec() or "") if kind == ".mp4" else _animated(kind, frames, fps)
    write_atomically(path, content)


def _animated(kind: str, frames: Iterable[Frame], fps: float) -> bytes:
    """A GIF or WebP that repeats for ever."""
    from PIL import Image

    # an octree keeps the colours of thin lines, which a median cut would take for those of their neighbours
    colours: dict[str, Any] = {"colors": 128, "method": Image.Quantize.FASTOCTREE, "dither": Image.Dither.NONE}

    def quantised() -> Iterator[Image.Image]:
        for i, frame in enumerate(frames):
            image = Image.fromarray(frame).quantize(**colours)
            ticks = round((i + 1) / fps / GIF_TICK) - round(i / fps / GIF_TICK)
            image.info["duration"] = round(1000 * GIF_TICK * ticks)
            yield image

    images: Iterator[Image.Image] = quantised() if kind == ".gif" else map(Image.fromarray, frames)
    look = {"optimize": False} if kind == ".gif" else {"duration": 1000 / fps, "quality": WEBP_QUALITY}
    content = io.BytesIO()
    next(images).save(content, kind[1:], save_all=True, append_images=images, loop=0, **look)
    return content.getvalue()


def video_codec() -> str | None:
    """The first of ``CODECS`` that OpenCV encodes and reads back; None if it does with none of them."""
    import cv2

    grey = [np.full((64, 64, 3), shade, np.uint8) for shade in (60, 120, 180)]
    for codec in CODECS:
        with tempfile.TemporaryDirectory(prefix="moteslam-") as folder, _stderr_discarded():
            file = Path(folder) / "film.mp4"
            file.write_bytes(_mp4(grey, 15.0, codec))
            reader = cv2.VideoCapture(str(file))
            readable = all(reader.read()[0] for _ in grey)
            reader.release()
        if readable:
            return codec
    return None


def _mp4(frames: Iterable[Frame], fps: float, codec: str) -> bytes:
    """An MP4; empty where OpenCV lacks the encoder."""
    import cv2

    frames = iter(frames)
    first = next(frames)
    height, width = (size - size % 2 for size in first.shape[:2])  # of 4:2:0 colours: two by two pixels share one
    with tempfile.TemporaryDirectory(prefix="moteslam-") as folder:
        file = Path(folder) / "film.mp4"
        with _stderr_discarded():
            writer = cv2.VideoWriter(str(file), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*codec), fps, (width, height))
        if not writer.isOpened():
            return b""
        for frame in chain((first,), frames):
            writer.write(np.ascontiguousarray(frame[:height, :width, ::-1]))
        writer.release()
        return file.read_bytes()


@contextmanager
def _stderr_discarded() -> Iterator[None]:
    """Send what libraries write to stderr nowhere: FFmpeg reports every encoder that is missing."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
