"""Whether a map is as large as the lidar measures, and as large in all directions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.se2 import Array
from moteslam.robot.values import Issue
from moteslam.slam.known_map.maps import KnownMaps

SPACING, MOST = 0.5, 256  # A scan is kept each so much path [m]; of so many every second, and the spacing doubles
POINTS = 128  # of a scan, evenly chosen
LEAST = 10  # Scans, at least; they are in as many parts of the path, as scans of one place err alike, ...
PARTS = 20  # ... at most in so many
SCALES = np.geomspace(0.5, 0.03, 20)
"""Cauchy's of the residuals [m], by iterations: a wrong scale displaces walls at first, cells at last; not people."""
SIGMAS, WRONG, BENT = 5.0, 0.01, 0.02
"""A scale is a map's fault at so many standard deviations, and where it is more than the second: lidars err by less.
Directions may differ by less than the third: walls of a sound SLAM map are turned by millimetres a metre."""
ALONG = 15.0  # A direction within as much of an axis is called that [degrees]


class MapScale:
    """The strain between a known map and the scans of a robot that is sure of its pose, by least squares.

    Endpoints lie ``(1 + strain) (p + offset u)`` from the robot's place, p being where the lidar says and u along the
    ray: the strain is symmetric, of which a stretch, a skew and a scale are cases; the offset is the thickness of walls
    as they are drawn. The poses of all scans are eliminated (Schur complement).
    """

    def __init__(self, maps: KnownMaps) -> None:
        self._maps, self._spacing, self._driven = maps, SPACING, SPACING
        self._scans: list[tuple[Array, Array, Array]] = []  # pose [3], endpoints and directions of their rays [k, 2]

    def add(self, pose: Array, points: NDArray[np.float32], origin: Array, driven: float, *, known: bool) -> None:
        """A scan [k, 2] whose rays start at an origin [2], from a pose [3] in the map; ``known`` if that is sure."""
        self._driven += driven
        if not known or self._driven < self._spacing or not len(points):
            return
        some = points[:: -(-len(points) // POINTS)].astype(float)
        rays = some - origin
        self._scans.append((pose.copy(), some, rays / np.maximum(np.hypot(*rays.T), 1e-6)[:, None]))
        self._driven = 0.0
        if len(self._scans) == MOST:
            self._scans, self._spacing = self._scans[::2], 2 * self._spacing

    def fit(self) -> tuple[Array, Array]:
        """The strain xx, yy, xy, the offset [m], and their covariance [4, 4]."""
        poses = np.array([scan[0] for scan in self._scans])
        points, rays = (np.concatenate([scan[k] for scan in self._scans]) for k in (1, 2))
        lengths = [len(scan[1]) for scan in self._scans]
        of, begin = np.repeat(np.arange(len(poses)), lengths), np.cumsum([0, *lengths[:-1]])
        strain, cells = np.zeros(4), self._maps.occupancy
        for scale in (*SCALES, SCALES[-1]):
            c, s = np.cos(poses[of, 2]), np.sin(poses[of, 2])
            (x, y), (u, v) = ((c * a - s * b, s * a + c * b) for a, b in (points.T, rays.T))
            xx, yy, xy, offset = strain
            at_x = poses[of, 0] + x + xx * x + xy * y + offset * u
            at_y = poses[of, 1] + y + xy * x + yy * y + offset * v
            residual, along, (n, m), known = self._maps.surface.lines(at_x, at_y)
            known &= np.abs(along) < cells.cell_size  # not beside a wall's end
            weight = known / (1 + np.square(residual / scale))
            row = np.stack((n, m, m * x - n * y, n * x, m * y, n * y + m * x, n * u + m * v, residual), axis=1)
            sums = np.add.reduceat(weight[:, None, None] * row[:, :7, None] * row[:, None], begin, axis=0)
            moved = np.linalg.solve(sums[:, :3, :3] + 1e-2 * np.eye(3), sums[:, :3, 3:])
            left = sums[:, 3:, 3:] - sums[:, :3, 3:7].swapaxes(1, 2) @ moved
            inverse = np.linalg.inv(left[..., :4].sum(axis=0) + 1e-6 * np.eye(4))
            change = -inverse @ left[..., 4].sum(axis=0)
            strain = strain + change
            poses = poses - moved[..., 4] - moved[..., :4] @ change
        parts = np.array([part.sum(axis=0) for part in np.array_split(left[..., 4], min(PARTS, len(left)))])
        spread = inverse @ parts.T
        covariance = spread @ spread.T * len(parts) / (len(parts) - 4)
        # Walls lie anywhere in their rows or columns of cells, each displaced as a whole
        steep = np.abs(n) >= np.abs(m)
        foot = np.where(steep, at_x - n * residual - cells.origin[0], at_y - m * residual - cells.origin[1])
        _, wall = np.unique(2 * np.floor(foot / cells.cell_size) + steep, return_inverse=True)
        force = weight[:, None] * (row[:, 3:7] - np.einsum("kp,kpg->kg", row[:, :3], moved[of, :, :4]))
        forces = np.array([np.bincount(wall, of_one) for of_one in force.T])
        spread = cells.cell_size / np.sqrt(12) * inverse @ forces
        return strain, covariance + spread @ spread.T

    def issue(self) -> Issue | None:
        """What is wrong with the map's scale, if it is certain."""
        if len(self._scans) < LEAST:
            return None
        strain, covariance = self.fit()
        stretch, skew = (strain[0] - strain[1]) / 2, strain[2]
        apart, turned = 2 * float(np.hypot(stretch, skew)), float(np.degrees(np.arctan2(skew, stretch)) / 2)
        of = np.array((stretch, -stretch, 2 * skew, 0.0)) / max(apart / 2, 1e-9)
        if apart > max(BENT, SIGMAS * float(np.sqrt(of @ covariance @ of))):
            text = f"along {turned:.0f} degrees to its x than across: skewed or bent"
            if min(abs(turned), 90 - abs(turned)) < ALONG:
                text = f"along {'x than along y' if abs(turned) < 45 else 'y than along x'}: stretched"
            text = f"the map is {100 * apart:.1f} % longer {text}, by what the lidar measures, and poses in it with it"
            return Issue("map-scale", text)
        weight = np.linalg.inv(covariance[:2, :2]).sum(axis=0)  # of each direction in the scale of both
        percent = 100 * float(weight @ strain[:2] / weight.sum())
        if abs(percent) < 100 * max(WRONG, SIGMAS * float(weight.sum() ** -0.5)):
            return None
        text = f"the map is {abs(percent):.1f} % {'larger' if percent > 0 else 'smaller'} than the lidar measures: its "
        text += "resolution is not as stated, and poses are wrong by as much, or the lidar's ranges are"
        return Issue("map-scale", text)
