"""The joint registration: the poses of all nodes at once, endpoints against the surfaces of the other scans.

As Lu and Milios (1997, Globally consistent range scan alignment for environment mapping) in spirit: every endpoint is
held to the nearest lines of endpoints of other scans, within a reach that shrinks, and all poses follow from one sparse
system a round. The chain is the prior: along a corridor endpoints slide.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.gauss_newton import LEAST_INFORMATION
from moteslam.kernels.normals import scan_normals
from moteslam.kernels.scan_pairs import accumulate, match_endpoints
from moteslam.kernels.scans import ThinnedScan
from moteslam.robot import se2
from moteslam.robot.raster import cell_counts
from moteslam.robot.se2 import Array
from moteslam.slam.backend.graph.config import GraphConfig
from moteslam.slam.backend.graph.pose_graph import BlockSystem, Edges, MeasuredChain
from moteslam.slam.registration.registrar import FULL, least_bound_turn, least_informed

LEAST_RESIDUAL = 0.003  # Standard deviation of the endpoints' distances to lines, at least [m]; the rest is measured
LEAST_INLIERS = 0.2  # Of the weights, in the estimate of that variance
SHRINK = 0.75  # Of the reach, a round
SCALE_SHARE, LEAST_SCALE = 0.25, 0.03  # The robust scale of the residuals: as a share of the reach, at least [m]
AGREEMENT = 0.8  # Smallest cosine between the normals of a match
SLIP = 3.0  # The robust scale of the chain's steps [standard deviations] (Cauchy)
FIRST_POINTS = 3  # Every third endpoint is enough until the poses are still, for half of the rounds at most
STILL = 1e-3  # It ends when the root mean square of the poses' steps is below this [m]
OVERLAP_CELL, LEAST_OVERLAP = 0.5, 0.2
"""Two scans are partners where they share this much of the cells [m] that the endpoints of one lie in."""
NEAR_SHARE = 1 / 3  # Of the partners, those nearest along the path; the others are spread over all that overlap
NORMAL_REACH, NORMAL_NOISE, NORMAL_LARGEST = 0.3, 0.005, 0.1
"""See ``scan_normals``: 30 cm of wall, points good to 5 mm, directions good to 0.1 rad."""
SHARPNESS_CELL = 0.05  # Edge of the cells [m]


class Endpoints(NamedTuple):
    """The endpoints of n scans, scan by scan."""

    points: NDArray[np.float32]  # [p, 2] in the robot's frame of each scan
    normals: NDArray[np.float32]  # [p, 2] likewise
    starts: NDArray[np.int32]  # int32 [n + 1] of each scan among them, and p
    owners: NDArray[np.int32]  # int32 [p] the scan of each

    @classmethod
    def of(cls, scans: Sequence[ThinnedScan]) -> Self:
        """Of thinned scans, with their normals."""
        counts = [len(scan.points) for scan in scans]
        points = np.vstack([scan.points for scan in scans])
        joined = np.concatenate([scan.joined for scan in scans]).astype(np.int32)
        starts = np.r_[0, np.cumsum(counts)].astype(np.int32)
        normals = scan_normals(points, joined, starts, reach=NORMAL_REACH, noise=NORMAL_NOISE, largest=NORMAL_LARGEST)
        return cls(points, normals, starts, np.repeat(np.arange(len(scans)), counts).astype(np.int32))

    def thinned(self, every: int) -> "Endpoints":
        """The first endpoint of each scan, and each ``every``-th after it."""
        kept = (np.arange(len(self.points)) - self.starts[self.owners]) % every == 0
        starts = np.r_[0, np.cumsum(kept)][self.starts].astype(np.int32)
        return Endpoints(self.points[kept], self.normals[kept], starts, self.owners[kept])

    def only(self, scans: NDArray[np.intp]) -> "Endpoints":
        """Those of some scans [m], which rise; numbered anew."""
        counts = np.diff(self.starts)[scans]
        kept = np.isin(self.owners, scans)
        owners = np.repeat(np.arange(len(scans)), counts).astype(np.int32)
        return Endpoints(self.points[kept], self.normals[kept], np.r_[0, np.cumsum(counts)].astype(np.int32), owners)

    def placed(self, poses: Array) -> tuple[Array, Array]:
        """Points and normals [p, 2] in the map frame."""
        pose = poses[self.owners]
        c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])

        def turned(v: NDArray[np.float32]) -> Array:
            return np.column_stack((c * v[:, 0] - s * v[:, 1], s * v[:, 0] + c * v[:, 1]))

        return turned(self.points) + pose[:, :2], turned(self.normals)


def sharpness(endpoints: Endpoints, poses: Array) -> float:
    """The mean number of cells that hold an endpoint: fewer are sharper, and a wall drawn twice counts twice."""
    return float(cells_along(endpoints, poses).mean())


def cells_along(endpoints: Endpoints, poses: Array) -> NDArray[np.int64]:
    """The number of cells that hold an endpoint, for each direction [GRIDS] of the grid; see ``cell_counts``."""
    return cell_counts(endpoints.placed(poses)[0], SHARPNESS_CELL)


def register_jointly(
    endpoints: Endpoints,
    poses: Array,
    chain: MeasuredChain,
    config: GraphConfig,
    reach: float,
    free: NDArray[np.bool_] | None = None,
    *,
    rounds: int | None = None,
) -> Array:
    """Move all poses [n, 3] to where the scans fit each other best; the first stays.

    Endpoints find their surfaces within a ``reach`` [m] at first. Of the scans ``free`` [n] move, by default all.
    Rounds are those of the configuration by default.
    """
    joint = config.joint
    poses, n = poses.copy(), len(poses)
    held = np.ones(n, bool) if free is None else free
    moving = held & (np.arange(n) > 0)
    if not moving.any():
        return poses
    seen, problem = endpoints.thinned(FIRST_POINTS), None
    prior = chain.prior(poses, config.registration)
    most = rounds or joint.rounds
    for turn in range(most):
        if problem is None:
            partners = choose_partners(seen, poses, joint.partners, held)
            problem = _Problem(seen, partners, moving, prior, config, len(endpoints.points) / len(seen.points))
        step = problem.step(poses, reach)
        poses[moving] += step
        poses[moving, 2] = se2.wrap(poses[moving, 2])
        still = reach <= joint.last_reach and np.square(step[:, :2]).sum(axis=1).mean() < STILL**2
        if still and seen is endpoints:
            break
        if seen is not endpoints and (still or turn >= most // 2):
            seen, problem = endpoints, None
        reach = max(SHRINK * reach, joint.last_reach)
    return poses


def choose_partners(endpoints: Endpoints, poses: Array, most: int, held: NDArray[np.bool_]) -> NDArray[np.int32]:
    """The scans that each scan's endpoints are held to: int32 [n, most], -1 for none.

    Scans that see the same places: some of those nearest along the path, and some spread over all that overlap, so that
    every passage is bound to every other. Those that are not to be held to others have none.
    """
    from scipy.sparse import csr_matrix

    points, _ = endpoints.placed(poses)
    cells = np.floor(points / OVERLAP_CELL).astype(np.int64)
    cells -= cells.min(axis=0)
    _, column = np.unique(cells @ np.array((1, int(cells[:, 0].max()) + 1)), return_inverse=True)
    n, columns, rows = len(poses), int(column.max()) + 1, np.flatnonzero(held)
    seen = csr_matrix((np.ones(len(column), np.float32), (endpoints.owners, column)), shape=(n, columns))
    seen.sum_duplicates()
    seen.data[:] = 1
    least, shared = LEAST_OVERLAP * np.diff(seen.indptr), (seen[rows] @ seen.T).tocsr()
    partners = np.full((n, most), -1, np.int32)
    near_count = int(NEAR_SHARE * most)
    for a, (begin, end) in zip(rows.tolist(), pairwise(shared.indptr.tolist()), strict=True):
        others = shared.indices[begin:end]
        others = np.sort(others[(others != a) & (shared.data[begin:end] >= least[a])])
        if len(others) > most:
            near = np.argsort(np.abs(others - a), kind="stable")[:near_count]
            rest = np.delete(others, near)
            spread = np.linspace(0, len(rest) - 1, most - near_count).round().astype(int)
            others = np.sort(np.r_[others[near], rest[spread]])
        partners[a, : len(others)] = others
    return partners


class _Problem:
    """The normal equations of the scans that are ``moving`` [n]: with their partners int32 [n, k], and the ends of
    their steps.

    Of all n - 1 steps between them there is a prior, see ``MeasuredChain.prior``; an endpoint has a weight.
    """

    def __init__(
        self,
        seen: Endpoints,
        partners: NDArray[np.int32],
        moving: NDArray[np.bool_],
        prior: tuple[Array, Array, NDArray[np.bool_]],
        config: GraphConfig,
        weight: float,
    ) -> None:
        bound = moving[:-1] | moving[1:]
        some: NDArray[np.bool_] = np.zeros(len(moving), bool)
        some[(partners >= 0).any(axis=1)] = True
        some[partners[partners >= 0]] = True
        some[:-1] |= bound
        some[1:] |= bound
        number = np.cumsum(some) - 1
        self._config, self._weight = config, weight
        self._nodes, steps = np.flatnonzero(some), np.flatnonzero(bound)
        self._seen = seen.only(self._nodes)
        self._partners = np.where(partners >= 0, number[partners], -1).astype(np.int32)[self._nodes]
        self._first, self._slots = np.nonzero(self._partners >= 0)
        self._second = self._partners[self._first, self._slots].astype(np.intp)
        measured, covariance, doubted = prior
        information = np.asarray(np.linalg.inv(covariance[steps]))
        self._steps = Edges(number[steps], number[steps + 1], measured[steps], information, doubted[steps])
        self._moving = moving[self._nodes]
        one, other = np.r_[self._first, self._steps.first], np.r_[self._second, self._steps.second]
        self._inner = self._moving[one] & self._moving[other]
        unknown = np.cumsum(self._moving) - 1
        self._system = BlockSystem(int(self._moving.sum()), unknown[one[self._inner]], unknown[other[self._inner]])

    def step(self, poses: Array, reach: float) -> Array:
        """The Gauss-Newton step [m, 3] of the scans that move, from all poses [n, 3], with matches within reach [m]."""
        poses, seen = poses[self._nodes], self._seen
        points, normals = seen.placed(poses)
        matches = match_endpoints(points, normals, seen.owners, self._partners, reach=reach, agreement=AGREEMENT)
        scale = max(SCALE_SHARE * reach, LEAST_SCALE)
        pairs, costs = accumulate(seen.points, seen.normals, seen.starts, poses, self._partners, matches, scale=scale)
        # a residual r costs half of r^2 / (1 + (r / scale)^2): from the mean cost follows the mean square of the
        # endpoints' distances to their lines, where most are smaller than the scale [m^2]
        cost, total = costs.sum(axis=0)
        square = 2 * cost / total if total else 0.0
        variance = float(max(square / max(1 - square / scale**2, LEAST_INLIERS), LEAST_RESIDUAL**2))
        information = self._weight / (variance * self._config.correlation)
        sums = information * pairs[self._first, self._slots]
        blocks, right = np.zeros((len(poses), 3, 3)), np.zeros((len(poses), 3))
        by_pair = self._add_pairs(poses, sums, variance, blocks, right)
        by_step = self._add_steps(poses, blocks, right)
        between = np.concatenate((by_pair, by_step))[self._inner]
        return self._system.solve(blocks[self._moving], between, -right[self._moving])

    def _add_pairs(self, poses: Array, sums: Array, variance: float, blocks: Array, right: Array) -> Array:
        """Add the matches of all pairs of scans to the blocks [n, 3, 3] and the right side [n, 3] of the system.

        Between bare walls the errors of the normals pull along them. So what the matches of a pair say along their
        least informed direction has an offset of unknown size besides, whose standard deviation grows with how little
        they rest on, as in ``keep_odometry``; it is eliminated. All pairs of scans that see the same walls may have the
        same one: as many as one of them has partners, squared.

        The sums [e, PAIR] are of ``accumulate``, times the information of an endpoint, whose distance to its line has a
        variance [m^2]. Returns the blocks [e, 3, 3] between the scans.
        """
        information, gradient = sums[:, FULL].reshape(-1, 3, 3), sums[:, 6:9].copy()
        registration, first, second = self._config.registration, self._first, self._second
        ratio, along = least_informed(information)
        along = np.column_stack((along, np.zeros(len(along))))
        variances = np.full(len(information), variance / registration.residual**2)
        deviation = registration.degenerate * variance / registration.residual**2 / np.maximum(ratio, 1e-9)
        unknown = np.square(np.bincount(first)[first] * deviation)
        weights = np.maximum(information[:, 0, 0] + information[:, 1, 1], LEAST_INFORMATION)  # normals have length 1
        means = sums[:, 9:] / weights[:, None]
        turn, bound = least_bound_turn(information, means, variances, np.sqrt(unknown), registration)
        moved = _turned(information, along)
        share = unknown / (1 + unknown * (along * moved).sum(axis=1))
        gradient -= (share * (along * gradient).sum(axis=1))[:, None] * moved
        information -= share[:, None, None] * moved[:, :, None] * moved[:, None, :]
        best = np.zeros(len(poses))
        np.maximum.at(best, first, bound)  # a turn that one pair of a scan binds is bound
        bound = best[first]
        loose = bound < 1
        if loose.any():
            turn = turn[loose]
            moved = _turned(information[loose], turn)
            share = (1 - bound[loose]) / np.maximum((turn * moved).sum(axis=1), LEAST_INFORMATION)
            gradient[loose] -= (share * (turn * gradient[loose]).sum(axis=1))[:, None] * moved
            information[loose] -= share[:, None, None] * moved[:, :, None] * moved[:, None, :]
        off = poses[first, :2] - poses[second, :2]
        about = np.repeat(np.eye(3)[None], len(off), axis=0)
        about[:, 0, 2], about[:, 1, 2] = -off[:, 1], off[:, 0]
        between = -information @ about
        np.add.at(blocks, first, information)
        np.add.at(blocks, second, -np.swapaxes(about, 1, 2) @ between)
        np.add.at(right, first, gradient)
        np.add.at(right, second, -_turned(np.swapaxes(about, 1, 2), gradient))
        return np.asarray(between)

    def _add_steps(self, poses: Array, blocks: Array, right: Array) -> Array:
        """Add the steps of the chain likewise; returns the blocks [s, 3, 3] between their ends.

        Each scan is before at most one, and after at most one.
        """
        steps = self._steps
        off = steps.errors(poses)
        doubt = 1 + steps.robust * steps.squares(off) / SLIP**2  # those that may be far off have heavy tails
        own, sides, between = steps.normal_equations(poses, off, steps.information / doubt[:, None, None])
        for scans, block, side in zip((steps.first, steps.second), own, sides, strict=True):
            blocks[scans] += block
            right[scans] += side
        return np.asarray(between)


def _turned(matrices: Array, vectors: Array) -> Array:
    """Matrices [e, 3, 3] times vectors [e, 3]."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])
