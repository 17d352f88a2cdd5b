"""The signed-distance kernels in plain Python, float64, on dense maps: thinning, integrating, reading, registering.

A map is a ``Tsdf``: what its cells hold, [H, W], distances in steps of 1/1023 truncation.
"""

from dataclasses import dataclass, field
from itertools import pairwise
from math import cos, exp, floor, hypot, sin
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

STEPS = 1023
DOUBT = 1e-4  # A cell whose centre is this near to a bound, in cells, may go either way in float32


@dataclass
class Tsdf:
    """A dense map.

    Attributes:
        steps: [H, W] distances.
        weights: [H, W]; 0 is never seen.
        doubtful: [H, W] whether rounding could decide differently about the cell.
    """

    steps: NDArray[np.int64]
    weights: NDArray[np.int64]
    doubtful: NDArray[np.bool_] = field(init=False)

    def __post_init__(self) -> None:
        self.doubtful = np.zeros(self.steps.shape, bool)

    @classmethod
    def empty(cls, rows: int, columns: int) -> Self:
        return cls(np.zeros((rows, columns), np.int64), np.zeros((rows, columns), np.int64))


def thin(
    ends: NDArray[np.float32], ends_joined: ArrayLike, spacing: float
) -> tuple[list[tuple[float, float]], list[int]]:
    """Thinned points, and whether each is joined to the next; sums in float32, like the kernel's."""
    points, joined = [], []
    group = list(ends[:1])
    for joined_before, end in zip(np.asarray(ends_joined)[:-1], ends[1:], strict=True):
        dx, dy = end - group[0]
        near = np.sqrt(dx * dx + dy * dy) < np.float32(spacing)
        if joined_before and near:
            group.append(end)
            continue
        points.append(_mean(group))
        joined.append(int(joined_before))
        group = [end]
    if group:
        points.append(_mean(group))
        joined.append(0)
    return points, joined


def _mean(group: list[NDArray[np.float32]]) -> tuple[float, float]:
    total = group[0]
    for point in group[1:]:
        total = total + point
    mean = total / np.float32(len(group))
    return float(mean[0]), float(mean[1])


def ends_joined(points: NDArray[np.float32], origin: ArrayLike, *, gap: float, gap_from_range: float) -> list[int]:
    """Whether each endpoint and the next lie on the same surface."""
    ends = [complex(x, y) for x, y in points]
    start = complex(*np.asarray(origin, float))
    found = []
    for here, there in pairwise(ends):
        allowed = gap + gap_from_range * max(abs(here - start), abs(there - start))
        found.append(int(abs(there - here) <= allowed))
    return [*found, 0] if ends else []


def integrate(
    tsdf: Tsdf, frame: ArrayLike, points: ArrayLike, joined: ArrayLike, *, truncation: float, near: float,
    near_weight: int, max_weight: int, chord: float = 0.0,
) -> None:  # fmt: skip
    """Average a scan's segments into a map; frame (cos, sin, x, y) and lengths in cells of the map.

    Segments are joined until from end to end they are ``chord`` long.
    """
    c, s, x, y = np.asarray(frame, float)
    world = [(c * a - s * b + x, s * a + c * b + y) for a, b in np.asarray(points, float)]
    follows = [bool(flag) for flag in np.asarray(joined)[:-1]] + [False]
    begin = 0
    for end in range(1, len(world)):
        if not follows[end - 1]:
            begin = end
            continue
        (ax, ay), (bx, by) = world[begin], world[end]
        length = hypot(bx - ax, by - ay)
        if length < chord and follows[end]:
            continue
        begin = end
        if length == 0:
            continue
        ux, uy = (bx - ax) / length, (by - ay) / length
        for iy in range(floor(min(ay, by) - truncation) - 1, floor(max(ay, by) + truncation) + 2):
            for ix in range(floor(min(ax, bx) - truncation) - 1, floor(max(ax, bx) + truncation) + 2):
                px, py = ix + 0.5 - ax, iy + 0.5 - ay
                along, across = px * ux + py * uy, ux * py - uy * px
                inside = (along + 0.25, length + 0.25 - along, truncation - abs(across))
                if min(inside) > -DOUBT and min(abs(min(inside)), abs(abs(across) - near)) < DOUBT:
                    tsdf.doubtful[iy, ix] = True
                if min(inside) > 0:
                    old, weight = tsdf.steps[iy, ix], int(tsdf.weights[iy, ix])
                    gain = near_weight if abs(across) < near else 1
                    mean = (old * weight + across / truncation * STEPS * gain) / (weight + gain)
                    tsdf.steps[iy, ix] = min(max(floor(mean + 0.5), -STEPS), STEPS)
                    tsdf.weights[iy, ix] = min(weight + gain, max_weight)


def bilinear(tsdf: Tsdf, x: float, y: float) -> tuple[float, float, float, bool]:
    """Distance [truncations], its gradient by x and y, and whether all four cells around (x, y) were seen."""
    ix, iy = floor(x - 0.5), floor(y - 0.5)
    fx, fy = x - 0.5 - ix, y - 0.5 - iy
    (d00, d10), (d01, d11) = tsdf.steps[iy : iy + 2, ix : ix + 2] / STEPS
    distance = (1 - fy) * ((1 - fx) * d00 + fx * d10) + fy * ((1 - fx) * d01 + fx * d11)
    dx, dy = (1 - fy) * (d10 - d00) + fy * (d11 - d01), (1 - fx) * (d01 - d00) + fx * (d11 - d10)
    return distance, dx, dy, bool(tsdf.weights[iy : iy + 2, ix : ix + 2].all())


