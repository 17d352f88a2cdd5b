"""Arrays out of an ``.npz`` file that nobody vouches for: sizes are looked at before an array is read; no pickles."""

from __future__ import annotations

import lzma
import math
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.files import open_regular

MAX_BYTES = 2 << 30
"""No file may declare more than this for the arrays asked for: 2 GiB, over an hour of a 1081-beam lidar at 40 Hz."""

_BROKEN = (
    *(zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError, KeyError, MemoryError),
    *(OSError, OverflowError, SyntaxError, tokenize.TokenError, lzma.LZMAError),
)
"""What `zipfile` and `numpy.load` raise of a damaged file."""

Shape = tuple[int | str, ...]
"""A shape asked for: numbers, and letters that stand for one size throughout the file. ``()`` is one number."""


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
    """
    arrays: dict[str, NDArray[Any]] = {}
    name = ""
    with open_regular(path, "a .npz file") as file:
        try:
            with zipfile.ZipFile(file) as archive:
                stored = {member.filename.removesuffix(".npy"): member.file_size for member in archive.infolist()}
        except _BROKEN as error:
            problem = "is empty" if path.stat().st_size == 0 else "not a whole file"
            raise InputError(f"{problem}, expected a .npz of {', '.join(shapes)}", file=path) from error
        if missing := [name for name in shapes if name not in stored]:
            found = ", ".join(ascii(name[:40]) for name in sorted(stored)[:8]) or "none"
            problem = f"missing, expected an array of this name (the file has {found})"
            raise InputError(problem, file=path, field=missing[0])
        if (total := sum(stored[name] for name in shapes)) > max_bytes:
            raise InputError(f"{total} bytes of arrays, expected at most {max_bytes}", file=path)
        file.seek(0)
        try:
            with np.load(file, allow_pickle=False) as content:
                for name in shapes:
                    arrays[name] = content[name]
        except _BROKEN as error:
            problem = "holds pickled objects" if "allow_pickle" in str(error) else "cut short or damaged"
            raise InputError(f"{problem}, expected an array of numbers", file=path, field=name) from error
    sizes: dict[str, int] = {}
    for name, wanted in shapes.items():
        array = arrays[name]
        if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
            raise InputError(f"{getattr(array, 'dtype', 'no array')}, expected real numbers", file=path, field=name)
        if wanted == () and math.prod(array.shape) == 1:
            continue
        known = tuple(sizes.get(size, size) if isinstance(size, str) else size for size in wanted)
        sizes |= {size: have for size, have in zip(known, array.shape, strict=False) if isinstance(size, str)}
        expected = tuple(sizes.get(size, size) if isinstance(size, str) else size for size in wanted)
        if array.shape != expected or 0 in array.shape or wanted == ():
            what = f"[{', '.join(map(str, known))}], none of them 0" if wanted else "one number"
            raise InputError(f"shape {list(array.shape)}, expected {what}", file=path, field=name)
    return arrays
