"""The types of kernel arguments, in a form that the type checker understands too.

To the type checker arrays are NumPy's, since the CPU backend reads NumPy's memory as it is. Kernel files do without
``from __future__ import annotations``: Taichi reads the annotations themselves.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeAlias

from moteslam.kernels.runtime import kernel, ti

__all__ = [
    "F32", "F32_1D", "F32_2D", "F64", "F64_1D", "F64_2D", "I16_1D", "I32", "I32_1D", "I32_2D", "I64_1D", "U8_1D",
    "U16_1D", "U32", "U64_1D", "func", "kernel", "template",
]  # fmt: skip

func: Callable[[Callable[..., Any]], Callable[..., Any]] = ti.func

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    F32: TypeAlias = float
    F64: TypeAlias = float
    I32: TypeAlias = int
    U32: TypeAlias = int
    template: TypeAlias = Any
    F32_1D: TypeAlias = NDArray[np.float32]
    F32_2D: TypeAlias = NDArray[np.float32]
    F64_1D: TypeAlias = NDArray[np.float64]
    F64_2D: TypeAlias = NDArray[np.float64]
    I16_1D: TypeAlias = NDArray[np.int16]
    I32_1D: TypeAlias = NDArray[np.int32]
    I32_2D: TypeAlias = NDArray[np.int32]
    I64_1D: TypeAlias = NDArray[np.int64]
    U8_1D: TypeAlias = NDArray[np.uint8]
    U16_1D: TypeAlias = NDArray[np.uint16]
    U64_1D: TypeAlias = NDArray[np.uint64]
else:
    F32, F64, I32, U32, template = ti.f32, ti.f64, ti.i32, ti.u32, ti.template()
    F32_1D, F32_2D = (ti.types.ndarray(dtype=ti.f32, ndim=n) for n in (1, 2))
    F64_1D, F64_2D = (ti.types.ndarray(dtype=ti.f64, ndim=n) for n in (1, 2))
    I32_1D, I32_2D = (ti.types.ndarray(dtype=ti.i32, ndim=n) for n in (1, 2))
    I16_1D, I64_1D, U8_1D, U16_1D, U64_1D = (
        ti.types.ndarray(dtype=dtype, ndim=1) for dtype in (ti.i16, ti.i64, ti.u8, ti.u16, ti.u64)
    )
