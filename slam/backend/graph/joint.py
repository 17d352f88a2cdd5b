"""The joint registration: the poses of all nodes at once, endpoints against the surfaces of the other scans.

As Lu and Milios (1997, Globally consistent range scan alignment for environment mapping) in spirit: every endpoint is
held to the nearest lines of endpoints of other scans, within a reach that shrinks, and all poses follow from one sparse
system a round. The chain is the prior: along a corridor endpoints slide.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from moteslam.kernels.scan_pairs import accumulate, match_endpoints
from moteslam.robot import se2
from moteslam.slam.backend.graph.chain import Chain
from moteslam.slam.backend.graph.config import GraphConfig
from moteslam.slam.backend.graph.endpoints import Endpoints
from moteslam.slam.backend.graph.pose_graph import ANCHOR, relative_jacobians
from moteslam.slam.backend.graph.sparse_blocks import BlockSystem
from moteslam.slam.registration.degeneracy import least_informed
from moteslam.slam.registration.registrar import FULL

Array = NDArray[np.float64]

LEAST_RESIDUAL = 0.003
"""The endpoints' distances to their lines vary by this standard deviation at least [m]; the rest is measured."""
LEAST_INLIERS = 0.2
"""Of the weights, in the estimate of that variance."""
SHRINK = 0.75
"""Of the reach, a round."""
SCALE_SHARE, LEAST_SCALE = 0.25, 0.03
"""The robust scale of the residuals: as a share of the reach, at least [m]."""
AGREEMENT = 0.8
"""Smallest cosine between the normals of a match."""
SLIP = 3.0
"""The robust scale of the chain's steps [standard deviations] (Cauchy)."""
OVERLAP_CELL, LEAST_OVERLAP = 0.5, 0.2
"""Two scans are partners where they share this much of the cells [m] that the endpoints of one lie in."""
NEAR_SHARE = 1 / 3
"""Of the partners, those nearest along the path; the others are spread over all that overlap."""
FIRST_POINTS = 3
"""Every third endpoint is enough until the poses are still, and for the first half of the rounds at most."""
STILL = 1e-3
"""It ends when the root mean square of the poses' steps is below this [m]."""


