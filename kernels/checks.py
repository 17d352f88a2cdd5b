"""Checks of a kernel's arguments before it runs: with a wrong shape or cell it would read or write other memory.

Every function of this package raises ``InputError`` with the argument's name as field, for arrays that do not fit
together and indices beyond them. The bounds of other numbers are those of the configurations that they come from.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from moteslam.errors import InputError

LARGEST = 2**31 - 1  # Taichi's indices are 32-bit: no array may have more elements, no launch more threads


def check_array(
    name: str,
    array: object,
    dtype: DTypeLike,
    shape: Sequence[int | None],
    *,
    written: bool = False,
) -> NDArray[Any]:
    """The array as it is, if a kernel can use its memory in place.

    Args:
        shape: the shape it must have; None for any length.
        written: whether the kernel writes to it.
    """
    fits = (
        isinstance(array, np.ndarray)
        and array.dtype == dtype
        and array.ndim == len(shape)
        and not [n for n, m in zip(shape, array.shape, strict=True) if n is not None and n != m]
    )
    if not fits:
        found = f"{array.dtype} {list(array.shape)}" if isinstance(array, np.ndarray) else type(array).__name__
        expected = f"{np.dtype(dtype)} [{', '.join('*' if n is None else str(n) for n in shape)}]"
        raise InputError(f"{found}, expected an array {expected}", field=name)
    assert isinstance(array, np.ndarray)
    if not array.flags.c_contiguous or (written and not array.flags.writeable):
        raise InputError("a view that is not contiguous or not writable, expected a whole array", field=name)
    if array.size > LARGEST:
        raise InputError(f"{array.size} elements, expected at most {LARGEST}", field=name)
    return array


def as_finite(name: str, values: ArrayLike, dtype: DTypeLike, shape: Sequence[int | None]) -> NDArray[Any]:
    """A contiguous array of that type and shape with every value finite; a copy only where one is needed."""
    array = np.ascontiguousarray(values, dtype)
    check_array(name, array, dtype, shape)
    if np.count_nonzero(np.isfinite(array)) < array.size:
        raise InputError("a value that is not finite, expected finite numbers", field=name)
    return array
