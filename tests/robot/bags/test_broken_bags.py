"""Bags that are cut short, damaged or made to do harm: one line, or what is left of them."""

import bz2
import shutil
import sqlite3
import struct
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from made_bags import drive, make_bag, scan

from moteslam import open_recording
from moteslam.errors import InputError, MoteslamError
from moteslam.robot.formats.bags import bag, storage

FILES = {"bag": "x.bag", "bz2": "x.bag", "lz4": "x.bag", "mcap": "x.mcap", "zstd": "x.mcap", "db3": "x.db3"}


@pytest.fixture(scope="module")
def contents(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The bytes of a bag of each kind."""
    return {kind: make_bag(tmp_path_factory.mktemp(kind), drive(8), kind).read_bytes() for kind in FILES}


def read_all(path: Path) -> None:
    """Open a recording and read all of its scans: it is refused in one line, or read."""
    message = ""
    try:
        lidar = open_recording(path).lidar
        if lidar is not None:
            lidar.ranges[:]
    except MoteslamError as error:
        message = str(error)
    assert "\n" not in message
    assert len(message) < 700


@pytest.mark.parametrize("kind", FILES)
@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0, 1, allow_subnormal=False))
def test_bags_that_are_cut_short_end_in_one_line(
    tmp_path: Path, contents: dict[str, bytes], kind: str, share: float
) -> None:
    path = tmp_path / FILES[kind]
    path.write_bytes(contents[kind][: int(share * len(contents[kind]))])
    read_all(path)


def without_index(content: bytes) -> bytes:
    """A ROS 1 bag as it is while it is recorded."""
    at = content.index(b"index_pos=") + len(b"index_pos=")
    (end,) = struct.unpack_from("<Q", content, at)
    return content[:at] + bytes(8) + content[at + 8 : end]


def in_a_chunk(content: bytes) -> bytes:
    """A ROS 1 bag whose recorder was killed amidst its last chunk: sizes of 0, and a message that is cut."""
    content = without_index(content)
    header = content.rindex(struct.pack("<I", 41), 0, content.rindex(b"op=\x05"))  # with op, compression and size
    data, size = header + 45, content.rindex(b"size=", 0, header + 45) + 5
    assert header < size < data
    return content[:size] + bytes(4) + content[size + 4 : data] + bytes(4) + content[data + 4 : -200_000]


@pytest.mark.parametrize(
    ("kind", "change", "scans"),
    [
        ("bag", without_index, 120),
        ("lz4", without_index, 120),
        ("bag", in_a_chunk, 102),
        ("bag", lambda content: content[: -len(content) // 4], 87),
        ("mcap", lambda content: content[: content.rindex(b"serialized_metadata") - 100], 120),
        ("mcap", lambda content: content[: -len(content) // 4], 87),
    ],
)
def test_what_was_not_closed_is_gone_through(
    tmp_path: Path, kind: str, change: Callable[[bytes], bytes], scans: int
) -> None:
    path = tmp_path / "x"
    scans_of_two_chunks = (scan(0.1 * index, np.ones(3000)) for index in range(120))  # 86 of them in the first
    path.write_bytes(change(make_bag(tmp_path, scans_of_two_chunks, kind).read_bytes()))
    recording = open_recording(path)
    assert abs(len(recording.lidar) - scans) <= 2
    assert recording.lidar.ranges[len(recording.lidar) - 1, 0] == 1.0
    assert [issue.code for issue in recording.warnings] == ["damaged-bag", "no-mount"]


def changed(content: bytes, after: bytes, value: bytes) -> bytes:
    at = content.index(after) + len(after)
    return content[:at] + value + content[at + len(value) :]


@pytest.mark.parametrize(
    ("kind", "change", "problem"),
    [
        ("bag", lambda content: content[: len(content) // 8], "cut short|cannot be read|expected"),
        ("db3", lambda content: content[: len(content) // 2], "not a recording known here|cannot be read"),
        (
            "bz2",
            lambda content: changed(content, b"size=", struct.pack("<I", 1000)),
            "1001 bytes or more .* 1000",
        ),
        ("lz4", lambda content: changed(content, b"size=", struct.pack("<I", 2**32 - 1)), "expected 4294967295, fewer"),
        ("bag", lambda content: content.replace(b"V2.0", b"V1.2", 1), "a bag of format 1.2, expected 2.0: .*reindex"),
        ("bag", lambda content: content[:13], "no topics"),
    ],
)
def test_what_cannot_be_read_is_refused(
    tmp_path: Path, contents: dict[str, bytes], kind: str, change: Callable[[bytes], bytes], problem: str
) -> None:
    path = tmp_path / FILES[kind]
    path.write_bytes(change(contents[kind]))
    with pytest.raises(InputError, match=problem):
        np.asarray(open_recording(path).lidar.ranges)


@pytest.mark.parametrize("compression", ["bz2", "lz4", "zstd"])
def test_nothing_unpacks_to_more_than_it_is_allowed(compression: str) -> None:
    import lz4.frame

    packers = {"bz2": bz2.compress, "lz4": lz4.frame.compress, "zstd": storage.zstd.compress}
    assert len(storage.unpack(packers[compression](bytes(50_000_000)), compression, 1001)) == 1001


def test_more_messages_than_any_bag_has_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = make_bag(tmp_path, drive(8))
    monkeypatch.setattr(bag, "MAX_MESSAGES", 20)
    with pytest.raises(InputError, match="more messages than 20"):
        open_recording(path)


@pytest.mark.parametrize("name", ["../other.db3", "/etc/passwd", "link.db3"])
def test_files_outside_the_folder_are_refused(tmp_path: Path, name: str) -> None:
    bag = make_bag(tmp_path, drive(2), "folder")
    shutil.copyfile(bag / "made.db3", tmp_path / "other.db3")
    (bag / "link.db3").symlink_to(tmp_path / "other.db3")
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("- made.db3", f"- {name}", 1))
    with pytest.raises(InputError, match=r"relative_file_paths: .*, expected the name of a file in the folder"):
        open_recording(bag)


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("rosbag2_bagfile_information:", "rosbag2_bagfile_information: [", r"metadata\.yaml: not YAML"),
        ("relative_file_paths:", "files_there:", "relative_file_paths: no list of files"),
    ],
)
def test_metadata_that_is_none_is_refused(tmp_path: Path, old: str, new: str, problem: str) -> None:
    bag = make_bag(tmp_path, drive(2), "folder")
    metadata = bag / "metadata.yaml"
    assert old in metadata.read_text()
    metadata.write_text(metadata.read_text().replace(old, new, 1))
    with pytest.raises(InputError, match=problem):
        open_recording(bag)


def test_computed_columns_of_a_database_are_refused(tmp_path: Path) -> None:
    path = make_bag(tmp_path, drive(2), "db3")
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("ALTER TABLE messages RENAME TO old")
        connection.execute(
            "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
            "data BLOB AS (zeroblob(1000000000)))"
        )
        connection.commit()
    with pytest.raises(InputError, match="expected"):
        open_recording(path)


def test_a_scan_that_lies_about_its_length_is_dropped(tmp_path: Path) -> None:
    path = make_bag(tmp_path, [scan(index, np.ones(50 if index else 51)) for index in range(3)])
    content = path.read_bytes()
    path.write_bytes(content.replace(struct.pack("<If", 51, 1.0), struct.pack("<If", 60, 1.0)))
    recording = open_recording(path)
    assert len(recording.lidar) == 2
    assert "broken-messages" in [issue.code for issue in recording.warnings]


def test_another_definition_of_a_type_is_left_aside(tmp_path: Path) -> None:
    path = make_bag(tmp_path, drive(3))
    path.write_bytes(path.read_bytes().replace(b"6a62c6daae103f4ff57a132d6f95cec2", b"0" * 32))
    recording = open_recording(path)
    assert recording.imu is None
    assert [issue.code for issue in recording.warnings] == ["other-definition"]


@pytest.mark.parametrize(("kind", "header"), [("bag", struct.pack("<I", 38)), ("mcap", b"\x05")])
def test_messages_behind_a_damaged_record_are_left_out(tmp_path: Path, kind: str, header: bytes) -> None:
    path = make_bag(tmp_path, [scan(0.1 * index, np.ones(5)) for index in range(9)], kind)
    content = bytearray(path.read_bytes())
    at = -1
    for _ in range(5):  # the fifth message says that it is longer than its chunk
        at = content.index(b"laser", at + 1)
    size = content.rindex(header, 0, at) + len(header) % 4
    content[size : size + 4] = struct.pack("<I", 900_000)
    path.write_bytes(content)
    recording = open_recording(path)
    assert len(recording.lidar) == 4
    assert recording.warnings[0].code == "damaged-bag"
