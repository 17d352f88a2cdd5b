"""Pictures out of files: decoded, or not, without a word of the decoder's own on stderr."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.formats.ucsd_rgbd import is_whole_png

_PNG = b"\x89PNG\r\n\x1a\n"


def decode_picture(data: bytes, how: int) -> NDArray[Any] | None:
    """A picture as OpenCV decodes it, or None where it is none, cut short or damaged.

    Args:
        data: the file.
        how: one of OpenCV's ``IMREAD_`` flags.
    """
    import cv2

    if not data or (data.startswith(_PNG) and not is_whole_png(data)):
        return None
    log = cv2.utils.logging
    level = log.setLogLevel(log.LOG_LEVEL_SILENT)
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), how)
    except cv2.error:
        return None
    finally:
        log.setLogLevel(level)
