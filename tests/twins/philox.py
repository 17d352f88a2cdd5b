"""Philox 4x32-10 and the normals drawn from it, in NumPy."""

import numpy as np
from numpy.typing import ArrayLike, NDArray


def philox(counters: ArrayLike, keys: ArrayLike) -> NDArray[np.uint32]:
    """Words [n, 4] of counters [n, 4] and keys [n, 2]."""
    c = [np.array(column, np.uint64) for column in np.atleast_2d(counters).T]
    k = [np.array(column, np.uint64) for column in np.atleast_2d(keys).T]
    word, low = np.uint64(32), np.uint64(0xFFFFFFFF)
    for _ in range(10):
        even, odd = c[0] * np.uint64(0xD2511F53), c[2] * np.uint64(0xCD9E8D57)
        c = [(odd >> word) ^ c[1] ^ k[0], odd & low, (even >> word) ^ c[3] ^ k[1], even & low]
        k = [(k[0] + np.uint64(0x9E3779B9)) & low, (k[1] + np.uint64(0xBB67AE85)) & low]
    return np.stack(c, axis=-1).astype(np.uint32)


def normals(seed: int, step: int, particles: int, stream: int) -> NDArray[np.float64]:
    """Four standard normals [particles, 4] for each particle."""
    counters = np.zeros((particles, 4), np.uint64)
    counters[:, 0], counters[:, 1], counters[:, 2] = step, np.arange(particles), stream
    keys = np.tile(np.array((seed & 0xFFFFFFFF, seed >> 32), np.uint64), (particles, 1))
    u = (philox(counters, keys) + 0.5) / 2.0**32
    radius, angle = np.sqrt(-2 * np.log(u[:, 0::2])), 2 * np.pi * u[:, 1::2]
    pairs = np.stack((radius * np.cos(angle), radius * np.sin(angle)), axis=-1)
    return np.asarray(pairs.reshape(particles, 4))
