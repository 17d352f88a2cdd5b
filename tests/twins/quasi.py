"""Scrambled Sobol points in NumPy: the bits by Python's own integers, the quantile by SciPy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from twins.philox import philox

FULL = 2**32 - 1
MULTIPLIERS = (0x6C50B47C, 0xB82F1E52, 0xC7AFE638, 0x8D22F6E6)


def scramble(word: int, seed: int) -> int:
    """Owen's scrambling of 32 bits, by Burley's hash of the bits in opposite order."""
    bits = (int(f"{word:032b}"[::-1], 2) + seed) & FULL
    for multiplier in MULTIPLIERS:
        bits ^= bits * multiplier & FULL
    return int(f"{bits:032b}"[::-1], 2)


def direction_numbers() -> list[list[int]]:
    """V[axis][k] = m_k 2^(32 - k - 1), by the textbook's recurrence over the odd m."""
    ones, second, third = [1] * 32, [1], [1, 3]
    for k in range(1, 32):
        second.append(2 * second[k - 1] ^ second[k - 1])
    for k in range(2, 32):
        third.append(2 * third[k - 1] ^ 4 * third[k - 2] ^ third[k - 2])
    return [[m << (31 - k) for k, m in enumerate(numbers)] for numbers in (ones, second, third)]


def sobol(index: int) -> list[int]:
    """The three coordinates of a point, in units of 2^-32."""
    point = [0, 0, 0]
    for axis, numbers in enumerate(direction_numbers()):
        for k in range(32):
            if index >> k & 1:
                point[axis] ^= numbers[k]
    return point


def even_normals(seed: int, step: int, particles: int, stream: int) -> NDArray[np.float64]:
    """Three standard normals [particles, 3] for each particle, spread evenly."""
    keys = philox([(step, 0, stream, 0)], [(seed & FULL, seed >> 32)])[0].tolist()
    words = [
        [scramble(word, keys[axis]) for axis, word in enumerate(sobol(scramble(particle, keys[3])))]
        for particle in range(particles)
    ]
    return np.asarray(ndtri((np.array(words, float).reshape(-1, 3) + 0.5) / 2.0**32))
