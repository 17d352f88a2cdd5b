"""Launching a kernel in a third of the time that Taichi takes to look its arguments over.

Taichi spends some 13 us on each NumPy array of a call, more than many a kernel runs: on what cannot occur here,
fields, tensors of other libraries, gradients, matrices. Once a kernel is compiled, a call with exactly the types of
its annotations is therefore handed to the compiled kernel directly; every other call, the first among them, goes
the way of Taichi, which compiles, converts or complains. On the CPU the arguments of the last launch are kept: the
map and the constants, most of them, need not be handed over again.

This leans on the insides of one release of Taichi. With any other everything goes Taichi's way.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum, auto
from functools import wraps
from typing import Any

import numpy as np

from moteslam.kernels.runtime import runtime, ti

KNOWN = (1, 7, 4)
"""The release whose insides are known."""


class Kind(Enum):
    """What an argument that is no array must be; a template is a number the kernel is compiled for."""

    SIGNED = auto()
    UNSIGNED = auto()
    REAL = auto()
    TEMPLATE = auto()


_Array = tuple[np.dtype[Any], int]
"""The element type and number of dimensions that an array must have."""

_ABLE: dict[Any, tuple[type, ...]] = {
    Kind.SIGNED: (int, np.integer),
    Kind.UNSIGNED: (int, np.integer),
    Kind.REAL: (float, int, np.floating, np.integer),
}
"""What a number of each kind may be given as."""

_NUMBERS = {ti.i32: Kind.SIGNED, ti.u32: Kind.UNSIGNED, ti.f32: Kind.REAL, ti.f64: Kind.REAL}


def quick(function: Callable[..., Any]) -> Callable[..., Any]:
    """``ti.kernel`` whose launches are quick, for kernels of NumPy arrays and numbers that return nothing."""
    slow = ti.kernel(function)
    kinds = _kinds(slow)
    if kinds is None:
        return slow  # type: ignore[no-any-return]
    templates = [index for index, kind in enumerate(kinds) if kind is Kind.TEMPLATE]
    compiled: dict[tuple[Any, ...], Any] = {}
    spare: dict[tuple[Any, ...], list[_Context]] = {}

    @wraps(function)
    def launcher(*arguments: Any) -> None:
        form = tuple([arguments[index] for index in templates]) if len(arguments) == len(kinds) else ()
        plain = all(type(value) in (bool, int) for value in form)
        if plain and form in compiled and len(arguments) == len(kinds):
            waiting = spare[form]
            context = waiting.pop() if waiting else _Context(compiled[form], kinds)  # each thread has its own
            if context.launch(arguments):
                if runtime().arch == "cpu":
                    waiting.append(context)
                return
        slow(*arguments)
        if plain and not runtime().debug:  # a bounds check that fails is told by Taichi's way alone
            spare[form] = []
            compiled[form] = slow._primal.compiled_kernels[slow._primal.ensure_compiled(*arguments)]

    return launcher


def _kinds(slow: Any) -> list[Kind | _Array] | None:
    """What the annotations of a kernel ask for, or None where quick launches do not know it."""
    if ti.__version__ != KNOWN or slow._primal.return_type is not None:
        return None
    kinds: list[Kind | _Array] = []
    for argument in slow._primal.arguments:
        asked = argument.annotation
        if isinstance(asked, ti.types.ndarray_type.NdarrayType):
            kinds.append((np.dtype(ti.lang.util.to_numpy_type(asked.dtype)), asked.ndim))
        elif isinstance(asked, ti.template):
            kinds.append(Kind.TEMPLATE)
        elif (number := next((kind for type_, kind in _NUMBERS.items() if asked is type_), None)) is not None:
            kinds.append(number)
        else:
            return None
    return kinds


class _Context:
    """The arguments of a compiled kernel as they were at its last launch: what is the same again is not set again."""

    def __init__(self, compiled: Any, kinds: list[Kind | _Array]) -> None:
        self._program = program = ti.lang.impl.get_runtime().prog
        self._code = program.compile_kernel(program.config(), program.get_device_caps(), compiled)
        self._launch = context = compiled.make_launch_context()
        setters = {
            Kind.SIGNED: (context.set_arg_int, int),
            Kind.UNSIGNED: (context.set_arg_uint, int),
            Kind.REAL: (context.set_arg_float, float),
        }
        asked = [(i, kind) for i, kind in enumerate(kinds) if kind is not Kind.TEMPLATE]
        self._arrays: list[tuple[int, int, np.dtype[Any], int]] = []
        self._numbers: list[tuple[int, int, tuple[type, ...], Callable[..., None], type]] = []
        for place, (index, kind) in enumerate(asked):
            if isinstance(kind, Kind):
                self._numbers.append((place, index, _ABLE[kind], *setters[kind]))
            else:
                self._arrays.append((place, index, *kind))
        self._given: list[Any] = [None] * len(asked)

    def launch(self, arguments: tuple[Any, ...]) -> bool:
        """Launch the kernel; False, and nothing done, if the arguments are not what it was compiled for."""
        given = self._given
        for place, index, dtype, dimensions in self._arrays:
            value = arguments[index]
            if (
                type(value) is not np.ndarray
                or value.dtype != dtype
                or value.ndim != dimensions
                or not value.flags.c_contiguous
            ):
                return False
            where = (value.ctypes.data, value.shape)
            if where != given[place]:
                self._launch.set_arg_external_array_with_shape((place,), where[0], value.nbytes, where[1], 0)
                given[place] = where
        for place, index, able, hand_over, number in self._numbers:
            value = arguments[index]
            if not isinstance(value, able):
                return False
            if value != given[place] or value == 0:  # zeros may differ in their sign
                hand_over((place,), number(value))
                given[place] = value
        self._program.launch_kernel(self._code, self._launch)
        return True
