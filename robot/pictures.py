"""Pictures out of files: decoded, or not, without a word of the decoder's own on stderr."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

PNG = b"\x89PNG\r\n\x1a\n"
"""What a PNG begins with."""


def decode_picture(data: bytes, how: int) -> NDArray[Any] | None:
    """A picture as OpenCV decodes it, or None where it is none, cut short or damaged.

    Args:
        data: the file.
        how: one of OpenCV's ``IMREAD_`` flags.
    """
    import cv2

    if data.startswith(PNG):  # on many threads at once: nothing of all the process is touched
        return _decoded(data, how) if _is_whole_png(data) else None
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


def _is_whole_png(data: bytes) -> bool:
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
