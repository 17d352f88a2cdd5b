"""``ti.kernel`` and ``ti.func`` that load in two thirds of Taichi's time and launch in a third.

Loading: in every process Taichi runs its front end over a kernel, to find it in the cache on disk. It looks up the
source of a function at each of its calls, and draws carets under every expression. Copies of some of Taichi's functions
that see other globals, bound to the kernels of this package alone, read a function once and name file, line and code.

Launching: Taichi spends 13 us on each array of a call, longer than many a kernel runs: it looks for fields, gradients
and matrices. Once a kernel is compiled, a call whose arguments have exactly the annotated types is handed to the
compiled kernel directly; every other call goes through Taichi, which compiles, converts or raises. On the CPU the
arguments of the last launch are kept: those that did not change, the map and the constants, need not be set again.

Together they save a fifth of a replay of half a minute. Both use internals of one release and replace none: with any
other release Taichi's own ``kernel`` and ``func`` are used.
"""

from __future__ import annotations

import inspect
import linecache
import textwrap
from collections.abc import Callable
from functools import cache, wraps
from types import FunctionType, MethodType, SimpleNamespace
from typing import Any, NamedTuple
from weakref import ref

import numpy as np

from moteslam.kernels.runtime import runtime, ti

KNOWN = (1, 7, 4)
"""The release whose internals are used."""


def func(function: Callable[..., Any]) -> Callable[..., Any]:
    """``ti.func`` for a function that is no method."""
    if ti.__version__ != KNOWN:
        return ti.func(function)  # type: ignore[no-any-return]
    front_end = _front_end()
    inlined: Any = front_end.func(function)
    inlined.func.__call__ = MethodType(front_end.inline, inlined.func)
    return inlined  # type: ignore[no-any-return]


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """``ti.kernel`` for a function of arrays, numbers and templates that are numbers, and that returns nothing."""
    if ti.__version__ != KNOWN:
        return ti.kernel(function)  # type: ignore[no-any-return]
    front_end = _front_end()
    own = front_end.kernel(function, level_of_class_stackframe=3)
    own._primal.materialize = MethodType(front_end.compile, own._primal)
    annotations = [argument.annotation for argument in own._primal.arguments]
    templates = [index for index, each in enumerate(annotations) if isinstance(each, ti.template)]
    compiled: dict[tuple[Any, ...], Any] = {}  # by the values of the templates
    idle: dict[tuple[Any, ...], list[_Launch]] = {}

    @wraps(function)
    def launcher(*arguments: Any) -> None:
        complete = len(arguments) == len(annotations)
        values = tuple([arguments[index] for index in templates]) if complete else ()
        if complete and values in compiled:
            waiting = idle[values]
            launch = waiting.pop() if waiting else _Launch(compiled[values], annotations)  # each thread has its own
            if launch.run(arguments):
                if runtime().arch == "cpu":
                    waiting.append(launch)
                return
        own(*arguments)
        if not runtime().debug:  # only Taichi's own launch reports a bounds check that failed
            idle[values] = []
            compiled[values] = own._primal.compiled_kernels[own._primal.ensure_compiled(*arguments)]

    return launcher


def _with_globals(function: Any, **others: Any) -> FunctionType:
    """A copy of a function that sees other values for some of its globals."""
    scope = {**function.__globals__, **others}
    copy = FunctionType(function.__code__, scope, function.__name__, function.__defaults__, function.__closure__)
    copy.__kwdefaults__ = function.__kwdefaults__
    return copy


@cache
def _lines_of(function: FunctionType) -> tuple[list[str], int]:
    """``inspect.getsourcelines`` of a function: its lines, and the number of the first."""
    code = function.__code__
    lines = linecache.getlines(code.co_filename, function.__globals__)
    return inspect.getblock(lines[code.co_firstlineno - 1 :]), code.co_firstlineno


