"""Sessions of one building: what is kept of each, so that others can be bound to it, and the map of all of them."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.scans import ThinnedScan, thin_scans
from moteslam.robot import se2
from moteslam.robot.raster import Raster
from moteslam.robot.se2 import Array
from moteslam.robot.trajectory import PoseGraph, Trajectory
from moteslam.robot.values import Summarised
from moteslam.slam.backend.graph.pose_graph import Edges, MeasuredChain
from moteslam.slam.inputs.config import ThinningConfig
from moteslam.slam.inputs.scans import Scans
from moteslam.slam.mapping.config import MapConfig
from moteslam.slam.mapping.occupancy import OccupancyGrid


class Measured(NamedTuple):
    """What a back end has measured of one recording."""

    nodes: NDArray[np.int64]  # [n] which of its scans are nodes of the graph
    chain: MeasuredChain  # the steps between these
    loops: Edges  # that were accepted


@dataclass(frozen=True, eq=False, repr=False)
class Session(Summarised):
    """One recording, as the back end has left it."""

    stamps: Array  # [s] of its scans [s]
    path: Array  # [s, 3] where they were taken
    nodes: NDArray[np.int64]  # [n] which of them are nodes of the graph
    chain: MeasuredChain  # the steps between these, as measured
    points: NDArray[np.float32]  # float32 [p, 2] endpoints of the nodes' scans in the robot's frame [m], scan by scan
    counts: NDArray[np.int32]  # int32 [n] how many are of each
    origin: Array  # [2] where the rays start, in that frame [m]
    drawn: NDArray[np.bool_]  # [n] whether the map is drawn of them: not of a path that lies nobody knows where

    def __len__(self) -> int:
        return len(self.nodes)

    @property
    def trajectory(self) -> Trajectory:
        """A pose at every scan."""
        return Trajectory(self.stamps, self.path)

    @property
    def begins(self) -> NDArray[np.int32]:
        """[n] the first endpoint of each node's scan."""
        return np.asarray(np.cumsum(self.counts, dtype=np.int32) - self.counts)

    def at(self, poses: Array) -> Self:
        """The session with its nodes at poses [n, 3]; the scans between them move with these."""
        return replace(self, path=between_known(poses, self.nodes, self.path))

    def thinned(self, config: ThinningConfig, farthest: float) -> list[ThinnedScan]:
        """The nodes' scans as they are registered: endpoints nearer than ``farthest`` to the sensor [m]."""
        near = np.hypot(*(self.points - self.origin).T) < farthest
        counts = np.add.reduceat(np.r_[near, 0], self.begins).astype(np.int32) * (self.counts > 0)
        begins = np.cumsum(counts, dtype=np.int32) - counts
        return thin_scans(self.points[near], begins, counts, self.origin, **vars(config))

    def _summary(self) -> str:
        return f"{len(self)} nodes, {self.trajectory._summary()}"


