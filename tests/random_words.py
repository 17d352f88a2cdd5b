"""The generator of random words as kernels call it, launched from tests."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.kernels.motion import philox
from moteslam.kernels.runtime import one_thread, ti
from moteslam.kernels.types import I64_1D, kernel


@kernel
def _philox(counters: I64_1D, keys: I64_1D, out: I64_1D):
    ti.loop_config(serialize=ti.static(one_thread()))
    for i in range(out.shape[0] // 4):
        counter = ti.Vector([ti.cast(counters[4 * i + j], ti.u32) for j in ti.static(range(4))], dt=ti.u32)
        words = philox(counter, ti.Vector([ti.cast(keys[2 * i + j], ti.u32) for j in ti.static(range(2))], dt=ti.u32))
        for j in ti.static(range(4)):
            out[4 * i + j] = ti.cast(words[j], ti.i64)


def philox_words(counters: ArrayLike, keys: ArrayLike) -> NDArray[np.uint32]:
    """Random words [n, 4] of counters [n, 4] and keys [n, 2], all below 2^32."""
    blocks, pairs = (np.asarray(values, np.int64) for values in (counters, keys))
    out = np.empty(blocks.size, np.int64)
    _philox(blocks.reshape(-1), pairs.reshape(-1), out)
    return out.reshape(-1, 4).astype(np.uint32)
