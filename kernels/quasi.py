"""Points that cover the cube evenly, and normals made of them: noise of which 100 draws leave no gaps.

The points are Sobol's in three dimensions, scrambled as Owen does: every draw by itself is uniform and depends on
the seed, but of the first 2^k particles exactly one falls into each of 2^k equal slices of every axis, and so for any
aligned block of 2^k particles. The order is scrambled in the same nested way, so that two particles far apart
in number are not neighbours step after step, while brothers that resampling puts side by side are sent apart.

Sobol, "On the distribution of points in a cube" (1967); Owen, "Randomly permuted (t,m,s)-nets" (1995); the scrambling
by a hash is that of Burley, "Practical hash-based Owen scrambling" (2020).
"""

from moteslam.kernels import rng
from moteslam.kernels.runtime import ti
from moteslam.kernels.types import F64, U32, func, template

HASH = (0x6C50B47C, 0xB82F1E52, 0xC7AFE638, 0x8D22F6E6)
"""Even multipliers of Burley's permutation: a bit is changed by lower bits alone."""

CENTRE = (
    (3.3871327179, 50.434271938, 159.29113202, 59.109374720),
    (1.0, 17.895169469, 78.757757664, 67.187563600),
)
BODY = ((1.4234372777, 2.7568153900, 1.3067284816, 0.17023821103), (1.0, 0.73700164250, 0.12021132975))
TAIL = (
    (6.6579051150, 3.0812263860, 0.42868294337, 0.017337203997),
    (1.0, 0.24197894225, 0.012258202635),
)
"""Numerators and denominators, lowest power first, of the quantile of the normal distribution (Wichura, algorithm AS
241, 1988, PPND7) near the middle, further out and beyond e^-25."""


@func
def reverse_bits(word: U32):
    """The bits of a u32 in opposite order."""
    bits = word
    for shift, mask in ti.static(((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF))):
        bits = ((bits >> ti.u32(shift)) & ti.u32(mask)) | ((bits & ti.u32(mask)) << ti.u32(shift))
    return (bits >> ti.u32(16)) | (bits << ti.u32(16))


@func
def scramble(word: U32, seed: U32):
    """Owen's nested scrambling of a u32: each bit flipped or not by the bits above it and the seed."""
    low = ti.u64(0xFFFFFFFF)
    bits = (ti.cast(reverse_bits(word), ti.u64) + ti.cast(seed, ti.u64)) & low
    for factor in ti.static(HASH):
        bits ^= (bits * ti.u64(factor)) & low
    return reverse_bits(ti.cast(bits, ti.u32))


@func
def sobol(index: U32):
    """The coordinates (ti.Vector of 3 u32, in units of 2^-32) of one of Sobol's points.

    Direction numbers of the first axis (van der Corput) and of the polynomials x + 1 and x^2 + x + 1, first numbers
    1 and 1, 3.
    """
    point = ti.Vector([0, 0, 0], dt=ti.u32)
    first, second = ti.u32(1 << 31), ti.u32(1 << 31)
    third, after = ti.u32(1 << 31), ti.u32(3 << 30)
    rest = index
    while rest != 0:
        if rest & ti.u32(1):
            point[0] ^= first
            point[1] ^= second
            point[2] ^= third
        rest = rest >> ti.u32(1)
        first = first >> ti.u32(1)
        second ^= second >> ti.u32(1)
        third, after = after, after ^ third ^ (third >> ti.u32(2))
    return point


@func
def even_words(seed_low: U32, seed_high: U32, step: U32, particle: U32, stream: U32):
    """Three words (ti.Vector of u32) of this particle, that lie evenly over the particles of a step and stream."""
    keys = rng.words_of(seed_low, seed_high, step, ti.u32(0), stream)
    point = sobol(scramble(particle, keys[3]))
    for axis in ti.static(range(3)):
        point[axis] = scramble(point[axis], keys[axis])
    return point


@func
def _ratio(x: F64, above: template, below: template):
    """One polynomial over another, coefficients from the lowest power."""
    top, bottom = ti.f64(0.0), ti.f64(0.0)
    for c in ti.static(above[::-1]):
        top = top * x + ti.f64(c)
    for c in ti.static(below[::-1]):
        bottom = bottom * x + ti.f64(c)
    return top / bottom


@func
def normal(word: U32):
    """The standard normal (f64) that a u32 stands for: the quantile of ``rng.uniform``, to 1 part in 10^7."""
    p = rng.uniform(word)
    q = p - ti.f64(0.5)
    value = ti.f64(0.0)
    if ti.abs(q) <= ti.f64(0.425):
        value = q * _ratio(ti.f64(0.180625) - q * q, CENTRE[0], CENTRE[1])
    else:
        r = ti.sqrt(-ti.log(ti.min(p, ti.f64(1.0) - p)))
        if r <= ti.f64(5.0):
            value = _ratio(r - ti.f64(1.6), BODY[0], BODY[1])
        else:
            value = _ratio(r - ti.f64(5.0), TAIL[0], TAIL[1])
        if q < 0:
            value = -value
    return value
