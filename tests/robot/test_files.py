"""Files and result folders appear whole or not at all, and replace nothing that is not ours."""

import errno
import io
import os
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np
import pytest
from refusals import refusal

from moteslam.errors import ExistsError, InputError, OutputError
from moteslam.files import (
    MARKER,
    folder_for,
    read_arrays,
    read_text,
    read_yaml,
    result_folder,
    staged_file,
    write_atomically,
)


def names(folder: Path) -> list[str]:
    """What is in a folder, but for the marker."""
    return sorted(path.name for path in folder.iterdir() if path.name != MARKER)


@pytest.mark.parametrize("content", ["ä\n", "ä\n".encode(), lambda file: file.write("ä\n".encode())])
def test_text_bytes_and_writers(tmp_path: Path, content: Any) -> None:
    before = os.umask(0o027)
    try:
        write_atomically(tmp_path / "x", content)
    finally:
        os.umask(before)
    assert (tmp_path / "x").read_bytes() == "ä\n".encode()
    assert (tmp_path / "x").stat().st_mode & 0o777 == 0o640
    assert names(tmp_path) == ["x"]


@pytest.mark.parametrize(
    ("error", "raised"), [(OSError(errno.ENOSPC, "full"), OutputError), (KeyboardInterrupt(), KeyboardInterrupt)]
)
def test_a_write_that_fails_leaves_the_old_file(tmp_path: Path, error: BaseException, raised: type[BaseException]):
    (tmp_path / "x").write_text("old")

    def fails(file: IO[bytes]) -> None:
        file.write(b"half")
        raise error

    with pytest.raises(raised):
        write_atomically(tmp_path / "x", fails)
    assert names(tmp_path) == ["x"]
    assert (tmp_path / "x").read_text() == "old"


def test_what_is_no_file_is_neither_written_nor_read(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").touch()
    os.mkfifo(tmp_path / "pipe")
    for name in ("no/x", "folder", "file/x", "pipe"):
        with refusal(OutputError, file=tmp_path / name):
            write_atomically(tmp_path / name, "x")
    for name in ("no/x", "folder", "pipe", "\0"):
        with refusal(InputError, file=tmp_path / name):
            read_text(tmp_path / name, "a text", limit=10)
    assert names(tmp_path) == ["file", "folder", "pipe"]


@pytest.mark.parametrize("content", [b"eleven long", b"\xff\xfe\xff"])
def test_a_text_is_utf_8_of_a_bounded_size(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x").write_bytes(content)
    with pytest.raises(InputError):
        read_text(tmp_path / "x", "a text", limit=10)


@pytest.mark.parametrize("text", ["a: &a [1]\nb: *a\n", "[" * 5000, "a: b: c"])
def test_yaml_that_unfolds_or_is_none_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "x").write_text(text)
    with pytest.raises(InputError):
        read_yaml(tmp_path / "x", "a table", limit=10_000)


def test_folders_above_a_file_stay_where_it_was_written_alone(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), folder_for(tmp_path / "new" / "newer" / "x"):
        raise KeyboardInterrupt
    assert names(tmp_path) == []
    with folder_for(tmp_path / "new" / "x"):
        (tmp_path / "new" / "x").touch()
    assert names(tmp_path / "new") == ["x"]


def write_map(path: Path, *, force: bool = False, keep: Path | None = None) -> None:
    with staged_file(path, force=force, keep=keep) as file:
        file.touch()
        file.with_suffix(".yaml").touch()


def test_a_staged_file_brings_those_beside_it_and_replaces_none_but_its_own(tmp_path: Path) -> None:
    target = tmp_path / "x.pgm"
    write_map(target)
    write_map(target, force=True)
    assert names(tmp_path) == ["x.pgm", "x.yaml"]
    with pytest.raises(ExistsError):
        write_map(target)
    with pytest.raises(OutputError):
        write_map(target, force=True, keep=target)
    target.unlink()
    with pytest.raises(ExistsError):  # what lies beside it is another's
        write_map(target, force=True)
    assert names(tmp_path) == ["x.yaml"]


def made(folder: Path, *files: str, force: bool = False) -> Path:
    """A result folder with these files."""
    with result_folder(folder, force=force) as work:
        for name in files:
            (work / name).touch()
    return folder


def test_a_result_folder_appears_at_the_end(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "out"
    with result_folder(target) as work:
        (work / "a").write_text("1")
        assert not target.exists()
    assert names(target) == ["a"]
    assert names(target.parent) == ["out"]
    assert (target / MARKER).read_text() == "made by moteslam\na\n"
    made(target, "new", force=True)
    assert names(target) == ["new"]
    assert names(target.parent) == ["out"]


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "full"), KeyboardInterrupt()])
@pytest.mark.parametrize("force", [False, True])
def test_a_result_that_fails_leaves_what_there_was(tmp_path: Path, error: BaseException, force: bool) -> None:
    if force:
        made(tmp_path / "out", "old")
    with pytest.raises((OutputError, KeyboardInterrupt)), result_folder(tmp_path / "out", force=force):
        raise error
    assert names(tmp_path) == (["out"] if force else [])
    assert not force or names(tmp_path / "out") == ["old"]


def file(path: Path) -> None:
    path.touch()


def link(path: Path) -> None:
    path.symlink_to(path.parent)


def folder_with(marker: str | None) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        path.mkdir()
        (path / "notes.txt").write_text("months of work")
        if marker is not None:
            (path / MARKER).write_text(marker)

    return make


