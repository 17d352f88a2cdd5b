"""Loading kernels that were compiled before, in two thirds of the time that Taichi needs.

In every process Taichi runs its front end over a kernel, to find it in the cache on disk. It looks up the source of a
function at each of its calls, and for error messages it draws carets under every expression of every kernel. The
kernels of this package have a front end of their own: copies of some of Taichi's functions that see other globals,
where a function is read once and an expression is described by file, line and code. The copies are bound to
our kernels and functions alone; Taichi, and what others compile with it, stay as they are.

This uses internals of one release of Taichi; with any other release its own front end runs.
"""

from __future__ import annotations

import inspect
import linecache
import textwrap
from collections.abc import Callable
from functools import cache
from types import FunctionType, MethodType, SimpleNamespace
from typing import Any

from moteslam.kernels.runtime import ti

KNOWN = (1, 7, 4)
"""The release whose internals are used."""


class _Context(ti.lang.ast.ast_transformer_utils.ASTTransformerContext):  # type: ignore[misc]
    """The context of a function that is transformed; it describes places without carets."""

    def get_pos_info(self, node: Any) -> str:
        """File, line, function and code of an expression."""
        line = node.lineno + self.lineno_offset
        return f'File "{self.file}", line {line}, in {self.func.func.__name__}:\n{self.src[node.lineno - 1]}\n'


def _with_globals(function: Any, **others: Any) -> FunctionType:
    """A copy of a function that sees other values for some of its globals."""
    scope = {**function.__globals__, **others}
    copy = FunctionType(function.__code__, scope, function.__name__, function.__defaults__, function.__closure__)
    copy.__kwdefaults__ = function.__kwdefaults__
    return copy


def _outside_classes(level_of_class_stackframe: int) -> bool:
    """Taichi looks up the source of the caller to see whether a kernel is a method; ours never are."""
    return False


def _file_of(function: FunctionType) -> str:
    """``inspect.getsourcefile`` of a function, which looks through all modules for it."""
    return function.__code__.co_filename


@cache
def _lines_of(function: FunctionType) -> tuple[list[str], int]:
    """``inspect.getsourcelines`` of a function: its lines, and the number of the first."""
    code = function.__code__
    lines = linecache.getlines(code.co_filename, function.__globals__)
    return inspect.getblock(lines[code.co_firstlineno - 1 :]), code.co_firstlineno


@cache
def _front_end() -> dict[str, FunctionType]:
    """Copies of Taichi's functions, by their purpose."""
    taichi = ti.lang.kernel_impl
    tree = _with_globals(
        taichi._get_tree_and_ctx,
        getsourcefile=_file_of,
        getsourcelines=_lines_of,
        textwrap=SimpleNamespace(fill=cache(textwrap.fill), dedent=cache(textwrap.dedent)),
        ASTTransformerContext=_Context,
    )
    return {
        "kernel": _with_globals(taichi._kernel_impl, _inside_class=_outside_classes),
        "func": _with_globals(taichi.func, _inside_class=_outside_classes),
        "compile": _with_globals(taichi.Kernel.materialize, _get_tree_and_ctx=tree),
        "inline": _with_globals(taichi.Func.__call__, _get_tree_and_ctx=tree),
    }


def own_kernel(function: Callable[..., Any]) -> Any:
    """``ti.kernel`` with this front end, for a function that is no method."""
    if ti.__version__ != KNOWN:
        return ti.kernel(function)
    kernel = _front_end()["kernel"](function, level_of_class_stackframe=3)
    kernel._primal.materialize = MethodType(_front_end()["compile"], kernel._primal)
    return kernel


def own_func(function: Callable[..., Any]) -> Callable[..., Any]:
    """``ti.func`` with this front end, for a function that is no method."""
    if ti.__version__ != KNOWN:
        return ti.func(function)  # type: ignore[no-any-return]
    inlined: Any = _front_end()["func"](function)
    inlined.func.__call__ = MethodType(_front_end()["inline"], inlined.func)
    return inlined  # type: ignore[no-any-return]
