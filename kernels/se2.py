"""SE(2) inside kernels, in float64: poses as ti.Vector (x [m], y [m], theta [rad]). robot/se2.py is the reference."""

import math

from moteslam.kernels.runtime import ti
from moteslam.kernels.types import F64, func

PI = math.pi
TWO_PI = 2 * math.pi


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
