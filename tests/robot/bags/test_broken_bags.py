"""Bags that are cut short, damaged or made to do harm: one line, or what is left of them."""

from __future__ import annotations

import bz2
import sqlite3
import struct
from contextlib import closing
from pathlib import Path

import made_bags
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from made_bags import drive, make_bag, scan
from parts.mutations import mutated

from moteslam import open_recording
from moteslam.errors import InputError, MoteslamError
from moteslam.robot.formats.bags import container
from moteslam.robot.formats.bags.bag import Bag

FILES = {
    "bag": "made.bag",
    "bz2": "made.bag",
    "lz4": "made.bag",
    "mcap": "made.mcap",
    "zstd": "made.mcap",
    "db3": "made.db3",
}


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
def test_damaged_bytes_end_in_one_line(tmp_path: Path, contents: dict[str, bytes], kind: str) -> None:
    path = tmp_path / FILES[kind]
    for seed in range(60):
        path.write_bytes(mutated(contents[kind], np.random.default_rng(seed)))
        read_all(path)


@pytest.mark.parametrize("kind", FILES)
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0, 1, allow_subnormal=False))
def test_bags_that_are_cut_short_end_in_one_line(
    tmp_path: Path, contents: dict[str, bytes], kind: str, share: float
) -> None:
    path = tmp_path / FILES[kind]
    path.write_bytes(contents[kind][: int(share * len(contents[kind]))])
    read_all(path)


@pytest.mark.parametrize(
    ("kind", "keep", "problem"),
    [
        ("bag", 0.3, r"made\.bag: cut short: its index is at byte"),
        ("bag", 0.99, r"made\.bag: cut short or damaged at byte"),
        ("lz4", 0.5, r"made\.bag: cut short: its index is at byte"),
        ("db3", 0.5, r"made\.db3: "),
    ],
)
def test_what_is_missing_is_named(
    tmp_path: Path, contents: dict[str, bytes], kind: str, keep: float, problem: str
) -> None:
    path = tmp_path / FILES[kind]
    path.write_bytes(contents[kind][: int(keep * len(contents[kind]))])
    with pytest.raises(InputError, match=problem):
        open_recording(path)


def test_an_mcap_file_without_summary_is_gone_through(tmp_path: Path, contents: dict[str, bytes]) -> None:
    path = tmp_path / "made.mcap"
    whole = contents["mcap"]
    path.write_bytes(whole[: whole.rindex(b"serialized_metadata") - 100])
    recording = open_recording(path)
    assert recording.lidar is not None
    assert len(recording.lidar) == 8
    assert recording.lidar.ranges[7, 0] == np.float32(1.07)
    assert [issue.code for issue in recording.warnings] == ["damaged-bag"]
    assert "made.mcap: it was not closed; what came before is used" in recording.warnings[0].message


def test_a_bag_that_was_not_closed_is_refused_with_a_way_out(tmp_path: Path, contents: dict[str, bytes]) -> None:
    content = bytearray(contents["bag"])
    at = content.index(b"index_pos=") + len(b"index_pos=")
    content[at : at + 8] = bytes(8)
    path = tmp_path / "x.bag"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"was not closed and has no index, expected one: rosbag reindex makes it"):
        open_recording(path)


def test_a_chunk_that_unpacks_to_more_than_it_declares_is_refused(tmp_path: Path, contents: dict[str, bytes]) -> None:
    content = bytearray(contents["bz2"])
    at = content.index(b"size=") + len(b"size=")
    content[at : at + 4] = struct.pack("<I", 1000)
    path = tmp_path / "x.bag"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"chunk at byte \d+ unpacks to more, expected 1000 bytes"):
        open_recording(path)


