"""How the robot moves over the floor by the floor's colours: each particle's motion against maps of the floor.

A map of the floor belongs to a place, its *anchor*: one pose a particle, at which the map was begun. All in it lies
relative to that, and what a frame says of a particle is how the particle's own motion since then agrees with the
colours. So one map serves all particles, however far apart their paths lie, and no matter which of them is the best:
over the few metres for which a map is used, their motions differ by millimetres. No particle is judged by where
another one is, and none is bound to a path that a closing loop has proved wrong.

Frames go into the newest map for ``map_length``, and are compared with the one before it, which no longer changes: a
map that took in what is compared with it would follow its own errors. Older ones are dropped, so memory does not grow.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.se2 import Array
from moteslam.slam.inputs.camera import FloorView
from moteslam.slam.texture.floor_map import (
    FloorPatch,
    TextureConfig,
    TextureMap,
    TextureMapper,
    colour_errors,
    floor_patch,
    packed_map,
)
from moteslam.slam.tsdf.config import TsdfFilterConfig
from moteslam.slam.tsdf.motion import MotionSinceUpdate
from moteslam.slam.tsdf.particles import Particles
from moteslam.slam.tsdf.proposal import Proposal

FLAT = 1e-6  # Curvatures below this say nothing


@dataclass(eq=False)
class _FloorMap:
    """A map of the floor and where it was begun."""

    mapper: TextureMapper  # in the frame of the anchor
    anchors: Array  # [N, 3] of the particles
    distance: float = 0.0  # driven since [m]
    known: tuple[TextureMap, NDArray[np.int32]] | None = None  # as it stands, and packed, once it was asked for


def _square(steps: int, step: float) -> Array:
    """The shifts [n, 2] of a square lattice, ``steps`` to each side."""
    ticks = np.arange(-steps, steps + 1) * step
    return np.stack(np.meshgrid(ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 2)


def _peak(shifts: Array, values: Array) -> tuple[Array, Array] | None:
    """The top [2] of the quadratic that fits log-likelihoods [n] at shifts [n, 2] best, and its information [2, 2].

    Along a direction in which they do not fall, there is none.
    """
    x, y = shifts.T
    terms = np.column_stack((np.ones(len(x)), x, y, x * x / 2, x * y, y * y / 2))
    _, gx, gy, hxx, hxy, hyy = np.linalg.lstsq(terms, values, rcond=None)[0]
    information = -np.array(((hxx, hxy), (hxy, hyy)))
    if np.linalg.eigvalsh(information)[0] <= FLAT:
        return None
    return np.linalg.solve(information, np.array((gx, gy))), information


class FloorLikelihood:
    """Weighs particles by camera frames of the floor; without frames it changes nothing."""

    def __init__(self, config: TsdfFilterConfig) -> None:
        self._config, self._share = config.colours, config.proposal.information_share
        c = config.colours
        self._texture = config.texture.model_copy(update={"cell_size": c.cell_size, "max_depth": c.max_depth})
        self._maps: list[_FloorMap] = []
        self._view: FloorView | None = None  # the frame of this update
        self._since_frame = 0.0  # distance since the last frame [m]

    def read_frame(self, read: Callable[[float], FloorView | None] | None) -> None:
        """Read the newest frame for this update, if the run uses the camera."""
        self._view = None if read is None else read(self._config.largest_age)

    def refine(self, proposal: Proposal, since: MotionSinceUpdate, best: int) -> Proposal | None:
        """The proposal multiplied by what the floor measures of each particle's position.

        Lidar and odometry put a particle at a Gaussian of information A, the floor at another one, of information B,
        at an offset d: the mean of the product lies (A + B)^-1 B d away, and its integral, which is the particle's
        likelihood, falls with d^T (B - B (A + B)^-1 B) d / 2.

        Returns None without a frame, or if it measures nothing.
        """
        if self._view is None or not proposal.registered:
            return None
        registered = se2.compose(since.odometry, proposal.offsets[best])
        self._view = self._view.corrected(np.array(since.wheels), registered, since.travelled.elapsed)
        if (fit := self.fit(self._view, proposal.means, best)) is None:
            return None
        lidar = proposal.precision(self._share)
        off, information = fit
        gain = np.linalg.solve(lidar + information, np.broadcast_to(information, lidar.shape))
        inside = information - information @ gain
        return replace(
            proposal,
            offsets=se2.compose(proposal.offsets, np.einsum("nij,nj->ni", gain, off)),
            information=proposal.information + information / self._share,
            position_share=1.0,  # the floor tells particles apart where the lidar does not
            log_likelihood=-0.5 * np.einsum("ni,nij,nj->n", off, inside, off),
        )

    def integrate(self, particles: Particles, since: MotionSinceUpdate) -> None:
        """Write the frame of this update into the newest map of the floor, seen from the best particle."""
        self._since_frame += since.travelled.distance
        if self._view is not None:
            self.add(self._view, particles.poses, particles.best, self._since_frame)
            self._since_frame = 0.0

    def fit(self, view: FloorView, poses: Array, best: int) -> tuple[Array, Array] | None:
        """Where the floor puts the particles, which the lidar puts at poses [N, 3] at the scan.

        Returns:
            [N, 3] the offsets from each pose to there, in its frame, without a turn; and their information [3, 3], zero
            where the floor says nothing. None if the frame does not lie on known floor, where it fits nowhere within
            reach, or where it looks the same everywhere.
        """
        if not self._maps:
            return None
        target = self._maps[0]
        moved = se2.between(target.anchors, poses)
        patch = floor_patch(view.frame, view.mount, self._flat(view), max_depth=self._config.max_depth)
        if (found := self._search(patch, target, moved[best], view.place)) is None:
            return None
        shift, information = found
        offsets = se2.between(moved, se2.compose(moved[best], np.append(shift, 0.0)))
        offsets[:, 2] = 0.0
        whole = np.zeros((3, 3))
        whole[:2, :2] = information
        return offsets, whole

    def add(self, view: FloorView, poses: Array, best: int, travelled: float) -> None:
        """Write a frame into the newest map along the best particle's motion, or begin the next with it.

        ``poses`` [N, 3] are of the particles at the scan; the robot travelled so far since the frame before [m].
        """
        if self._maps:
            self._maps[-1].distance += travelled
        if not self._maps or self._maps[-1].distance >= self._config.map_length:
            reach = 2 * self._config.map_length + 1.5 * self._config.max_depth
            corner = np.array((reach, reach))
            newest = _FloorMap(TextureMapper(view.mount, self._flat(view), -corner, corner), poses.copy())
            self._maps = [*self._maps[-1:], newest]
        floor = self._maps[-1]
        moved = se2.between(floor.anchors[best], poses[best])
        floor.mapper.add(view.frame, se2.compose(moved, view.place))
        floor.known = None

    def resample(self, parents: NDArray[np.int64]) -> None:
        """Particles [M] live on as the children of these."""
        for floor in self._maps:
            floor.anchors = floor.anchors[parents]

    def _flat(self, view: FloorView) -> TextureConfig:
        """The floor as flat: unlike depths, it has no error. A camera that is as low as what counts as floor cannot."""
        return self._texture.model_copy(update={"flat": view.mount.z > self._texture.height_limit})

    def _search(self, patch: FloorPatch, target: _FloorMap, moved: Array, place: Array) -> tuple[Array, Array] | None:
        """The shift [2] of a motion [3] that fits best, in its frame, and its information [2, 2]."""
        if target.known is None:
            snapshot = target.mapper.snapshot()
            target.known = snapshot, packed_map(snapshot)
        (texture, packed), c = target.known, self._config

        def log_likelihood(shifts: Array) -> tuple[Array, NDArray[np.int64]]:
            turned = np.column_stack((shifts, np.zeros(len(shifts))))
            poses = se2.compose(se2.compose(moved, turned), place)
            error, known = colour_errors(patch, poses, texture, limit=c.limit, packed=packed)
            return -c.share * known.max() * error / c.spread, known

        shifts = _square(int(np.ceil(c.reach / c.coarse_step)), c.coarse_step)
        values, known = log_likelihood(shifts)
        if known.min() < c.least_known * len(patch.points) or not len(patch.points):
            return None
        start = shifts[values.argmax()]
        if np.abs(start).max() >= c.reach:
            return None
        around = max(round(c.coarse_step / c.fine_step) - 1, 1)  # as far as to the next coarse ones
        fine = _square(around, c.fine_step)
        values, _ = log_likelihood(start + fine)
        centre = fine[values.argmax()]
        if (found := _peak(fine, values)) is None:
            return None
        shift, information = found
        shift = np.clip(shift, centre - c.fine_step * around, centre + c.fine_step * around)
        # the floor's offset is never more certain than its camera's mount, whatever the colours
        covariance = np.linalg.inv(information) + c.spread_translation**2 * np.eye(2)
        return start + shift, np.asarray(np.linalg.inv(covariance))
