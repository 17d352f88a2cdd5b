"""Pictures in files: their size before anything is unpacked, decoding without the decoder's own messages, encoding."""

from __future__ import annotations

import io
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.netpbm import CHANNELS, FULL, decode_netpbm, netpbm_size

PNG = b"\x89PNG\r\n\x1a\n"
"""What a PNG begins with."""


def picture_size(data: bytes) -> tuple[int, int] | None:
    """Width and height that the header of a picture declares; None where the data are no picture known here."""
    if data.startswith(PNG) and len(data) >= 24:
        return int.from_bytes(data[16:20]), int.from_bytes(data[20:24])
    return netpbm_size(data) or _declared_size(data)


def decode_picture(data: bytes, how: int) -> NDArray[Any] | None:
    """A picture as OpenCV decodes it, or None where the data are no picture, cut short or damaged.

    Args:
        data: the file.
        how: one of OpenCV's ``IMREAD_`` flags.
    """
    import cv2

    if data.startswith(PNG):  # on many threads at once: nothing of all the process is touched
        return _decoded(data, how) if _is_complete_png(data) else None
    log = cv2.utils.logging
    level = log.setLogLevel(log.LOG_LEVEL_SILENT)
    try:
        return _decoded(data, how)
    finally:
        log.setLogLevel(level)


def decode_channels(data: bytes) -> NDArray[np.uint16] | None:
    """All channels of a picture as the file has them, with 65535 for the largest value of a channel.

    Returns:
        [H, W, C]: grey, or red, green and blue, or these and opacity; None where the data are no picture, cut short or
        damaged, or hold no whole numbers of up to 16 bits.
    """
    import cv2

    if data[:2] in CHANNELS:
        return decode_netpbm(data)
    image = decode_picture(data, cv2.IMREAD_UNCHANGED)
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


def _decoded(data: bytes, how: int) -> NDArray[Any] | None:
    import cv2

    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), how) if data else None
    except cv2.error:
        return None


def _declared_size(data: bytes) -> tuple[int, int] | None:
    from PIL import Image, UnidentifiedImageError

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of sizes, which callers check
        try:
            with Image.open(io.BytesIO(data)) as image:
                width, height = image.size
                return width, height
        except (UnidentifiedImageError, Image.DecompressionBombError, OSError, ValueError):
            return None


def _is_complete_png(data: bytes) -> bool:
    """Whether a PNG runs to its end chunk with every checksum right; the decoder would fill in what is missing."""
    from zlib import crc32

    at = len(PNG)
    while at + 12 <= len(data):
        length = int.from_bytes(data[at : at + 4])
        end = at + 8 + length
        if end + 4 > len(data) or crc32(data[at + 4 : end]) != int.from_bytes(data[end : end + 4]):
            return False
        if data[at + 4 : at + 8] == b"IEND":
            return True
        at = end + 4
    return False