@pytest.mark.parametrize(("kind", "field"), [("bag", b"size="), ("lz4", b"size=")])
def test_a_chunk_that_declares_too_much_is_refused(
    tmp_path: Path, contents: dict[str, bytes], kind: str, field: bytes
) -> None:
    content = bytearray(contents[kind])
    at = content.index(field) + len(field)
    content[at : at + 4] = struct.pack("<I", 2**32 - 1)
    path = tmp_path / "x.bag"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"chunk of 4294967295 bytes unpacked, expected at most 268435456"):
        open_recording(path)


@pytest.mark.parametrize("compression", ["bz2", "lz4", "zstd"])
def test_nothing_unpacks_to_more_than_it_declares(compression: str) -> None:
    import lz4.frame

    bomb = bytes(50_000_000)
    packed = {"bz2": bz2.compress, "lz4": lz4.frame.compress, "zstd": container.zstd().compress}[compression](bomb)
    chunk = container.StoredChunk(0, len(packed), compression, 1000)
    with pytest.raises(InputError, match="unpacks to more, expected 1000 bytes"):
        container.unpacked(packed, chunk, Path("x"))


def test_more_messages_than_any_bag_has_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = make_bag(tmp_path, drive(8))
    monkeypatch.setattr(container, "MAX_MESSAGES", 20)
    with pytest.raises(InputError, match="over 20 messages, expected fewer"):
        open_recording(path)


def test_a_message_that_is_too_large_is_refused(tmp_path: Path, contents: dict[str, bytes]) -> None:
    path = tmp_path / "x.bag"
    content = bytearray(contents["bag"])
    at = content.index(b"op=\x02")
    header = content.rindex(struct.pack("<I", 4) + b"op=\x02", 0, at + 4) - 4
    (length,) = struct.unpack_from("<I", content, header)
    content[header + 4 + length : header + 8 + length] = struct.pack("<I", 100 << 20)
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"message of 104857600 bytes, expected at most 67108864|no whole message"):
        list(Bag(path).messages(Bag(path).topics[0]))


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("../other.db3", r"relative_file_paths: '\.\./other\.db3' lies outside the folder"),
        ("/etc/passwd", r"relative_file_paths: '/etc/passwd' lies outside the folder"),
        ("nothing.db3", r"relative_file_paths: 'nothing\.db3' is not there"),
        ("link.db3", r"relative_file_paths: 'link\.db3' leads outside the folder"),
    ],
)
def test_files_outside_the_folder_are_refused(tmp_path: Path, name: str, problem: str) -> None:
    folder = make_bag(tmp_path, drive(2), "folder")
    (tmp_path / "other.db3").write_bytes((folder / "made.db3").read_bytes())
    (folder / "link.db3").symlink_to(tmp_path / "other.db3")
    metadata = folder / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("- made.db3", f"- {name}", 1))
    with pytest.raises(InputError, match=problem):
        open_recording(folder)


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        (
            "storage_identifier: sqlite3",
            "storage_identifier: tape",
            r"storage_identifier: 'tape', expected sqlite3 or mcap",
        ),
        ("compression_mode: ''", "compression_mode: file", "compression_mode: files packed as a whole"),
        ("compression_mode: ''", "compression_mode: magic", "compression_mode: magic , expected zstd or none"),
        ("rosbag2_bagfile_information:", "rosbag2_bagfile_information: [", r"metadata\.yaml: not YAML"),
        ("rosbag2_bagfile_information:", "a: rosbag2_bagfile_information\nb:", "missing or no table"),
        ("relative_file_paths:", "files_there:", "relative_file_paths: no list of files"),
    ],
)
def test_metadata_that_is_none_is_refused(tmp_path: Path, old: str, new: str, problem: str) -> None:
    folder = make_bag(tmp_path, drive(2), "folder")
    metadata = folder / "metadata.yaml"
    text = metadata.read_text()
    assert old in text
    metadata.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=problem):
        open_recording(folder)


def test_a_file_that_is_named_twice_is_refused(tmp_path: Path) -> None:
    folder = make_bag(tmp_path, drive(2), "folder")
    metadata = folder / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("- made.db3", "- made.db3\n  - made/made.db3", 1))
    with pytest.raises(InputError, match="relative_file_paths: a file twice, expected each once"):
        open_recording(folder)


