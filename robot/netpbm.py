"""Netpbm pictures, greys (PGM) and colours (PPM), as text (P2, P3) or bytes (P5, P6): the numbers as the file has them.

Source: pgm(5) and ppm(5) of Netpbm. A header of words with comments (``#`` to the end of the line) gives width, height
and the largest value; numbers above 255 take two bytes, the higher first. OpenCV does not scale by the largest value.
"""

from __future__ import annotations

import re
import warnings

import numpy as np
from numpy.typing import NDArray

CHANNELS = {b"P2": 1, b"P3": 3, b"P5": 1, b"P6": 3}
"""By the first two bytes."""
FULL = 65535
"""What the largest value of a file becomes."""

_GAP = rb"(?:[ \t\n\v\f\r]|#[^\n\r]*[\n\r])"
_HEADER = re.compile(rb"P[2356]" + 3 * (_GAP + rb"+(\d{1,9})") + rb"(?:#[^\n\r]*[\n\r]|[ \t\n\v\f\r])")
_LONGEST_HEADER = 1 << 16


def netpbm_size(data: bytes) -> tuple[int, int] | None:
    """Width and height of a picture; None where the data are none of these."""
    header = _HEADER.match(data[:_LONGEST_HEADER])
    return None if header is None else (int(header[1]), int(header[2]))


def decode_netpbm(data: bytes) -> NDArray[np.uint16] | None:
    """The values of a picture, scaled so that the largest that the file may have becomes 65535.

    Nothing is allocated for more numbers than the data can hold.

    Returns:
        [H, W, C] with one channel or red, green and blue; None where the data are none of these, or cut short.
    """
    header = _HEADER.match(data[:_LONGEST_HEADER])
    if header is None:
        return None
    columns, rows, largest = (int(number) for number in header.groups())
    plain, channels = data[:2] in (b"P2", b"P3"), CHANNELS[data[:2]]
    count, size = columns * rows * channels, 2 if largest > 255 else 1
    if not (count and 0 < largest <= FULL) or len(data) - header.end() < (2 * count - 1 if plain else count * size):
        return None
    if plain:
        body = re.sub(rb"#[^\n\r]*", b"", data[header.end() :])
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)  # of what is no number
            try:
                values = np.fromstring(body.decode("latin-1"), np.float64, count=count, sep=" ")
            except (DeprecationWarning, ValueError):
                return None
        if len(values) < count or not ((values >= 0) & (values < 1e9) & (values == np.floor(values))).all():
            return None
    else:
        values = np.frombuffer(data, ">u2" if size == 2 else np.uint8, count, header.end()).astype(np.float64)
    scaled = np.floor((2 * np.minimum(values, largest) * FULL + largest) / (2 * largest))  # to the nearest
    return np.asarray(scaled, np.uint16).reshape(rows, columns, channels)
