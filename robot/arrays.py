"""Arrays that nobody can change: what an immutable value holds."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from moteslam.errors import InputError
from moteslam.robot.wording import shortened


def frozen(values: ArrayLike, dtype: DTypeLike | None = None) -> NDArray[Any]:
    """The values as a contiguous array that cannot be written to.

    An array that somebody can still write to is copied: neither is a caller's array frozen under him, nor does what he
    writes into it change the value. One that nobody can write to is taken as it is; so readers hand over what is
    large ``given_up``.

    Args:
        values: of the array.
        dtype: to convert to; as they are if None.

    Raises:
        InputError: they are no numbers, or rows of several lengths.
    """
    try:
        array: NDArray[Any] = np.ascontiguousarray(values, dtype)
    except (TypeError, ValueError) as error:
        raise InputError(f"{type(values).__name__} {shortened(values)}, expected an array of numbers") from error
    if isinstance(values, np.ndarray) and np.may_share_memory(array, values) and _writable(array):
        array = array.copy()
    array.setflags(write=False)
    return array


def given_up(array: NDArray[Any]) -> NDArray[Any]:
    """An array that its only owner writes to no more, so that the value it goes into need not copy it."""
    base: Any = array
    while isinstance(base, np.ndarray):
        base.setflags(write=False)
        base = base.base
    return array


def _writable(array: NDArray[Any]) -> bool:
    """Whether the memory of an array can be written to, through itself or what it is a view of."""
    base: Any = array
    while isinstance(base, np.ndarray):
        if base.flags.writeable:
            return True
        base = base.base
    return base is not None and not isinstance(base, bytes)