@pytest.mark.parametrize(
    "there", [file, link, *map(folder_with, (None, "", "made by moteslam\nmap.png\n", "by hand\nnotes.txt\n"))]
)
def test_what_moteslam_did_not_write_is_never_replaced(tmp_path: Path, there: Callable[[Path], None]) -> None:
    there(tmp_path / "thesis")
    for force, error in ((False, ExistsError), (True, OutputError)):
        with refusal(error, file=tmp_path / "thesis"):
            made(tmp_path / "thesis", "new", force=force)
        assert not (tmp_path / "thesis" / "new").exists()


def test_what_is_put_into_the_folder_in_the_meantime_is_kept(tmp_path: Path) -> None:
    target = made(tmp_path / "out", "old")
    with pytest.raises(OutputError), result_folder(target, force=True):
        (target / "notes.txt").touch()
    assert names(target) == ["notes.txt", "old"]


def test_forcing_never_deletes_the_input_or_the_current_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder = made(tmp_path / "recording", "robot.log")
    for keep in (folder, folder / "robot.log"):
        with pytest.raises(OutputError), result_folder(folder, force=True, keep=keep):
            pass
    monkeypatch.chdir(folder)
    for target in (folder, tmp_path, Path()):
        with pytest.raises(OutputError), result_folder(target, force=True):
            pass
    assert names(folder) == ["robot.log"]


SHAPES = {"time_stamps": ("n",), "counts": (4, "n")}


def npy_header(shape: tuple[int, ...], dtype: str = "<f8") -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"shape": shape, "fortran_order": False, "descr": dtype})
    return stream.getvalue()


def zipped(path: Path, **members: bytes) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(f"{name}.npy", data)
    return path


def test_reads_what_is_there_in_either_order_and_leaves_the_rest(tmp_path: Path) -> None:
    counts = np.arange(20, dtype=">i2").reshape(4, 5)
    path = tmp_path / "x.npz"
    np.savez_compressed(path, time_stamps=np.arange(5.0), counts=np.asfortranarray(counts), other=np.array([None]))
    arrays = read_arrays(path, SHAPES)
    assert list(arrays) == ["time_stamps", "counts"]
    np.testing.assert_array_equal(arrays["counts"], counts)


@pytest.mark.parametrize("keep", [0, 30, 0.5, -1])
def test_a_truncated_file_is_refused(tmp_path: Path, keep: float) -> None:
    np.savez(tmp_path / "x.npz", time_stamps=np.arange(50.0), counts=np.ones((4, 50), np.int16))
    data = (tmp_path / "x.npz").read_bytes()
    cut = tmp_path / "Encoders1.npz"
    cut.write_bytes(data[: int(keep * len(data)) if isinstance(keep, float) else keep])
    with refusal(InputError, file=cut):
        read_arrays(cut, SHAPES)


@pytest.mark.parametrize(
    "counts",
    [
        np.ones((4, 6)),
        np.ones((4, 0)),
        np.ones((4, 5), complex),
        np.full((4, 5), "a"),
        None,
    ],
)
def test_wrong_shapes_and_dtypes_are_refused(tmp_path: Path, counts: np.ndarray | None) -> None:
    arrays = {"time_stamps": np.arange(5.0), **({} if counts is None else {"counts": counts})}
    np.savez(tmp_path / "x.npz", **arrays)
    with refusal(InputError, "expected", field="counts"):
        read_arrays(tmp_path / "x.npz", SHAPES)


def test_pickles_are_never_loaded(tmp_path: Path) -> None:
    class Bomb:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return (Path(tmp_path / "loaded").write_text, ("x",))

    np.savez(tmp_path / "x.npz", time_stamps=np.array([Bomb()]), counts=np.ones((4, 1)))
    with pytest.raises(InputError, match="time_stamps: "):
        read_arrays(tmp_path / "x.npz", SHAPES)
    assert not (tmp_path / "loaded").exists()


@pytest.mark.parametrize(
    "header",
    [
        npy_header((1 << 40,)),
        npy_header((4,), "<f8").replace(b"(4,)", b"(-4)"),
        b"\x93NUMPY\x02\x00" + struct.pack("<I", 0xFFFFFFF0),
        b"",
    ],
)
def test_a_header_that_lies_is_refused(tmp_path: Path, header: bytes) -> None:
    path = zipped(tmp_path / "x.npz", time_stamps=header + bytes(40))
    with pytest.raises(InputError, match="time_stamps: "):
        read_arrays(path, {"time_stamps": ("n",)})


def test_a_zip_bomb_is_refused_by_its_declared_size(tmp_path: Path) -> None:
    n = 1 << 21
    path = zipped(tmp_path / "x.npz", time_stamps=npy_header((n,)) + bytes(8 * n))
    assert path.stat().st_size < 1 << 16
    with pytest.raises(InputError, match="16777344 bytes of arrays, expected at most 1000000"):
        read_arrays(path, {"time_stamps": ("n",)}, max_bytes=1_000_000)


def test_a_file_that_cannot_be_written_is_named_where_it_was_asked_for(tmp_path: Path):
    out = tmp_path / "out"
    with refusal(OutputError, file=out / "missing" / "map.pgm"), result_folder(out) as work:
        write_atomically(work / "missing" / "map.pgm", b"")
    assert not out.exists()
