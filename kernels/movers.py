"""Rays against moving discs and lines, each where it is at the ray's time.

Movers are given at a constant rate and interpolated linearly. Every ray tests all of them: a scenario has a few dozen.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.kernels.checks import as_finite, check_array
from moteslam.kernels.raycast import cos_sin
from moteslam.kernels.runtime import one_thread, runtime, ti
from moteslam.kernels.types import F32, F32_1D, F32_2D, F64_1D, F64_2D, I32, I32_1D, kernel


@kernel
def _cast_movers(
    discs: F32_2D, lines: F32_2D, last: I32, disc_count: I32, line_count: I32, rate: F32, origins: F64_2D,
    angles: F64_1D, times: F64_1D, out: F32_1D, hit: I32_1D,
):  # fmt: skip
    ti.loop_config(serialize=ti.static(one_thread()))
    for i in range(out.shape[0]):
        at = ti.min(ti.max(times[i] * ti.cast(rate, ti.f64), 0.0), ti.cast(last, ti.f64))
        row = ti.min(ti.cast(at, ti.i32), last - 1)
        share = ti.cast(at - ti.cast(row, ti.f64), ti.f32)
        ox, oy = ti.cast(origins[i, 0], ti.f32), ti.cast(origins[i, 1], ti.f32)
        cosine, sine = cos_sin(angles[i])
        c, s = ti.cast(cosine, ti.f32), ti.cast(sine, ti.f32)
        found = out[i]
        nearest = -1
        for k in range(disc_count):
            a, b = row * disc_count + k, (row + 1) * disc_count + k
            x = discs[a, 0] + share * (discs[b, 0] - discs[a, 0]) - ox
            y = discs[a, 1] + share * (discs[b, 1] - discs[a, 1]) - oy
            radius = discs[a, 2]
            side, along = c * y - s * x, c * x + s * y
            if abs(side) <= radius:
                half = ti.sqrt(radius * radius - side * side)
                distance = along - half
                if distance < ti.f32(0.0) and along + half >= ti.f32(0.0):
                    distance = ti.f32(0.0)  # from inside
                if ti.f32(0.0) <= distance and distance < found:
                    found = distance
                    nearest = k
        for k in range(line_count):
            a, b = row * line_count + k, (row + 1) * line_count + k
            x0 = lines[a, 0] + share * (lines[b, 0] - lines[a, 0]) - ox
            y0 = lines[a, 1] + share * (lines[b, 1] - lines[a, 1]) - oy
            x1 = lines[a, 2] + share * (lines[b, 2] - lines[a, 2]) - ox
            y1 = lines[a, 3] + share * (lines[b, 3] - lines[a, 3]) - oy
            side0, side1 = c * y0 - s * x0, c * y1 - s * x1
            if side0 * side1 <= ti.f32(0.0) and side0 != side1:
                along0, along1 = c * x0 + s * y0, c * x1 + s * y1
                distance = along0 + side0 / (side0 - side1) * (along1 - along0)
                if ti.f32(0.0) <= distance and distance < found:
                    found = distance
                    nearest = disc_count + k
        out[i] = found
        hit[i] = nearest


def cast_movers(
    discs: NDArray[np.float32],
    lines: NDArray[np.float32],
    rate: float,
    origins: ArrayLike,
    angles: ArrayLike,
    times: ArrayLike,
    ranges: NDArray[np.float32],
) -> NDArray[np.int32]:
    """Shorten the rays that meet a mover before the wall.

    Coordinates are float32: keep the world within 1000 m of its origin, where a place is off by at most 0.03 mm.

    Args:
        discs: float32 [t, k, 3] x, y, radius of k discs [m].
        lines: float32 [t, m, 4] x0, y0, x1, y1 of m lines [m].
        rate: of the poses [Hz], the first at time 0.
        origins: [n, 2] of the rays [m].
        angles: [n] their directions [rad].
        times: [n] of the rays [s]; before the first pose and after the last the movers stand still.
        ranges: float32 [n] of the rays to the walls [m], shortened in place.

    Returns:
        int32 [n]: index of the disc that each ray meets, or k + index of the line, or -1.
    """
    origins = as_finite("origins", origins, np.float64, (None, 2))
    angles = as_finite("angles", angles, np.float64, (len(origins),))
    times = as_finite("times", times, np.float64, (len(origins),))
    check_array("ranges", ranges, np.float32, (len(origins),), written=True)
    steps, count = discs.shape[:2]
    discs = as_finite("discs", discs.reshape(-1, 3), np.float32, (None, 3))
    if len(lines) != steps or steps < 2:
        raise InputError(
            f"{steps} poses of discs, {len(lines)} of lines, expected as many, two at least", field="lines"
        )
    leaves = lines.shape[1]
    lines = as_finite("lines", lines.reshape(-1, 4), np.float32, (None, 4))
    hit = np.full(len(origins), -1, np.int32)
    runtime()
    if len(origins) and count + leaves:
        one = np.zeros((1, 4), np.float32)  # Taichi takes no empty array
        _cast_movers(
            discs if count else one[:, :3].copy(), lines if leaves else one, steps - 1, count, leaves, float(rate),
            origins, angles, times, ranges, hit,
        )  # fmt: skip
    return hit
