"""Endpoints held to other scans' surfaces, in plain Python, float64."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def match(points: Array, normals: Array, owners: Array, partners: Array, reach: float, agreement: float) -> Array:
    """As ``kernels.scan_pairs.match_endpoints``."""
    matches = np.full((len(points), partners.shape[1]), -1)
    for i, point in enumerate(points):
        if not normals[i].any():
            continue
        for slot, partner in enumerate(partners[owners[i]]):
            if partner < 0:
                continue
            near = np.flatnonzero((owners == partner) & (normals @ normals[i] > agreement))
            if len(near):
                distance = np.hypot(*(points[near] - point).T)
                if distance.min() < reach:
                    matches[i, slot] = near[distance.argmin()]
    return matches


def residuals(points: Array, normals: Array, owners: Array, poses: Array, matches: Array) -> Array:
    """The residual of every match [p, k] in the map frame, 0 where there is none."""

    def placed(k: int, vector: Array, *, moved: bool) -> Array:
        x, y, heading = poses[owners[k]]
        c, s = np.cos(heading), np.sin(heading)
        return np.array(((c, -s), (s, c))) @ vector + (np.array((x, y)) if moved else 0.0)

    result = np.zeros(matches.shape)
    for i, row in enumerate(matches):
        for slot, j in enumerate(row):
            if j >= 0:
                off = placed(i, points[i], moved=True) - placed(j, points[j], moved=True)
                result[i, slot] = placed(j, normals[j], moved=False) @ off
    return result


def cost(points: Array, normals: Array, owners: Array, poses: Array, matches: Array, scale: float) -> float:
    """The cost whose derivatives ``kernels.scan_pairs.accumulate`` sums."""
    r = residuals(points, normals, owners, poses, matches)
    share = 1 / np.sqrt(np.maximum((matches >= 0).sum(axis=1), 1))[:, None]
    square = np.square(r / scale)
    return float((0.5 * share * scale**2 * square / (1 + square)).sum())