@dataclass(frozen=True, eq=False, repr=False)
class Building(Summarised):
    """Sessions in one frame."""

    sessions: tuple[Session, ...]  # in the order in which they came to it
    loops: Edges  # that were accepted, within and between them, of nodes that are numbered through all sessions

    @classmethod
    def of(cls, measured: Measured, path: Trajectory, scans: Scans, drawn: NDArray[np.bool_]) -> Self:
        """One session of n nodes, with a pose at every scan; ``drawn`` [n] as of ``Session``."""
        seen = [scans.points(int(node)) for node in measured.nodes]
        counts = np.array([len(points) for points in seen], np.int32)
        points = np.concatenate(seen)
        arrays = (measured.nodes, measured.chain, points, counts, scans.origin, drawn)
        return cls((Session(path.stamps, path.poses, *arrays),), measured.loops)

    @cached_property
    def firsts(self) -> NDArray[np.int64]:
        """[k + 1] the number of the first node of each session, and that of all nodes."""
        return np.concatenate(([0], np.cumsum([len(session) for session in self.sessions])))

    @property
    def poses(self) -> Array:
        """[n, 3] of all nodes."""
        return np.concatenate([session.path[session.nodes] for session in self.sessions])

    @property
    def chain(self) -> MeasuredChain:
        ends, poses = self.firsts[1:-1], self.poses
        gaps = se2.between(poses[ends - 1], poses[ends]).reshape(-1, 3)
        return MeasuredChain.of_sessions([session.chain for session in self.sessions], gaps)

    @property
    def between(self) -> NDArray[np.bool_]:
        """Which loops bind two sessions."""
        of = np.searchsorted(self.firsts, (self.loops.first, self.loops.second), side="right")
        return np.asarray(of[0] != of[1])

    @property
    def graph(self) -> PoseGraph:
        inner = np.delete(np.arange(self.firsts[-1] - 1), self.firsts[1:-1] - 1)
        chain, loops = self.chain, self.loops
        information = np.concatenate((np.linalg.inv(chain.covariance[inner]), loops.information))
        return PoseGraph(
            ids=np.arange(self.firsts[-1]),
            poses=self.poses,
            first=np.r_[inner, loops.first],
            second=np.r_[inner + 1, loops.second],
            relative=np.concatenate((chain.steps[inner], loops.relative)),
            information=(information + np.swapaxes(information, 1, 2)) / 2,  # inverses are symmetric but for rounding
            stamps=self.sessions[0].stamps[self.sessions[0].nodes] if len(self.sessions) == 1 else None,
            fixed=np.zeros(1, np.int64),
        )

    def at(self, poses: Array) -> Self:
        """The building with all nodes at poses [n, 3]."""
        each = zip(self.sessions, np.split(poses, self.firsts[1:-1]), strict=True)
        return replace(self, sessions=tuple(one.at(part) for one, part in each))

    def plus(self, other: "Building") -> "Building":
        """The building with the sessions of another one, in its frame; nothing binds the two yet."""
        first, second = (ends + self.firsts[-1] for ends in (other.loops.first, other.loops.second))
        return Building(
            self.sessions + other.sessions, self.loops.plus(replace(other.loops, first=first, second=second))
        )

    @property
    def by_age(self) -> list[int]:
        """The numbers of the sessions, the oldest first.

        A session is older than those that began after it ended. Where stamps overlap, they are of clocks that nothing
        relates: then the one that came later to the building is newer.
        """
        order: list[int] = []
        for number, session in enumerate(self.sessions):
            later = (k for k, one in enumerate(order) if self.sessions[one].stamps[0] > session.stamps[-1])
            order.insert(next(later, len(order)), number)
        return order

    def draw(self, config: MapConfig) -> Raster:
        """The map: of the newest scans wherever they contradict older ones, see ``MapConfig.memory``."""
        grid = OccupancyGrid(config)
        for number in self.by_age:
            if config.memory:
                grid.forget(config.memory)
            session = self.sessions[number]
            for k in np.flatnonzero(session.drawn):
                points, pose = session.points[session.begins[k] :][: session.counts[k]], session.path[session.nodes[k]]
                grid.add_scan(pose, points, session.origin)
        return grid.snapshot()

    def _summary(self) -> str:
        return f"{len(self.sessions)} sessions, {len(self.loops)} loops, {int(self.between.sum())} between sessions"


def between_known(path: Array, known: NDArray[np.intp], motion: Array) -> Array:
    """The poses [n, 3] of all n places along a motion, where those of some are known.

    Motion on from the place before and back from the place after do not quite meet; the misfit is spread evenly over
    the places between. The path [u, 3] has the poses of the known places, which are the ``known`` [u] of all n, rising;
    the motion [n, 3] those of all, in a frame of its own.
    """
    places = np.arange(len(motion))
    before = np.clip(np.searchsorted(known, places, side="right") - 1, 0, len(known) - 1)
    after = np.minimum(before + 1, len(known) - 1)
    forward = se2.compose(path[before], se2.between(motion[known[before]], motion))
    backward = se2.compose(path[after], se2.between(motion[known[after]], motion))
    span = known[after] - known[before]
    share = np.where(span > 0, (places - known[before]) / np.maximum(span, 1), 0.0)[:, None]
    misfit = backward - forward
    misfit[:, 2] = se2.wrap(misfit[:, 2])
    poses = forward + share * misfit
    poses[:, 2] = se2.wrap(poses[:, 2])
    return np.asarray(poses)
