"""Sampling the motion model: every particle moves by the same increment and noise of its own.

The noise is counter-based: Philox 4x32-10 (Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", 2011). A draw
depends on (seed; step, particle, stream) alone: the counter is (step, particle, stream, 0), the key (seed mod 2^32,
seed div 2^32). Written by hand, since NumPy's Philox is 4x64, and ``ti.random`` depends on the threads.

The poses are float64: a path is a sum of many thousand increments of millimetres at coordinates of hundreds of
metres, where float32 would round each of them by up to 0.03 mm, in the same direction for as long as the robot does
not turn.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.kernels.checks import as_finite, check_array
from moteslam.kernels.runtime import one_thread, ti
from moteslam.kernels.types import F64, F64_2D, U32, func, kernel

ROUNDS = 10
MULTIPLIERS = (0xD2511F53, 0xCD9E8D57)
WEYL = (0x9E3779B9, 0xBB67AE85)
STREAM = 1  # The stream of random numbers that is motion's; other uses of the same seed and step take others
PI, TWO_PI = math.pi, 2 * math.pi


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
        # summed in 64 bits, cut to 32: the overflow is meant, and no bounds check may see it
        low, high = ti.cast(k[0], ti.u64) + ti.u64(WEYL[0]), ti.cast(k[1], ti.u64) + ti.u64(WEYL[1])
        k = ti.Vector([ti.cast(low, ti.u32), ti.cast(high, ti.u32)], dt=ti.u32)
    return c


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


@func
def wrap(angle: F64):
    """The angle [rad] wrapped to (-pi, pi]."""
    turns = ti.ceil((angle - ti.f64(PI)) / ti.f64(TWO_PI))
    wrapped = angle - turns * ti.f64(TWO_PI)
    # rounding can leave the quotient one turn off at the very edge
    if wrapped <= ti.f64(-PI):
        wrapped += ti.f64(TWO_PI)
    if wrapped > ti.f64(PI):
        wrapped -= ti.f64(TWO_PI)
    return wrapped


@func
def compose(a, b):
    """The pose b, given in the frame of a, expressed where a is: a (+) b."""
    c, s = ti.cos(a[2]), ti.sin(a[2])
    return ti.Vector([a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], wrap(a[2] + b[2])], dt=ti.f64)


@kernel
def _sample_motion(
    poses: F64_2D, forward: F64, left: F64, turn: F64, spread_forward: F64, spread_left: F64, spread_turn: F64,
    seed_low: U32, seed_high: U32, step: U32,
):  # fmt: skip
    ti.loop_config(serialize=ti.static(one_thread()))
    for i in range(poses.shape[0]):
        counter = ti.Vector([step, ti.cast(i, ti.u32), ti.u32(STREAM), ti.u32(0)], dt=ti.u32)
        noise = normals(philox(counter, ti.Vector([seed_low, seed_high], dt=ti.u32)))
        pose = ti.Vector([poses[i, 0], poses[i, 1], poses[i, 2]], dt=ti.f64)
        increment = ti.Vector(
            [forward + spread_forward * noise[0], left + spread_left * noise[1], turn + spread_turn * noise[2]],
            dt=ti.f64,
        )
        moved = compose(pose, increment)
        for j in ti.static(range(3)):
            poses[i, j] = moved[j]


def sample_motion(poses: NDArray[np.float64], motion: ArrayLike, spread: ArrayLike, *, seed: int, step: int) -> None:
    """Move every pose by ``motion + eps``, eps ~ N(0, diag(spread^2)), in the frame of the pose; in place.

    The motion model of Probabilistic Robotics, table 5.6, in its general form: the caller's model gives the increment
    and its spread. The same seed and step give the same bits on any number of threads.

    Args:
        poses: float64 [N, 3] (x [m], y [m], theta [rad]); theta leaves in (-pi, pi].
        motion: [3] forward [m], left [m], turn [rad].
        spread: [3] the standard deviation of each, not negative.
        seed: 0 to 2^64 - 1.
        step: 0 to 2^32 - 1; a different one for each call with the same seed.
    """
    check_array("poses", poses, np.float64, (None, 3), written=True)
    motion = as_finite("motion", motion, np.float64, (3,))
    spread = as_finite("spread", spread, np.float64, (3,))
    if len(poses):
        _sample_motion(poses, *motion.tolist(), *spread.tolist(), seed & 0xFFFFFFFF, seed >> 32, step)
