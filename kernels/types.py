"""The types of kernel arguments, and the decorators, in a form that the type checker understands too.

At run time these are Taichi's; to the type checker arrays are NumPy's, since the CPU backend reads NumPy's memory
as it is. Kernel files do without ``from __future__ import annotations``: Taichi reads the annotations themselves.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeAlias

from moteslam.kernels.front_end import own_func
from moteslam.kernels.launch import fast_kernel
from moteslam.kernels.runtime import ti

__all__ = [
    "F32", "F32_1D", "F32_2D", "F64", "F64_1D", "F64_2D", "I16_1D", "I32", "I32_1D", "I32_2D", "I64_1D", "U8_1D",
    "U16_1D", "U32", "U64_1D", "func", "kernel", "template",
]  # fmt: skip

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    F32: TypeAlias = float
    F32_1D: TypeAlias = NDArray[np.float32]
    F32_2D: TypeAlias = NDArray[np.float32]
    F64: TypeAlias = float
    F64_1D: TypeAlias = NDArray[np.float64]
    F64_2D: TypeAlias = NDArray[np.float64]
    I16_1D: TypeAlias = NDArray[np.int16]
    I32: TypeAlias = int
    I32_1D: TypeAlias = NDArray[np.int32]
    I32_2D: TypeAlias = NDArray[np.int32]
    I64_1D: TypeAlias = NDArray[np.int64]
    U8_1D: TypeAlias = NDArray[np.uint8]
    U16_1D: TypeAlias = NDArray[np.uint16]
    U32: TypeAlias = int
    U64_1D: TypeAlias = NDArray[np.uint64]
    template: TypeAlias = Any

    def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
        """``ti.kernel`` that loads faster, with cheap launches."""
        return function

    def func(function: Callable[..., Any]) -> Callable[..., Any]:
        """``ti.func`` that loads faster."""
        return function
else:
    kernel, func, template = fast_kernel, own_func, ti.template()
    F32, F64, I32, U32 = ti.f32, ti.f64, ti.i32, ti.u32
    F32_1D = ti.types.ndarray(dtype=ti.f32, ndim=1)
    F32_2D = ti.types.ndarray(dtype=ti.f32, ndim=2)
    F64_1D = ti.types.ndarray(dtype=ti.f64, ndim=1)
    F64_2D = ti.types.ndarray(dtype=ti.f64, ndim=2)
    I16_1D = ti.types.ndarray(dtype=ti.i16, ndim=1)
    I32_1D = ti.types.ndarray(dtype=ti.i32, ndim=1)
    I32_2D = ti.types.ndarray(dtype=ti.i32, ndim=2)
    I64_1D = ti.types.ndarray(dtype=ti.i64, ndim=1)
    U8_1D = ti.types.ndarray(dtype=ti.u8, ndim=1)
    U16_1D = ti.types.ndarray(dtype=ti.u16, ndim=1)
    U64_1D = ti.types.ndarray(dtype=ti.u64, ndim=1)
