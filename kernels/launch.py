"""Launching a compiled kernel in a third of the time that Taichi needs to inspect its arguments.

Taichi spends some 13 us on each NumPy array of a call, longer than many a kernel runs: it looks for fields, tensors of
other libraries, gradients and matrices, none of which occur here. Once a kernel is compiled, a call whose arguments
have exactly the annotated types, arrays in NumPy's memory or on the device, is therefore handed to the compiled kernel
directly. Every other call, the first among
them, goes through Taichi, which compiles, converts or raises. On the CPU the arguments of the last launch are kept, so
that those that did not change, the map and the constants, need not be set again.

This uses internals of one release of Taichi, and replaces none; with any other release every call goes through Taichi.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum, auto
from functools import wraps
from typing import Any
from weakref import ref

import numpy as np

from moteslam.kernels.front_end import KNOWN, own_kernel
from moteslam.kernels.runtime import runtime, ti


class Kind(Enum):
    """The type of an argument that is no array; a template is a number that the kernel is compiled for."""

    SIGNED = auto()
    UNSIGNED = auto()
    REAL = auto()
    TEMPLATE = auto()


_Array = tuple[np.dtype[Any], int]
"""The element type and number of dimensions that an array must have."""

_ACCEPTED: dict[Any, tuple[type, ...]] = {
    Kind.SIGNED: (int, np.integer),
    Kind.UNSIGNED: (int, np.integer),
    Kind.REAL: (float, int, np.floating, np.integer),
}
"""The types of Python and NumPy that are accepted for a number of each kind."""

_DEVICE_ARRAY = ti.lang._ndarray.ScalarNdarray
"""Taichi's own arrays, which stay on the device."""

_NUMBERS = {ti.i32: Kind.SIGNED, ti.u32: Kind.UNSIGNED, ti.f32: Kind.REAL, ti.f64: Kind.REAL}


def fast_kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """``ti.kernel`` with cheap launches, for kernels of arrays and numbers that return nothing."""
    kernel = own_kernel(function)
    kinds = _kinds(kernel)
    if kinds is None:
        return kernel  # type: ignore[no-any-return]
    templates = [index for index, kind in enumerate(kinds) if kind is Kind.TEMPLATE]
    compiled: dict[tuple[Any, ...], Any] = {}  # by the values of the templates
    idle: dict[tuple[Any, ...], list[_Context]] = {}

    @wraps(function)
    def launcher(*arguments: Any) -> None:
        values = tuple([arguments[index] for index in templates]) if len(arguments) == len(kinds) else ()
        numbers = all(type(value) in (bool, int) for value in values)
        if numbers and values in compiled and len(arguments) == len(kinds):
            waiting = idle[values]
            context = waiting.pop() if waiting else _Context(compiled[values], kinds)  # each thread has its own
            if context.launch(arguments):
                if runtime().arch == "cpu":
                    waiting.append(context)
                return
        kernel(*arguments)
        if numbers and not runtime().debug:  # only Taichi's own launch reports a bounds check that failed
            idle[values] = []
            compiled[values] = kernel._primal.compiled_kernels[kernel._primal.ensure_compiled(*arguments)]

    return launcher


def _kinds(kernel: Any) -> list[Kind | _Array] | None:
    """The types that a kernel's annotations ask for, or None where one of them is not supported here."""
    if ti.__version__ != KNOWN or kernel._primal.return_type is not None:
        return None
    kinds: list[Kind | _Array] = []
    for argument in kernel._primal.arguments:
        annotation = argument.annotation
        if isinstance(annotation, ti.types.ndarray_type.NdarrayType):
            kinds.append((np.dtype(ti.lang.util.to_numpy_type(annotation.dtype)), annotation.ndim))
        elif isinstance(annotation, ti.template):
            kinds.append(Kind.TEMPLATE)
        elif (number := next((kind for type_, kind in _NUMBERS.items() if annotation is type_), None)) is not None:
            kinds.append(number)
        else:
            return None
    return kinds


def _nothing() -> None:
    """A reference to no array."""


class _Context:
    """The arguments of a compiled kernel as they were at its last launch; those that are equal are not set again."""

    def __init__(self, compiled: Any, kinds: list[Kind | _Array]) -> None:
        self._program = program = ti.lang.impl.get_runtime().prog
        self._code = program.compile_kernel(program.config(), program.get_device_caps(), compiled)
        self._launch = context = compiled.make_launch_context()
        setters = {
            Kind.SIGNED: (context.set_arg_int, int),
            Kind.UNSIGNED: (context.set_arg_uint, int),
            Kind.REAL: (context.set_arg_float, float),
        }
        arguments = [(i, kind) for i, kind in enumerate(kinds) if kind is not Kind.TEMPLATE]
        self._arrays: list[tuple[int, int, np.dtype[Any], int]] = []
        self._numbers: list[tuple[int, int, tuple[type, ...], Callable[..., None], type]] = []
        for place, (index, kind) in enumerate(arguments):
            if isinstance(kind, Kind):
                self._numbers.append((place, index, _ACCEPTED[kind], *setters[kind]))
            else:
                self._arrays.append((place, index, *kind))
        self._last: list[Any] = [None] * len(arguments)
        self._same: list[Callable[[], Any]] = [_nothing] * len(arguments)  # the arrays of the last launch

    def launch(self, arguments: tuple[Any, ...]) -> bool:
        """Launch the kernel; False, and nothing done, if the arguments have other types than it was compiled for."""
        last = self._last
        for place, index, dtype, dimensions in self._arrays:
            value = arguments[index]
            same = self._same[place]()
            if same is value and same is not None and same.shape == last[place][1]:
                continue
            if type(value) is _DEVICE_ARRAY:
                if len(value.shape) != dimensions or ti.lang.util.to_numpy_type(value.dtype) != dtype:
                    return False
                self._launch.set_arg_ndarray((place,), value.arr)  # at every launch, which writes over it
                last[place], self._same[place] = None, _nothing
                continue
            if (
                type(value) is not np.ndarray
                or value.dtype != dtype
                or value.ndim != dimensions
                or not value.flags.c_contiguous
            ):
                return False
            memory = (value.ctypes.data, value.shape)
            if memory != last[place]:
                self._launch.set_arg_external_array_with_shape((place,), memory[0], value.nbytes, memory[1], 0)
                last[place] = memory
            self._same[place] = ref(value)
        for place, index, accepted, set_argument, number in self._numbers:
            value = arguments[index]
            if value is last[place]:
                continue
            if not isinstance(value, accepted):
                return False
            if value != last[place] or value == 0:  # zeros may differ in their sign
                set_argument((place,), number(value))
                last[place] = value
        self._program.launch_kernel(self._code, self._launch)
        return True
