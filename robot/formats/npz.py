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
    *(OverflowError, SyntaxError, tokenize.TokenError, lzma.LZMAError),
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

    Raises:
        InputError: not a whole ``.npz`` file, an array that is missing, of another shape, not of numbers, that
            lies about its size, or is too large.
    """
    with open_regular(path, "a .npz file") as file:
        try:
            with zipfile.ZipFile(file) as archive:
                stored = {member.filename.removesuffix(".npy"): member.file_size for member in archive.infolist()}
        except _BROKEN as error:
            problem = "is empty" if path.stat().st_size == 0 else "not a whole file"
            raise InputError(f"{problem}, expected a .npz of {', '.join(shapes)}", file=path) from error
        if missing := [name for name in shapes if name not in stored]:
            names = (name if name.isidentifier() else ascii(name[:40]) for name in sorted(stored)[:8])
            found = ", ".join(names) or "none"
            problem = f"missing, expected an array of this name (the file has {found})"
            raise InputError(problem, file=path, field=missing[0])
        if (total := sum(stored[name] for name in shapes)) > max_bytes:
            raise InputError(f"{total} bytes of arrays, expected at most {max_bytes}", file=path)
        file.seek(0)
        arrays, name = {}, ""
        try:
            with np.load(file, allow_pickle=False) as content:
                for name in shapes:
                    arrays[name] = content[name]
        except (OSError, *_BROKEN) as error:
            problem = "holds pickled objects" if "allow_pickle" in str(error) else "cut short or damaged"
            raise InputError(f"{problem}, expected an array of numbers", file=path, field=name) from error
    sizes: dict[str, int] = {}
    for name, shape in shapes.items():
        _check(path, name, arrays[name], shape, sizes)
    return arrays


def _check(path: Path, name: str, array: object, wanted: Shape, sizes: dict[str, int]) -> None:
    """Refuse an array of another kind or shape; the sizes that letters stand for are added to ``sizes``.

    Raises:
        InputError: it is.
    """
    if not isinstance(array, np.ndarray):
        raise InputError("no array, expected numbers", file=path, field=name)
    if array.dtype.kind not in "fiu":
        raise InputError(f"of dtype {array.dtype}, expected real numbers", file=path, field=name)
    if wanted == () and math.prod(array.shape) == 1:
        return
    expected = tuple(sizes.get(size, size) if isinstance(size, str) else size for size in wanted)
    fits = len(array.shape) == len(expected) and all(
        have > 0 and (isinstance(want, str) or have == want) for have, want in zip(array.shape, expected, strict=True)
    )
    if not fits or wanted == ():
        what = f"[{', '.join(map(str, expected))}]" if wanted else "one number"
        hint = ", none of them 0" if 0 in array.shape else ""
        raise InputError(f"shape {list(array.shape)}, expected {what}{hint}", file=path, field=name)
    sizes.update((size, have) for size, have in zip(wanted, array.shape, strict=True) if isinstance(size, str))
