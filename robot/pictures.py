"""Pictures in files: their size before anything is unpacked, decoding without the decoder's own messages, encoding."""

from __future__ import annotations

import io
import re
import warnings
from dataclasses import dataclass
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

PNG = b"\x89PNG\r\n\x1a\n"
"""What a PNG begins with."""
FULL = 65535
"""What the largest value of a channel becomes."""

_GAP = rb"(?:[ \t\n\v\f\r]|#[^\n\r]*[\n\r])+"
_NETPBM = re.compile(rb"P[2356]" + 3 * (_GAP + rb"(\d{1,9})"))
_LONGEST_HEADER = 1 << 16


def picture_size(data: bytes) -> tuple[int, int] | None:
    """Width and height that the header of a picture declares; None where the data are no picture known here."""
    if data.startswith(PNG) and len(data) >= 24:
        return int.from_bytes(data[16:20]), int.from_bytes(data[20:24])
    if header := _NETPBM.match(data[:_LONGEST_HEADER]):
        return int(header[1]), int(header[2])
    from PIL import Image, UnidentifiedImageError

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of sizes, which callers check
        try:
            with Image.open(io.BytesIO(data)) as image:
                width, height = image.size
                return width, height
        except (UnidentifiedImageError, Image.DecompressionBombError, OSError, ValueError):
            return None


def decode_picture(data: bytes, how: int) -> NDArray[Any] | None:
    """A picture as OpenCV decodes it with an ``IMREAD_`` flag; None where it is none, cut short or damaged."""
    import cv2

    if data.startswith(PNG):  # on many threads at once: nothing of all the process is touched
        return _decoded(data, how) if _is_complete_png(data) else None
    log = cv2.utils.logging
    level = log.setLogLevel(log.LOG_LEVEL_SILENT)
    try:
        return _decoded(data, how)
    finally:
        log.setLogLevel(level)


def _decoded(data: bytes, how: int) -> NDArray[Any] | None:
    import cv2

    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), how) if data else None
    except cv2.error:
        return None


def _is_complete_png(data: bytes) -> bool:
    """Whether a PNG runs to its end chunk with every checksum right; the decoder would fill in what is missing."""
    at = len(PNG)
    while at + 12 <= len(data):
        end = at + 8 + int.from_bytes(data[at : at + 4])
        if end + 4 > len(data) or crc32(data[at + 4 : end]) != int.from_bytes(data[end : end + 4]):
            return False
        if data[at + 4 : at + 8] == b"IEND":
            return True
        at = end + 4
    return False


def decode_channels(data: bytes) -> NDArray[np.uint16] | None:
    """All channels of a picture as the file has them, with 65535 for the largest value of a channel.

    [H, W, C]: grey, or red, green and blue, or these and opacity; None where the data are no picture, cut short or
    damaged, or hold no whole numbers of up to 16 bits; nor are Netpbm files read whose largest value is neither 255 nor
    65535, since OpenCV does not scale by it.
    """
    import cv2

    header = _NETPBM.match(data[:_LONGEST_HEADER])
    if header is not None and int(header[3]) not in (255, FULL):
        return None
    end = b"\n" if data[:2] in (b"P2", b"P3") else b""  # OpenCV wants it behind the last number of a text
    image = decode_picture(data + end, cv2.IMREAD_UNCHANGED)
    if image is None or image.dtype not in (np.uint8, np.uint16):
        return None
    image = image if image.ndim == 3 else image[:, :, None]
    order = [0, 1, 2, 3] if image.shape[2] == 1 else [2, 1, 0, 3]  # OpenCV has blue first
    image = image[:, :, order[: image.shape[2]]]
    return image if image.dtype == np.uint16 else image * np.uint16(FULL // 255)


def encode_png(image: NDArray[Any], *, fast: bool = False) -> bytes:
    """A PNG of an image.

    Args:
        image: [H, W] grey, [H, W, 3] red, green, blue or [H, W, 4] with opacity; uint8 or uint16.
        fast: predict each pixel from its left neighbour and seek no repeats: of what the encoder offers, twice as fast
            as its default for images of a camera, and smaller.
    """
    import cv2

    options = [
        *(cv2.IMWRITE_PNG_COMPRESSION, 1),
        *(cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY),
        *(cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_SUB),
    ]
    if image.ndim == 3:
        order = cv2.COLOR_RGB2BGR if image.shape[2] == 3 else cv2.COLOR_RGBA2BGRA
        image = cv2.cvtColor(np.ascontiguousarray(image), order)
    return bytes(cv2.imencode(".png", np.ascontiguousarray(image), options if fast else [])[1].data)


@dataclass(frozen=True)
class PictureStyle:
    """The look of the project's pictures.

    In a picture of one's own: ``with matplotlib.rc_context(moteslam.PictureStyle().rc_params()): ...``

    Attributes:
        slam: colour of SLAM's paths; all four are from the palette of Okabe and Ito, made for colour-blind readers.
        truth: colour of the truth.
        dead_reckoning: colour of dead reckoning.
        particle: colour of particles.
        map_free, map_unknown, map_occupied: greys of the map, 0 black to 1 white.
        font_size: of all text [pt]; a figure's title is 1 pt larger.
        dpi: pixels an inch.
    """

    slam: str = "#0072B2"
    truth: str = "#009E73"
    dead_reckoning: str = "#D55E00"
    particle: str = "#56B4E9"
    map_free: float = 1.0
    map_unknown: float = 0.88
    map_occupied: float = 0.15
    font_size: float = 9.0
    dpi: float = 150.0

    def rc_params(self) -> dict[Any, Any]:  # Matplotlib's stubs list its 300 keys as literals
        """The style as settings of Matplotlib, over its defaults: white, no frames, lines in the colours above."""
        colours = [self.slam, self.truth, self.dead_reckoning, self.particle]
        return {
            "font.size": self.font_size,
            "axes.titlesize": self.font_size,
            "figure.titlesize": self.font_size + 1,
            "axes.grid": False,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "axes.prop_cycle": f"cycler('color', {colours})",
            "legend.frameon": False,
            "lines.solid_capstyle": "round",
            "figure.dpi": self.dpi,
            "savefig.dpi": self.dpi,
            "savefig.facecolor": "white",
        }


STYLE = PictureStyle()
"""Of every picture that is written."""