def residual(
    tsdf: Tsdf, pose: ArrayLike, offset: ArrayLike, point: ArrayLike, *, cell_size: float, scale: float
) -> float | None:
    """Of an endpoint [m] seen from a pose moved by an offset in its frame; None over cells never seen.

    ``scale`` is the truncation in standard deviations.
    """
    (x, y, theta), (dx, dy, turn), (px, py) = (np.asarray(v, float) for v in (pose, offset, point))
    fx, fy = cos(turn) * px - sin(turn) * py + dx, sin(turn) * px + cos(turn) * py + dy
    gx, gy = x + cos(theta) * fx - sin(theta) * fy, y + sin(theta) * fx + cos(theta) * fy
    distance, _, _, known = bilinear(tsdf, gx / cell_size, gy / cell_size)
    return distance * scale if known else None


def normal_equations(
    tsdf: Tsdf, pose: ArrayLike, offset: ArrayLike, points: ArrayLike, *, cell_size: float, scale: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], list[float]]:
    """The sum of J J^T and of -J r over the endpoints, J by central differences, and the residuals r."""
    information, pull, residuals = np.zeros((3, 3)), np.zeros(3), []
    small = 1e-6
    for point in np.asarray(points, float):
        r = residual(tsdf, pose, offset, point, cell_size=cell_size, scale=scale)
        if r is None:
            continue
        jacobian = np.empty(3)
        for k in range(3):
            sides = []
            for sign in (1, -1):
                moved = np.array(offset, float)
                moved[k] += sign * small
                sides.append(residual(tsdf, pose, moved, point, cell_size=cell_size, scale=scale))
            jacobian[k] = (sides[0] - sides[1]) / (2 * small)
        information += np.outer(jacobian, jacobian)
        pull -= jacobian * r
        residuals.append(r)
    return information, pull, residuals


def fit(
    residuals: list[float], points: int, *, unknown: float, outlier: float, likelihood_width: float
) -> tuple[float, float, float]:
    """Cost, known endpoints and the sum of their likelihoods, for one level."""
    cost = sum(min(0.5 * r * r, outlier) for r in residuals) + unknown * (points - len(residuals))
    return cost, len(residuals), sum(exp(-0.5 * (r / likelihood_width) ** 2) for r in residuals)


def crossed(
    tsdf: Tsdf, pose: ArrayLike, origin: ArrayLike, points: ArrayLike, *, cell_size: float, truncation: float,
    clearance: float, weight: int, distance: float,
) -> int:  # fmt: skip
    """Rays from ``origin`` to the points that cross a surface of the map, looked for at six places of each.

    ``clearance`` and ``distance`` are in truncations. Half way from such a place to its end a ray has left the surface.
    """

    def near(place: NDArray[np.float64]) -> bool:
        ix, iy = np.floor(place / cell_size).astype(int)
        return bool(tsdf.weights[iy, ix] > weight and abs(tsdf.steps[iy, ix]) < distance * STEPS)

    x, y, theta = np.asarray(pose, float)
    turn = np.array([[cos(theta), -sin(theta)], [sin(theta), cos(theta)]])
    start, ends = turn @ np.asarray(origin, float) + (x, y), np.asarray(points, float) @ turn.T + (x, y)
    count = 0
    for end in ends:
        hits = []
        for share in (0.9, 0.75, 0.6, 0.45, 0.3, 0.15):
            place = start + share * (end - start)
            early = (1 - share) * np.hypot(*(end - start)) > clearance * truncation
            hits.append(early and near(place) and not near((place + end) / 2))
        count += any(hits)
    return count


def search(
    tsdf: Tsdf, pose: ArrayLike, points: ArrayLike, turns: ArrayLike, shifts: ArrayLike, *, cell_size: float,
    near: int,
) -> NDArray[np.int64]:  # fmt: skip
    """The score [turns, shifts] of each place on a coarse map, before costs; ``near`` in steps."""
    x, y, theta = np.asarray(pose, float)
    scores = np.zeros((len(np.asarray(turns)), len(np.asarray(shifts))), np.int64)
    rows, columns = tsdf.steps.shape
    for t, turn in enumerate(np.asarray(turns, float)):
        for v, (dx, dy) in enumerate(np.asarray(shifts, float)):
            for px, py in np.asarray(points, float):
                gx = x + cos(theta) * dx - sin(theta) * dy + cos(theta + turn) * px - sin(theta + turn) * py
                gy = y + sin(theta) * dx + cos(theta) * dy + sin(theta + turn) * px + cos(theta + turn) * py
                ix, iy = (min(max(floor(g / cell_size), 0), n - 1) for g, n in ((gx, columns), (gy, rows)))
                if tsdf.weights[iy, ix]:
                    scores[t, v] += max(near - abs(int(tsdf.steps[iy, ix])), -(near // 2))
    return scores