@cache
def _front_end() -> SimpleNamespace:
    """Copies of Taichi's functions, by their purpose."""

    class Context(ti.lang.ast.ast_transformer_utils.ASTTransformerContext):  # type: ignore[misc]
        def get_pos_info(self, node: Any) -> str:
            """File, line, function and code of an expression."""
            line = node.lineno + self.lineno_offset
            return f'File "{self.file}", line {line}, in {self.func.func.__name__}:\n{self.src[node.lineno - 1]}\n'

    taichi = ti.lang.kernel_impl
    tree = _with_globals(
        taichi._get_tree_and_ctx,
        getsourcefile=lambda function: function.__code__.co_filename,
        getsourcelines=_lines_of,
        textwrap=SimpleNamespace(fill=cache(textwrap.fill), dedent=cache(textwrap.dedent)),
        ASTTransformerContext=Context,
    )
    no_method = {"_inside_class": lambda level_of_class_stackframe: False}  # else it reads the source of the caller
    return SimpleNamespace(
        kernel=_with_globals(taichi._kernel_impl, **no_method),
        func=_with_globals(taichi.func, **no_method),
        compile=_with_globals(taichi.Kernel.materialize, _get_tree_and_ctx=tree),
        inline=_with_globals(taichi.Func.__call__, _get_tree_and_ctx=tree),
    )


class _Number(NamedTuple):
    """An argument that is a number: its number in the call, its place among those that are set, and how it is set."""

    number: int
    place: int
    accepted: tuple[type, ...]
    set_argument: Callable[..., None]
    convert: type


class _Array(NamedTuple):
    """An argument that is an array: its number in the call, its place among those that are set, what it must be."""

    number: int
    place: int
    dtype: np.dtype[Any]
    dimensions: int


class _Launch:
    """A compiled kernel with the arguments of its last launch; those that are equal are not set again."""

    def __init__(self, compiled: Any, annotations: list[Any]) -> None:
        self._program = program = ti.lang.impl.get_runtime().prog
        self._code = program.compile_kernel(program.config(), program.get_device_caps(), compiled)
        self._context = context = compiled.make_launch_context()
        integer, real = (int, np.integer), (float, int, np.floating, np.integer)
        setters = {
            ti.i32: (integer, context.set_arg_int, int),
            ti.u32: (integer, context.set_arg_uint, int),
            ti.f32: (real, context.set_arg_float, float),
            ti.f64: (real, context.set_arg_float, float),
        }
        given = [(k, each) for k, each in enumerate(annotations) if not isinstance(each, ti.template)]
        self._arrays: list[_Array] = []
        self._numbers: list[_Number] = []
        for place, (index, each) in enumerate(given):
            if isinstance(each, ti.types.ndarray_type.NdarrayType):
                dtype = np.dtype(ti.lang.util.to_numpy_type(each.dtype))
                self._arrays.append(_Array(index, place, dtype, each.ndim))
            else:
                self._numbers.append(_Number(index, place, *setters[each]))
        self._last: list[Any] = [None] * len(given)  # numbers; address and shape of arrays
        self._same: list[Callable[[], Any]] = [_no_array] * len(given)  # the arrays themselves

    def run(self, arguments: tuple[Any, ...]) -> bool:
        """Launch the kernel; False, and nothing done, if the arguments have other types than it was compiled for."""
        last = self._last
        for number, place, dtype, dimensions in self._arrays:
            value = arguments[number]
            same = self._same[place]()
            if same is value and same is not None and same.shape == last[place][1]:
                continue
            if type(value) is np.ndarray:
                if value.dtype != dtype or value.ndim != dimensions or not value.flags.c_contiguous:
                    return False
                memory = (value.ctypes.data, value.shape)
                if memory != last[place]:
                    self._context.set_arg_external_array_with_shape((place,), memory[0], value.nbytes, memory[1], 0)
                    last[place] = memory
                self._same[place] = ref(value)
            elif type(value) is ti.lang._ndarray.ScalarNdarray:  # one of Taichi's own, on the device
                if len(value.shape) != dimensions or ti.lang.util.to_numpy_type(value.dtype) != dtype:
                    return False
                self._context.set_arg_ndarray((place,), value.arr)  # at every launch, which writes over it
                last[place], self._same[place] = None, _no_array
            else:
                return False
        for number, place, accepted, set_argument, convert in self._numbers:
            value = arguments[number]
            if value is last[place]:
                continue
            if not isinstance(value, accepted):
                return False
            if value != last[place] or value == 0:  # zeros may differ in their sign
                set_argument((place,), convert(value))
                last[place] = value
        self._program.launch_kernel(self._code, self._context)
        return True


def _no_array() -> None:
    """A reference to no array."""