def long_bag(folder: Path, kind: str) -> Path:
    """A bag of two chunks."""
    return make_bag(folder, (scan(0.1 * index, np.ones(3000)) for index in range(120)), kind)


def places_of_chunks(content: bytes, kind: str) -> list[int]:
    """Where the index of a bag says where its chunks are."""
    if kind == "bag":
        field = b"chunk_pos="
        return [at + len(field) for at in range(len(content)) if content.startswith(field, at)]
    (at,) = struct.unpack_from("<Q", content, len(content) - 28)
    places = []
    while content[at] != 2:
        if content[at] == 8:
            places.append(at + 9 + 16)
        at += 9 + struct.unpack_from("<Q", content, at + 1)[0]
    return places


@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_chunks_that_overlap_are_refused(tmp_path: Path, kind: str) -> None:
    path = long_bag(tmp_path, kind)
    content = bytearray(path.read_bytes())
    first, second = places_of_chunks(content, kind)
    content[second : second + 8] = content[first : first + 8]
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"chunk at byte \d+ begins within another"):
        open_recording(path)


def test_yaml_makes_no_objects(tmp_path: Path) -> None:
    folder = make_bag(tmp_path, drive(2), "folder")
    metadata = folder / "metadata.yaml"
    metadata.write_text(f"{metadata.read_text()}\nx: !!python/object/apply:os.getcwd []\n")
    with pytest.raises(InputError, match="not YAML: could not determine a constructor"):
        open_recording(folder)


@pytest.mark.parametrize("storage", ["[x]", "{a: 1}", "7", "null"])
def test_a_storage_that_is_no_name_is_refused(tmp_path: Path, storage: str) -> None:
    (tmp_path / "metadata.yaml").write_text(
        f"rosbag2_bagfile_information: {{relative_file_paths: [a.db3], storage_identifier: {storage}, version: 5}}\n"
    )
    with pytest.raises(InputError, match=r"metadata\.yaml: storage_identifier: .*, expected sqlite3 or mcap"):
        open_recording(tmp_path)


def test_computed_columns_of_a_database_are_refused(tmp_path: Path) -> None:
    path = make_bag(tmp_path, drive(2), "db3")
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("ALTER TABLE messages RENAME TO old")
        connection.execute(
            "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
            "data BLOB AS (zeroblob(1000000000)))"
        )
        connection.commit()
    with pytest.raises(InputError, match="part of a ROS 2 bag"):  # not known as a database of its own
        open_recording(path)
    with pytest.raises(InputError, match="table messages has computed columns, expected plain ones"):
        Bag(path)


def test_a_scan_that_lies_about_its_length_is_refused_when_it_is_read(tmp_path: Path) -> None:
    path = make_bag(tmp_path, [scan(0, np.ones(50)), scan(1, np.ones(50))])
    content = path.read_bytes()
    path.write_bytes(content.replace(struct.pack("<I", 50) + np.float32(1.0).tobytes(), struct.pack("<If", 60, 1.0)))
    recording = open_recording(path)
    assert recording.lidar is not None
    with pytest.raises(InputError, match=r"/scan: a scan is broken: cut short"):
        recording.lidar.ranges[:]


def test_another_definition_of_a_type_is_left_aside(tmp_path: Path) -> None:
    path = make_bag(tmp_path, drive(3))
    path.write_bytes(path.read_bytes().replace(b"6a62c6daae103f4ff57a132d6f95cec2", b"0" * 32))
    recording = open_recording(path)
    assert recording.imu is None
    assert [issue.code for issue in recording.warnings] == ["other-definition"]


@pytest.mark.parametrize("kind", made_bags.KINDS)
def test_an_empty_bag_is_refused(tmp_path: Path, kind: str) -> None:
    with pytest.raises(InputError):
        open_recording(make_bag(tmp_path, [], kind))
