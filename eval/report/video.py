"""Films as files: animated GIF and WebP, and MP4 in a format that browsers play."""

from __future__ import annotations

import io
import itertools
import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
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
    path = Path(path)
    kind = path.suffix.lower()
    if kind not in KINDS:
        raise OutputError("no .gif, .webp or .mp4 file, expected one to write", file=path)
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
    write = {".gif": _gif, ".webp": _webp, ".mp4": _mp4}[Path(path).suffix.lower()]
    write_atomically(path, write(frames, fps))


def video_codec() -> str | None:
    """The first of ``CODECS`` that OpenCV encodes and reads back, None where there is none."""
    grey = [np.full((64, 64, 3), shade, np.uint8) for shade in (60, 120, 180)]
    return next((codec for codec in CODECS if _is_readable(_encoded(grey, 15.0, codec), len(grey))), None)


def _gif(frames: Iterable[Frame], fps: float) -> bytes:
    from PIL import Image

    # an octree keeps the colours of thin lines, which a median cut would take for those of their neighbours
    look: dict[str, Any] = {"colors": 128, "method": Image.Quantize.FASTOCTREE, "dither": Image.Dither.NONE}

    def images() -> Iterator[Image.Image]:
        for i, frame in enumerate(frames):
            image = Image.fromarray(frame).quantize(**look)
            ticks = round((i + 1) / fps / GIF_TICK) - round(i / fps / GIF_TICK)
            image.info["duration"] = round(1000 * GIF_TICK * ticks)
            yield image

    return _animated("GIF", images(), optimize=False)


def _webp(frames: Iterable[Frame], fps: float) -> bytes:
    from PIL import Image

    return _animated("WEBP", map(Image.fromarray, frames), duration=1000 / fps, quality=WEBP_QUALITY)


def _animated(kind: str, images: Iterator[Any], **look: Any) -> bytes:
    """Images that repeat for ever, in one of Pillow's formats."""
    content = io.BytesIO()
    next(images).save(content, kind, save_all=True, append_images=images, loop=0, **look)
    return content.getvalue()


def _mp4(frames: Iterable[Frame], fps: float) -> bytes:
    codec = video_codec()
    assert codec is not None  # check_film
    return _encoded(frames, fps, codec)


def _encoded(frames: Iterable[Frame], fps: float, codec: str) -> bytes:
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
        for frame in itertools.chain((first,), frames):
            writer.write(np.ascontiguousarray(frame[:height, :width, ::-1]))
        writer.release()
        return file.read_bytes()


def _is_readable(film: bytes, frames: int) -> bool:
    """Whether an MP4 has this number of frames."""
    import cv2

    if not film:
        return False
    with tempfile.TemporaryDirectory(prefix="moteslam-") as folder:
        file = Path(folder) / "film.mp4"
        file.write_bytes(film)
        with _stderr_discarded():
            reader = cv2.VideoCapture(str(file))
            found = sum(1 for _ in iter(lambda: reader.read()[0], False))
        reader.release()
        return found == frames


@contextmanager
def _stderr_discarded() -> Iterator[None]:
    """Send what libraries write to stderr nowhere: FFmpeg reports every encoder that is missing."""
    try:
        kept = os.dup(2)
    except OSError:  # closed
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
