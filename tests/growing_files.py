"""Recordings that grow: written piece by piece, and compared with the finished file."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from moteslam.robot.formats import Follower
from moteslam.robot.recording import Recording

STREAMS = ("lidar", "encoders", "odometry", "imu")
MAGIC = b"\x89MCAP0\r\n"


def pieces(content: bytes, cuts: list[int]) -> Iterator[bytes]:
    """The content in pieces that end at these places, counted round its length."""
    places = sorted({cut % (len(content) + 1) for cut in cuts} | {len(content)})
    for first, last in zip([0, *places], places, strict=False):
        yield content[first:last]


def growing(path: Path, follower: Follower, parts: Iterator[bytes]) -> Iterator[Recording]:
    """Write the parts to a file, one after the other, and give what the follower has of them, where anything is new."""
    for part in parts:
        with path.open("ab") as file:
            file.write(part)
        recording = follower.poll()
        if recording is not None:
            yield recording


def arrays(recording: Recording) -> dict[str, np.ndarray]:
    """All arrays of the streams, those that stay in a file, too."""
    found = {}
    for name in STREAMS:
        stream = getattr(recording, name)
        for field, value in vars(stream).items() if stream is not None else ():
            if field == "ranges" or isinstance(value, np.ndarray):
                found[f"{name}.{field}"] = np.asarray(value[:])
    return found


def assert_same(one: Recording, other: Recording) -> None:
    """The same in every stream, bit for bit."""
    assert repr(one) == repr(other)
    assert one.platform == other.platform
    assert one.warnings == other.warnings
    of_one, of_other = arrays(one), arrays(other)
    assert of_one.keys() == of_other.keys()
    for name, values in of_one.items():
        np.testing.assert_array_equal(values, of_other[name], err_msg=name)
    if one.lidar is not None:
        figures = ("angle_min", "angle_increment", "range_min", "range_max", "time_increment")
        assert [getattr(one.lidar, name) for name in figures] == [getattr(other.lidar, name) for name in figures]


def assert_begins(one: Recording, other: Recording) -> None:
    """Every stream of one is the beginning of the other's."""
    of_other = arrays(other)
    for name, values in arrays(one).items():
        np.testing.assert_array_equal(values, of_other[name][: len(values)], err_msg=name)


def repacked(content: bytes, messages: int) -> bytes:
    """A plain MCAP file as recorders write it for small delays: chunks of a few messages, or none for 0; no summary.

    It ends behind its last record, as a file does that is still being written.
    """
    written, chunk, count = bytearray(MAGIC), bytearray(), 0
    for kind, body in _records(content[len(MAGIC) :], inside=True):
        record = struct.pack("<BQ", kind, len(body)) + body
        if kind in (0x01, 0x03, 0x04) or not messages:
            written += record
            continue
        chunk += record
        count += 1
        if count == messages:
            written += _chunk(bytes(chunk))
            chunk, count = bytearray(), 0
    return bytes(written + (_chunk(bytes(chunk)) if chunk else b""))


def _records(content: bytes, *, inside: bool) -> Iterator[tuple[int, bytes]]:
    """The header, schemas, channels and messages up to the end of the data, those of chunks, too."""
    at, known = 0, set()
    while at < len(content):
        kind, size = struct.unpack_from("<BQ", content, at)
        body = content[at + 9 : at + 9 + size]
        at += 9 + size
        if kind == 0x0F:
            return
        if kind == 0x06 and inside:
            words = struct.unpack_from("<I", body, 28)[0]
            yield from (record for record in _records(body[40 + words :], inside=False) if record not in known)
        elif kind in (0x01, 0x03, 0x04, 0x05) and (kind == 0x05 or (kind, body) not in known):
            known.add((kind, body))
            yield kind, body


def _chunk(content: bytes) -> bytes:
    body = struct.pack("<QQQII", 0, 0, len(content), 0, 0) + struct.pack("<Q", len(content)) + content
    return struct.pack("<BQ", 0x06, len(body)) + body
