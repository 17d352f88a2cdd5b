"""From ranges to endpoints in the robot's frame, of many scans in one launch, de-skewed where the sweep is known."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.kernels.checks import as_finite, check_array
from moteslam.kernels.runtime import one_thread, runtime, ti
from moteslam.kernels.types import F32, F32_2D, F64, F64_2D, I32_1D, kernel

NOT_FINITE = 0x7F800000
"""The bits of the exponent, all set in an infinite float32 and in NaN: compiled for speed, comparisons take every
number for a finite one."""


@kernel
def _project(
    ranges: F32_2D, directions: F64_2D, sweeps: F64_2D, origin_x: F64, origin_y: F64, max_range: F32, points: F32_2D,
    counts: I32_1D,
):  # fmt: skip
    """The endpoints of scan i are ``counts[i]`` rows of ``points`` from row i * beams on."""
    beams = ranges.shape[1]
    ti.loop_config(block_dim=1, serialize=ti.static(one_thread()))
    for i in range(ranges.shape[0]):
        # the robot's turn at a beam is that at the beam before, turned on by the same angle
        turn = sweeps[i, 2] / ti.max(beams - 1, 1)
        step_x, step_y = sweeps[i, 0] / ti.max(beams - 1, 1), sweeps[i, 1] / ti.max(beams - 1, 1)
        cos_step, sin_step = ti.cos(turn), ti.sin(turn)
        cos, sin = ti.cast(1.0, ti.f64), ti.cast(0.0, ti.f64)
        out = i * beams
        for k in range(beams):
            measured = ranges[i, k]
            if ti.bit_cast(measured, ti.i32) & NOT_FINITE != NOT_FINITE and measured <= max_range:
                x = origin_x + ti.cast(measured, ti.f64) * directions[k, 0]
                y = origin_y + ti.cast(measured, ti.f64) * directions[k, 1]
                points[out, 0] = ti.cast(cos * x - sin * y + k * step_x, ti.f32)
                points[out, 1] = ti.cast(sin * x + cos * y + k * step_y, ti.f32)
                out += 1
            cos, sin = cos * cos_step - sin * sin_step, sin * cos_step + cos * sin_step
        counts[i] = out - i * beams


def project_scans(
    ranges: ArrayLike,
    directions: ArrayLike,
    origin: ArrayLike,
    *,
    sweeps: ArrayLike | None = None,
    max_range: float = math.inf,
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """The finite endpoints of scans, in the robot's frame at the first beam of each.

    A beam is moved by its share of the motion during the sweep, in x, y and turn each, as ``Scans.points`` moves it.

    Args:
        ranges: float32 [m, b] [m]; what is infinite or NaN has no endpoint.
        directions: [b, 2] unit vectors of the beams in the robot's frame.
        origin: [2] where the rays start [m].
        sweeps: [m, 3] how the robot moves from the first beam to the last; None where that is not known.
        max_range: endpoints beyond it are left out [m].

    Returns:
        points: float32 [m * b, 2] [m]; those of scan i begin in row i * b.
        counts: int32 [m] how many they are.

    Raises:
        InputError: arrays that do not fit together, numbers that are not finite, or a ``max_range`` not above 0.
    """
    given = check_array("ranges", np.ascontiguousarray(ranges), np.float32, (None, None))
    scans, beams = given.shape
    along = as_finite("directions", directions, np.float64, (beams, 2))
    start_x, start_y = (float(v) for v in as_finite("origin", origin, np.float64, (2,)))
    moved = as_finite("sweeps", np.zeros((scans, 3)) if sweeps is None else sweeps, np.float64, (scans, 3))
    if not max_range > 0:
        raise InputError(f"{max_range:g} m, expected above 0", field="max_range")
    points, counts = np.empty((scans * beams, 2), np.float32), np.zeros(scans, np.int32)
    runtime()
    if given.size:
        reach = min(max_range, float(np.finfo(np.float32).max))
        _project(given, along, moved, start_x, start_y, reach, points, counts)
    return points, counts
