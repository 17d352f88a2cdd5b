"""Arrays from files that lie, are cut, or hold what they should not."""

from __future__ import annotations

import io
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest

from moteslam.errors import InputError
from moteslam.robot.files import read_arrays

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


def good(path: Path, n: int = 5) -> Path:
    np.savez(path, time_stamps=np.arange(n, dtype=float), counts=np.ones((4, n), np.int16))
    return path


def test_reads_what_is_there_in_either_order_and_leaves_the_rest(tmp_path: Path) -> None:
    counts = np.arange(20, dtype=">i2").reshape(4, 5)
    path = tmp_path / "x.npz"
    np.savez_compressed(path, time_stamps=np.arange(5.0), counts=np.asfortranarray(counts), other=np.array([None]))
    arrays = read_arrays(path, SHAPES)
    assert list(arrays) == ["time_stamps", "counts"]
    np.testing.assert_array_equal(arrays["counts"], counts)


@pytest.mark.parametrize("value", [2.5, [2.5], [[2.5]]])
def test_one_number_may_come_in_any_dimension(tmp_path: Path, value: object) -> None:
    np.savez(tmp_path / "x.npz", a=np.array(value))
    assert read_arrays(tmp_path / "x.npz", {"a": ()})["a"].item() == 2.5


@pytest.mark.parametrize("keep", [0, 1, 30, 200, 0.5, 0.9, -1])
def test_a_truncated_file_is_refused(tmp_path: Path, keep: float) -> None:
    data = good(tmp_path / "x.npz", 50).read_bytes()
    cut = tmp_path / "Encoders1.npz"
    cut.write_bytes(data[: int(keep * len(data)) if isinstance(keep, float) else keep])
    with pytest.raises(InputError) as caught:
        read_arrays(cut, SHAPES)
    assert caught.value.file == str(cut)


def test_escape_codes_in_the_names_of_arrays_are_not_printed(tmp_path: Path) -> None:
    path = zipped(tmp_path / "x.npz", **{"\x1b[31m\n": b"x"})
    with pytest.raises(InputError) as caught:
        read_arrays(path, SHAPES)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    "counts",
    [
        np.ones((4, 6)),
        np.ones((5, 4)),
        np.ones(5),
        np.ones((4, 0)),
        np.float64(1),
        np.ones((4, 5), complex),
        np.full((4, 5), "a"),
        np.ones((4, 5), bool),
        None,
    ],
)
def test_wrong_shapes_and_dtypes_are_refused(tmp_path: Path, counts: np.ndarray | None) -> None:
    arrays = {"time_stamps": np.arange(5.0), **({} if counts is None else {"counts": counts})}
    np.savez(tmp_path / "x.npz", **arrays)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="expected") as caught:
        read_arrays(tmp_path / "x.npz", SHAPES)
    assert caught.value.field == "counts"


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
        npy_header((1 << 62, 1 << 62)),
        npy_header((4,), "<f8").replace(b"(4,)", b"(-4)"),
        b"\x93NUMPY\x02\x00" + struct.pack("<I", 0xFFFFFFF0),
        b"\x93NUMPY\x07\x00",
        b"no header",
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


@pytest.mark.parametrize("declared", [48, 1 << 31])
def test_a_directory_that_lies_about_a_size_is_refused(tmp_path: Path, declared: int) -> None:
    """The central directory says less or more than there is; the header of the array agrees with the lie."""
    header = npy_header(((declared - 128) // 8,))
    path = zipped(tmp_path / "x.npz", time_stamps=header + bytes(8000))
    data = bytearray(path.read_bytes())
    entry = data.index(b"PK\x01\x02")
    data[entry + 24 : entry + 28] = struct.pack("<I", declared)
    path.write_bytes(data)
    with pytest.raises(InputError):
        read_arrays(path, {"time_stamps": ("n",)})
