"""Gauss-Newton on one level of a signed-distance map: the step that registration repeats, inside kernels."""

from moteslam.kernels.runtime import ti
from moteslam.kernels.tiles import bilinear
from moteslam.kernels.types import F32, I32, func, template

CONVERGED_SHIFT, CONVERGED_TURN = 3e-4, 1e-4
"""Gauss-Newton ends with a step below both, |x| + |y| [m] and |theta| [rad]: far less than a cell, which is all that
interpolated distances can resolve."""
COARSE_STEP = 10.0
"""On the coarse level it ends with a step this many times as long, since the fine level begins where it ended."""
LEAST_PIVOT = 1e-9
"""Keeps the square roots of the Cholesky factors real where rounding would not."""


@func
def solve(h: template, b: template):
    """The solution of a symmetric positive 3 x 3 system by Cholesky; h holds 00 01 02 11 12 22."""
    l00 = ti.sqrt(h[0])
    l10, l20 = h[1] / l00, h[2] / l00
    l11 = ti.sqrt(ti.max(h[3] - l10 * l10, LEAST_PIVOT))
    l21 = (h[4] - l20 * l10) / l11
    l22 = ti.sqrt(ti.max(h[5] - l20 * l20 - l21 * l21, LEAST_PIVOT))
    y0 = b[0] / l00
    y1 = (b[1] - l10 * y0) / l11
    y2 = (b[2] - l20 * y0 - l21 * y1) / l22
    x2 = y2 / l22
    x1 = (y1 - l21 * x2) / l11
    x0 = (y0 - l10 * x1 - l20 * x2) / l00
    return ti.Vector([x0, x1, x2], dt=ti.f32)


@func
def jacobian_of(frame: template, wx: F32, wy: F32, rx: F32, ry: F32):
    """Of a residual by the offset (x, y, theta).

    The residual's gradient is (wx, wy) in the map; the endpoint is (rx, ry) from the moved robot, in the frame.
    """
    jx, jy = frame[0] * wx + frame[1] * wy, -frame[1] * wx + frame[0] * wy
    return ti.Vector([jx, jy, jy * rx - jx * ry], dt=ti.f32)


@func
def square(j: template):
    """The outer product of a Jacobian with itself: 00 01 02 11 12 22."""
    return ti.Vector([j[0] * j[0], j[0] * j[1], j[0] * j[2], j[1] * j[1], j[1] * j[2], j[2] * j[2]], dt=ti.f32)


@func
def descend(
    pool: template, table: template, base: I32, columns: I32, last_x: F32, last_y: F32, frame: template,
    scan: template, points: I32, start: template, prior: template, cell: F32, truncation: F32, sd: F32, iterations: I32,
    level: template,
):  # fmt: skip
    """Gauss-Newton on one level. Returns the offset from the frame (x, y [m], theta), in the frame."""
    d = ti.Vector([start[0], start[1], start[2]], dt=ti.f32)
    inverse, scale = 1.0 / cell, truncation / sd
    slope = scale * inverse
    running = 1
    for _ in range(iterations):
        if running == 1:
            ct, st = ti.cos(d[2]), ti.sin(d[2])
            h = ti.Vector([prior[0], 0.0, 0.0, prior[1], 0.0, prior[2]], dt=ti.f32)
            b = ti.Vector(
                [-prior[0] * (d[0] - prior[3]), -prior[1] * (d[1] - prior[4]), -prior[2] * (d[2] - prior[5])], dt=ti.f32
            )
            for j in range(points):
                rx, ry = ct * scan[0, j] - st * scan[1, j], st * scan[0, j] + ct * scan[1, j]
                qx, qy = rx + d[0], ry + d[1]
                gx = (frame[0] * qx - frame[1] * qy) * inverse + frame[2] * inverse
                gy = (frame[1] * qx + frame[0] * qy) * inverse + frame[3] * inverse
                gx = ti.min(ti.max(gx, 1.0), last_x)
                gy = ti.min(ti.max(gy, 1.0), last_y)
                f = bilinear(pool, table, base, columns, gx, gy, level)
                if f[3] > 0:
                    r = f[0] * scale
                    jacobian = jacobian_of(frame, f[1] * slope, f[2] * slope, rx, ry)
                    h += square(jacobian)
                    b -= jacobian * r
            step = solve(h, b)
            d += step
            length = ti.static(COARSE_STEP if level == 1 else 1.0)
            if (
                ti.abs(step[0]) + ti.abs(step[1]) < length * CONVERGED_SHIFT
                and ti.abs(step[2]) < length * CONVERGED_TURN
            ):
                running = 0
    return d