def register_jointly(
    endpoints: Endpoints,
    poses: Array,
    chain: Chain,
    config: GraphConfig,
    free: NDArray[np.bool_] | None = None,
    *,
    rounds: int | None = None,
) -> Array:
    """Move all poses to where the scans fit each other best; the first stays.

    Args:
        endpoints: of n scans.
        poses: [n, 3] to begin with.
        chain: the steps between them.
        config: of the back end.
        free: [n] the scans that move, from within the last reach; by default all do, from within the first reach.
        rounds: at most; by default those of the configuration.

    Returns:
        [n, 3] poses.
    """
    joint = config.joint
    poses, n = poses.copy(), len(poses)
    reach = joint.first_reach if free is None else joint.last_reach
    moving = np.ones(n, bool) if free is None else free
    held = np.where(moving, 0.0, ANCHOR)
    held[0] = ANCHOR
    steps, seen, chosen = np.arange(n - 1), endpoints.thinned(FIRST_POINTS), False
    measured, covariance, doubted = chain.prior()
    known = np.asarray(np.linalg.inv(covariance))
    most = rounds or joint.rounds
    for turn in range(most):
        if not chosen:
            chosen = True
            partners = choose_partners(seen, poses, joint.partners, moving)
            own_scan, slot = np.nonzero(partners >= 0)
            other = partners[own_scan, slot].astype(np.intp)
            system = BlockSystem(n, np.r_[own_scan, steps], np.r_[other, steps + 1])
        points, normals = seen.placed(poses)
        matches = match_endpoints(points, normals, seen.owners, partners, reach=reach, agreement=AGREEMENT)
        scale = max(SCALE_SHARE * reach, LEAST_SCALE)
        pairs, costs = accumulate(seen.points, seen.normals, seen.starts, poses, partners, matches, scale=scale)
        variance = _residual_variance(costs, scale) * config.correlation
        information = len(endpoints.points) / len(seen.points) / variance
        blocks, right = np.zeros((n, 3, 3)), np.zeros((n, 3))
        bound = _add_pairs(poses, own_scan, other, information * pairs[own_scan, slot], config, blocks, right)
        between = _add_chain(poses, measured, known, doubted, blocks, right)
        blocks += held[:, None, None] * np.eye(3)
        step = system.solve(blocks, np.concatenate((bound, between)), -right)
        poses += step
        poses[:, 2] = se2.wrap(poses[:, 2])
        still = reach <= joint.last_reach and np.square(step[moving, :2]).sum(axis=1).mean() < STILL**2
        if still and seen is endpoints:
            break
        if seen is not endpoints and (still or turn >= most // 2):
            seen, chosen = endpoints, False
        reach = max(SHRINK * reach, joint.last_reach)
    return poses


def choose_partners(endpoints: Endpoints, poses: Array, most: int, moving: NDArray[np.bool_]) -> NDArray[np.int32]:
    """The scans that each scan's endpoints are held to: int32 [n, most], -1 for none.

    Scans that see the same places: some of those nearest along the path, and some spread over all that overlap, so that
    every passage is bound to every other. Those that do not move have none.
    """
    n = len(poses)
    points, _ = endpoints.placed(poses)
    cells = np.floor(points / OVERLAP_CELL).astype(np.int64)
    cells -= cells.min(axis=0)
    _, column = np.unique(cells @ np.array((1, int(cells[:, 0].max()) + 1)), return_inverse=True)
    seen = csr_matrix((np.ones(len(column), np.float32), (endpoints.owners, column)), shape=(n, int(column.max()) + 1))
    seen.sum_duplicates()
    seen.data[:] = 1
    movers = np.flatnonzero(moving)
    shared, sizes = (seen[movers] @ seen.T).tocsr(), np.diff(seen.indptr)
    partners = np.full((n, most), -1, np.int32)
    near_count = int(NEAR_SHARE * most)
    for row, a in enumerate(movers.tolist()):
        entries = slice(shared.indptr[row], shared.indptr[row + 1])
        others, overlap = shared.indices[entries], shared.data[entries]
        others = np.sort(others[(others != a) & (overlap >= LEAST_OVERLAP * sizes[a])])
        if len(others) > most:
            near = np.argsort(np.abs(others - a), kind="stable")[:near_count]
            rest = np.delete(others, near)
            spread = np.linspace(0, len(rest) - 1, most - near_count).round().astype(int)
            others = np.sort(np.r_[others[near], rest[spread]])
        partners[a, : len(others)] = others
    return partners


def _residual_variance(costs: Array, scale: float) -> float:
    """The variance of the endpoints' distances to their lines [m^2].

    A residual r costs half of r^2 / (1 + (r / scale)^2): from the mean cost follows the mean square, where most are
    smaller than the scale.

    Args:
        costs: [n, 2] of ``accumulate``.
        scale: of the weights [m].
    """
    cost, total = costs.sum(axis=0)
    square = 2 * cost / total if total else 0.0
    return float(max(square / max(1 - square / scale**2, LEAST_INLIERS), LEAST_RESIDUAL**2))


def _add_pairs(
    poses: Array,
    first: NDArray[np.intp],
    second: NDArray[np.intp],
    sums: Array,
    config: GraphConfig,
    blocks: Array,
    right: Array,
) -> Array:
    """Add the matches of all pairs of scans to the system; returns the blocks [e, 3, 3] between them.

    Between bare walls the errors of the normals pull along them. So what the matches of a pair say along their least
    informed direction has an offset of unknown size besides, whose standard deviation grows with how little they rest
    on, as in ``keep_odometry``; it is eliminated. All pairs of a scan may have the same one.

    Args:
        poses: [n, 3].
        first, second: [e] the scans whose endpoints are held, and those that they are held to.
        sums: [e, PAIR] of ``accumulate``, times the information of an endpoint.
        config: of the back end.
        blocks, right: [n, 3, 3] and [n, 3] of the system; added to.
    """
    information, gradient = sums[:, FULL].reshape(-1, 3, 3), sums[:, 6:].copy()
    ratio, along = least_informed(information)
    along = np.column_stack((along, np.zeros(len(along))))
    deviation = config.registration.degenerate / np.maximum(ratio, 1e-9)
    moved = _turned(information, along)
    variance = np.bincount(first)[first] * np.square(deviation)
    share = variance / (1 + variance * (along * moved).sum(axis=1))
    gradient -= (share * (along * gradient).sum(axis=1))[:, None] * moved
    information -= share[:, None, None] * moved[:, :, None] * moved[:, None, :]
    off = poses[first, :2] - poses[second, :2]
    about = np.repeat(np.eye(3)[None], len(off), axis=0)
    about[:, 0, 2], about[:, 1, 2] = -off[:, 1], off[:, 0]
    between = -information @ about
    np.add.at(blocks, first, information)
    np.add.at(blocks, second, -np.swapaxes(about, 1, 2) @ between)
    np.add.at(right, first, gradient)
    np.add.at(right, second, -_turned(np.swapaxes(about, 1, 2), gradient))
    return np.asarray(between)


def _turned(matrices: Array, vectors: Array) -> Array:
    """Matrices [e, 3, 3] times vectors [e, 3]."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def _add_chain(
    poses: Array, steps: Array, information: Array, doubted: NDArray[np.bool_], blocks: Array, right: Array
) -> Array:
    """Add the chain to the system; returns the blocks [n - 1, 3, 3] between neighbours.

    Args:
        poses: [n, 3].
        steps: [n - 1, 3] of the chain.
        information: [n - 1, 3, 3] of them.
        doubted: [n - 1] which may be far off: these have heavy tails.
        blocks, right: [n, 3, 3] and [n, 3] of the system; added to.
    """
    off = np.asarray(se2.between(steps, se2.between(poses[:-1], poses[1:])))
    squares = np.einsum("ni,nij,nj->n", off, information, off)
    information = information / (1 + doubted * squares / SLIP**2)[:, None, None]
    first, second = relative_jacobians(poses[:-1], poses[1:], steps[:, 2])
    weighted_first, weighted_second = information @ first, information @ second
    blocks[:-1] += np.swapaxes(first, 1, 2) @ weighted_first
    blocks[1:] += np.swapaxes(second, 1, 2) @ weighted_second
    right[:-1] += np.einsum("eki,ek->ei", weighted_first, off)
    right[1:] += np.einsum("eki,ek->ei", weighted_second, off)
    return np.asarray(np.swapaxes(first, 1, 2) @ weighted_second)
