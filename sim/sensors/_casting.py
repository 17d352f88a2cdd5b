"""A slow stand-in for `moteslam.kernels.raycast` until that is there."""

from __future__ import annotations

import numpy as np


def build_buckets(segments):  # type: ignore[no-untyped-def]
    return np.asarray(segments, np.float32)


def cast_rays(segments, origins, angles, *, max_range):  # type: ignore[no-untyped-def]
    best = np.full(len(angles), np.inf, np.float32)
    c, s = np.cos(angles).astype(np.float32), np.sin(angles).astype(np.float32)
    ox, oy = origins.astype(np.float32).T
    for x0, y0, x1, y1 in segments:
        ex, ey = x1 - x0, y1 - y0
        with np.errstate(divide="ignore", invalid="ignore"):
            inv = 1 / (c * ey - s * ex)
            rx, ry = x0 - ox, y0 - oy
            t = (rx * ey - ry * ex) * inv
            u = (rx * s - ry * c) * inv
            ok = (t >= 0) & (u >= 0) & (u <= 1) & (t < best)
        best[ok] = t[ok]
    best[best > max_range] = np.inf
    return best
