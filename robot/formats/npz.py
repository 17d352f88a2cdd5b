"""Arrays out of an ``.npz`` file that nobody vouches for.

The zip directory and the header of every array are read first: names, dtypes, shapes and sizes are checked, and only
then is an array allocated. Pickles are never loaded. (``np.load`` allocates what a header declares, whatever the file
holds.)
"""

from __future__ import annotations

import io
import math
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.reading import open_regular

MAX_BYTES = 2 << 30
"""No file may declare more than this for the arrays asked for: 2 GiB, over an hour of a 1081-beam lidar at 40 Hz."""

_HEADER_BYTES = 16 << 10
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)

Shape = tuple[int | str, ...]
"""A shape asked for: numbers, and letters that stand for one size throughout the file. ``()`` is one number."""


@dataclass(frozen=True)
class _Header:
    member: zipfile.ZipInfo
    shape: tuple[int, ...]
    fortran: bool
    dtype: np.dtype[Any]
    offset: int


def is_archive(path: Path) -> bool:
    """Whether a file is an ``.npz``, by its first bytes; one that cannot be read is none."""
    try:
        with open_regular(path, "a .npz file") as file:
            return file.read(4) == b"PK\x03\x04"
    except (InputError, OSError):
        return False


def read_arrays(path: Path, shapes: Mapping[str, Shape], *, max_bytes: int = MAX_BYTES) -> dict[str, NDArray[Any]]:
    """Read the named arrays of real numbers, each of the shape asked for; others in the file are left alone.

    Args:
        path: the ``.npz`` file.
        shapes: the arrays and their shapes, such as ``{"time_stamps": ("n",), "counts": (4, "n")}``; an array of
            shape ``()`` may also come with one element in any number of dimensions. Every size is at least 1.
        max_bytes: what the arrays may take together, uncompressed.

    Raises:
        InputError: not a whole ``.npz`` file, an array that is missing, of another shape, not of numbers, that
            lies about its size, or is too large.
    """
    try:
        with open_regular(path, "a .npz file") as file, zipfile.ZipFile(file) as archive:
            members = {member.filename: member for member in archive.infolist()}
            headers = {name: _header(archive, members, path, name) for name in shapes}
            _check_shapes(path, shapes, headers)
            total = sum(header.member.file_size for header in headers.values())
            if total > max_bytes:
                raise InputError(f"{total} bytes of arrays, expected at most {max_bytes}", file=path)
            return {name: _data(archive, path, name, header) for name, header in headers.items()}
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError) as error:
        problem = "is empty" if path.stat().st_size == 0 else "not a whole file"
        raise InputError(f"{problem}, expected a .npz of {', '.join(shapes)}", file=path) from error
    except OSError as error:
        raise InputError(f"{error.strerror or error}, expected a .npz file", file=path) from error


def _header(archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], path: Path, name: str) -> _Header:
    member = members.get(f"{name}.npy")
    if member is None:
        names = [key.removesuffix(".npy") for key in sorted(members)]
        found = ", ".join(key if key.isidentifier() else ascii(key[:40]) for key in names[:8]) or "none"
        raise InputError(f"missing, expected an array of this name (the file has {found})", file=path, field=name)
    if member.compress_type not in _METHODS or member.flag_bits & 1:
        raise InputError("packed in a way not known here, expected stored or deflated", file=path, field=name)
    with archive.open(member) as stream:
        start = io.BytesIO(stream.read(_HEADER_BYTES))  # bounded: a header may declare any length of itself
    try:
        read = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}[npy.read_magic(start)]
        shape, fortran, dtype = read(start)
    except (KeyError, ValueError, EOFError, OverflowError, RecursionError, MemoryError, tokenize.TokenError) as error:
        raise InputError("has no readable .npy header", file=path, field=name) from error
    if dtype.hasobject:
        raise InputError("holds pickled objects, expected numbers", file=path, field=name)
    if dtype.kind not in "fiu":
        raise InputError(f"of dtype {dtype}, expected real numbers", file=path, field=name)
    if min(shape, default=1) < 0 or member.file_size != start.tell() + math.prod(shape) * dtype.itemsize:
        raise InputError(
            f"declares {_text(shape)} of {dtype} but has {member.file_size - start.tell()} bytes",
            file=path,
            field=name,
        )
    return _Header(member, shape, fortran, dtype, start.tell())


def _check_shapes(path: Path, shapes: Mapping[str, Shape], headers: Mapping[str, _Header]) -> None:
    sizes: dict[str, int] = {}
    for name, wanted in shapes.items():
        found = headers[name].shape
        if wanted == () and math.prod(found) == 1:
            continue
        expected = tuple(sizes.get(size, size) if isinstance(size, str) else size for size in wanted)
        fits = len(found) == len(expected) and all(
            have > 0 and have == (want if isinstance(want, int) else have)
            for have, want in zip(found, expected, strict=True)
        )
        if not fits or wanted == ():
            hint = ", none of them 0" if 0 in found else ""
            what = _text(expected) if wanted else "one number"
            raise InputError(f"shape {_text(found)}, expected {what}{hint}", file=path, field=name)
        sizes.update((size, have) for size, have in zip(wanted, found, strict=True) if isinstance(size, str))


def _data(archive: zipfile.ZipFile, path: Path, name: str, header: _Header) -> NDArray[Any]:
    with archive.open(header.member) as stream:
        data = stream.read(header.member.file_size)
    if len(data) != header.member.file_size:
        raise InputError(f"cut short at {len(data)} bytes", file=path, field=name)
    flat = np.frombuffer(data, header.dtype, offset=header.offset)
    return flat.reshape(header.shape, order="F" if header.fortran else "C")


def _text(shape: tuple[int | str, ...]) -> str:
    return "[" + ", ".join(map(str, shape)) + "]"
