"""Netpbm pictures, greys (PGM) and colours (PPM), as text (P2, P3) or bytes (P5, P6): the numbers as the file has them.

Source: pgm(5) and ppm(5) of Netpbm. A header of words with comments (``#`` to the end of the line) gives width, height
and the largest value; numbers above 255 take two bytes, the higher first. Decoders scale to 8 bits, and differ in how.
"""

from __future__ import annotations

import re
from array import array

import numpy as np
from numpy.typing import NDArray

CHANNELS = {b"P2": 1, b"P3": 3, b"P5": 1, b"P6": 3}
"""By the first two bytes."""
PLAIN = (b"P2", b"P3")
FULL = 65535
"""What the largest value of a file becomes."""

_GAP = rb"(?:[ \t\n\v\f\r]|#[^\n\r]*[\n\r])"
_HEADER = re.compile(rb"P[2356]" + 3 * (_GAP + rb"+(\d{1,9})") + rb"(?:#[^\n\r]*[\n\r]|[ \t\n\v\f\r])")
_LONGEST_HEADER = 1 << 16
_CHUNK = 1 << 20
"""Characters of a plain file that are taken apart at once."""


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
    channels = CHANNELS[data[:2]]
    count = columns * rows * channels
    if not (count and 0 < largest <= FULL):
        return None
    body = memoryview(data)[header.end() :]
    values = _plain(bytes(body), count) if data[:2] in PLAIN else _raw(body, count, wide=largest > 255)
    if values is None:
        return None
    scaled = (2 * np.minimum(values, largest).astype(np.uint64) * FULL + largest) // (2 * largest)  # to the nearest
    return np.asarray(scaled, np.uint16).reshape(rows, columns, channels)


def _raw(body: memoryview, count: int, *, wide: bool) -> NDArray[np.unsignedinteger] | None:
    """The first numbers of one byte, or of two."""
    if len(body) < count * (2 if wide else 1):
        return None
    return np.frombuffer(body, ">u2" if wide else np.uint8, count)


def _plain(body: bytes, count: int) -> NDArray[np.unsignedinteger] | None:
    """The first numbers of a text."""
    if len(body) < 2 * count - 1:
        return None
    values = array("Q")
    body, at = re.sub(rb"#[^\n\r]*", b"", body), 0
    while at < len(body) and len(values) < count:
        end = at + _CHUNK
        words = body[at:end].split()
        if end < len(body) and words and not body[end - 1 : end].isspace() and not body[end : end + 1].isspace():
            end -= len(words.pop())  # cut through a number
            if end <= at:
                return None
        if not all(word.isdigit() and len(word) <= 9 for word in words):
            return None
        values.extend(map(int, words))
        at = end
    return np.array(values[:count], np.uint64) if len(values) >= count else None
