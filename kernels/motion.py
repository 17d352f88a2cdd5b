"""Sampling the motion model: every particle moves by the same increment and noise of its own.

The poses are float64: a path is a sum of many thousand increments of millimetres at coordinates of hundreds of
metres, where float32 would round each of them by up to 0.03 mm, in the same direction for as long as the robot does
not turn.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.kernels import rng, se2
from moteslam.kernels.checks import as_finite, check_array
from moteslam.kernels.runtime import one_thread, runtime, ti
from moteslam.kernels.types import F64, F64_2D, U32, kernel

STREAM = 1
"""The stream of random numbers that belongs to motion; other uses of the same seed and step take other streams."""


@kernel
def _sample_motion(
    poses: F64_2D, forward: F64, left: F64, turn: F64, spread_forward: F64, spread_left: F64, spread_turn: F64,
    seed_low: U32, seed_high: U32, step: U32, stream: U32,
):  # fmt: skip
    ti.loop_config(serialize=ti.static(one_thread()))
    for i in range(poses.shape[0]):
        noise = rng.normals(rng.words_of(seed_low, seed_high, step, ti.cast(i, ti.u32), stream))
        pose = ti.Vector([poses[i, 0], poses[i, 1], poses[i, 2]], dt=ti.f64)
        increment = ti.Vector(
            [
                forward + spread_forward * noise[0],
                left + spread_left * noise[1],
                turn + spread_turn * noise[2],
            ],
            dt=ti.f64,
        )
        moved = se2.compose(pose, increment)
        for j in ti.static(range(3)):
            poses[i, j] = moved[j]


def sample_motion(
    poses: NDArray[np.float64], motion: ArrayLike, spread: ArrayLike, *, seed: int, step: int, stream: int = STREAM
) -> None:
    """Move every pose by ``motion + eps``, eps ~ N(0, diag(spread^2)), in the frame of the pose; in place.

    The motion model of Probabilistic Robotics, table 5.6, in its general form: the caller's model gives the increment
    and its spread. The same seed and step give the same bits on any number of threads.

    Args:
        poses: float64 [N, 3] (x [m], y [m], theta [rad]); theta leaves in (-pi, pi].
        motion: [3] forward [m], left [m], turn [rad].
        spread: [3] the standard deviation of each, not negative.
        seed: 0 to 2^64 - 1.
        step: 0 to 2^32 - 1; a different one for each call with the same seed.
        stream: 0 to 2^32 - 1; of the random numbers.

    Raises:
        InputError: a shape, type or value other than these.
    """
    check_array("poses", poses, np.float64, (None, 3), written=True)
    motion = as_finite("motion", motion, np.float64, (3,))
    spread = as_finite("spread", spread, np.float64, (3,))
    if (spread < 0).any():
        raise InputError(f"{spread.min()}, expected no negative standard deviation", field="spread")
    words = rng.seed_words(seed, step)
    if not 0 <= stream < 2**32:
        raise InputError(f"{stream}, expected 0 to 2^32 - 1", field="stream")
    runtime()
    if len(poses):
        _sample_motion(poses, *motion.tolist(), *spread.tolist(), *words, stream)
