"""Counter-based random numbers: Philox 4x32-10 (Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", 2011).

A draw depends on (seed; step, particle, stream) alone, not on earlier draws or on the thread: the same seed gives the
same bits on one thread and on many. The counter is (step, particle, stream, 0), the key is (seed mod 2^32,
seed div 2^32).

Written by hand, since NumPy's Philox is 4x64 and cannot run in a kernel, and ``ti.random`` depends on the threads.
"""

import math

from moteslam.errors import InputError
from moteslam.kernels.runtime import ti
from moteslam.kernels.types import U32, func

ROUNDS = 10
MULTIPLIERS = (0xD2511F53, 0xCD9E8D57)
WEYL = (0x9E3779B9, 0xBB67AE85)
TWO_PI = 2 * math.pi


@func
def philox(counter, key):
    """Four random 32-bit words (ti.Vector of u32) of a counter (four u32) and a key (two u32)."""
    c, k = counter, key
    for _ in ti.static(range(ROUNDS)):
        even = ti.cast(c[0], ti.u64) * ti.u64(MULTIPLIERS[0])
        odd = ti.cast(c[2], ti.u64) * ti.u64(MULTIPLIERS[1])
        c = ti.Vector(
            [
                ti.cast(odd >> ti.u64(32), ti.u32) ^ c[1] ^ k[0],
                ti.cast(odd, ti.u32),
                ti.cast(even >> ti.u64(32), ti.u32) ^ c[3] ^ k[1],
                ti.cast(even, ti.u32),
            ],
            dt=ti.u32,
        )
        # summed in 64 bits, cut to 32: the generator's own overflow is none to the bounds checks
        low, high = ti.cast(k[0], ti.u64) + ti.u64(WEYL[0]), ti.cast(k[1], ti.u64) + ti.u64(WEYL[1])
        k = ti.Vector([ti.cast(low, ti.u32), ti.cast(high, ti.u32)], dt=ti.u32)
    return c


@func
def words_of(seed_low: U32, seed_high: U32, step: U32, particle: U32, stream: U32):
    """Four random words (ti.Vector of u32) for a seed, step, particle and stream."""
    counter = ti.Vector([step, particle, stream, ti.u32(0)], dt=ti.u32)
    return philox(counter, ti.Vector([seed_low, seed_high], dt=ti.u32))


@func
def uniform(word: U32):
    """A float64 uniform in (0, 1), never 0 or 1, of a random word: (word + 1/2) / 2^32."""
    return (ti.cast(word, ti.f64) + ti.f64(0.5)) * ti.f64(2.0**-32)


@func
def normals(words):
    """Four independent standard normals (ti.Vector of f64) of four random words, by Box and Muller.

    The smallest uniform is 2^-33, so none lies beyond 6.8 standard deviations.
    """
    r0 = ti.sqrt(ti.f64(-2.0) * ti.log(uniform(words[0])))
    r1 = ti.sqrt(ti.f64(-2.0) * ti.log(uniform(words[2])))
    a0 = ti.f64(TWO_PI) * uniform(words[1])
    a1 = ti.f64(TWO_PI) * uniform(words[3])
    return ti.Vector([r0 * ti.cos(a0), r0 * ti.sin(a0), r1 * ti.cos(a1), r1 * ti.sin(a1)], dt=ti.f64)


def seed_words(seed: int, step: int) -> tuple[int, int, int]:
    """The low and high word of a 64-bit seed and the step as a word, checked.

    Raises:
        InputError: a seed outside 0 to 2^64 - 1, or a step outside 0 to 2^32 - 1.
    """
    if not 0 <= seed < 2**64:
        raise InputError(f"{seed}, expected 0 to 2^64 - 1", field="seed")
    if not 0 <= step < 2**32:
        raise InputError(f"{step}, expected 0 to 2^32 - 1", field="step")
    return seed & 0xFFFFFFFF, seed >> 32, step
