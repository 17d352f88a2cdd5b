"""Errors of relative poses: over a delta (RPE), per metre of path (drift), and between visits of the same place."""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal, get_args

import numpy as np

from moteslam.errors import InputError
from moteslam.eval.metrics import association
from moteslam.eval.metrics.association import MAX_DIFFERENCE, Indices, Matched, evenly, match, oriented, travelled
from moteslam.eval.metrics.ate import PoseErrors
from moteslam.robot.se2 import Array, Poses, between
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import Summarised

Unit = Literal["m", "s", "frames"]
Pairs = tuple[Indices, Indices]

RELATIVE_TOLERANCE = 0.1
"""With all pairs, a pair may be farther apart or nearer than asked for by this share of it, as evo has it."""
LENGTHS = (5.0, 10.0, 20.0, 50.0, 100.0)
"""Lengths of path over which drift is measured [m], those that the drive has."""
SAME_PLACE, LEAST_PATH = 1.0, 15.0
"""The robot is back at a place where it is less than the first from where it was [m], after more than the second of
path [m]."""
MAX_RETURNS = 2000
"""At most this many poses are looked at for returns, spread evenly over the drive."""


@dataclass(frozen=True, eq=False, repr=False)
class RpeResult(PoseErrors):
    """The relative pose error of pairs ``delta`` apart that begin at the stamps; without headings that of distances."""

    delta: float
    unit: Unit
    _what: ClassVar[str] = "pair"

    def as_dict(self) -> dict[str, Any]:
        return {"delta": self.delta, "unit": self.unit, **super().as_dict()}


@dataclass(frozen=True, eq=False, repr=False)
class DriftResult(Summarised):
    """Errors of relative poses over lengths [n] of path [m], of ``LENGTHS``, divided by the length: of translation [n]
    [m/m] and of rotation [n] [rad/m].
    """

    lengths: Array
    translation: Array
    rotation: Array


def relative_pose_error(
    estimate: Trajectory,
    reference: Trajectory,
    *,
    delta: float = 1.0,
    unit: Unit = "m",
    all_pairs: bool = False,
    max_difference: float = MAX_DIFFERENCE,
    interpolate: bool | None = None,
) -> RpeResult:
    """The relative pose error (Sturm et al. 2012), with the pairs that evo takes: measured on the estimate.

    The pairs follow each other end to end, each the shortest that reaches ``delta``: metres of path, seconds, or a
    whole number of poses. With ``all_pairs`` one begins at every pose and ends where its length is nearest to
    ``delta``, within ten per cent. How poses are matched: see ``match``.
    """
    if unit not in get_args(Unit):
        raise InputError(f"{unit!r}, expected one of {', '.join(get_args(Unit))}", field="unit")
    if not (np.isfinite(delta) and delta > 0) or (unit == "frames" and delta != int(delta)):
        kind = "a whole number of poses from 1 on" if unit == "frames" else "a length above 0"
        raise InputError(f"{delta:g} {unit}, expected {kind}", field="delta")
    matched = match(estimate, reference, max_difference=max_difference, interpolate=interpolate)
    positions = matched.estimate[:, :2] if matched.space is None else matched.space[0].positions
    first, last = _pairs(matched.stamps, positions, delta, unit, all_pairs=all_pairs)
    if not len(first):
        problem = f"no pair {delta:g} {unit} apart among {len(matched.stamps)} matched poses, expected a shorter delta"
        raise InputError(problem, field="pairs")
    return RpeResult(matched.stamps[first], *_errors(matched, first, last), delta, unit)


def drift(estimate: Trajectory, reference: Trajectory) -> DriftResult:
    """Drift per metre, as the KITTI odometry benchmark has it (Geiger, Lenz and Urtasun 2012), over lengths indoors.

    From every pose on, and over each of ``LENGTHS`` of the reference's path, the error of the relative pose divided by
    that length.
    """
    matched = match(*oriented(estimate, reference))
    path, _ = travelled(matched.reference)
    ends = np.searchsorted(path, path + np.array(LENGTHS)[:, None])  # [LENGTHS, n]
    which, first = np.nonzero(ends < len(path))
    if not len(first):
        raise InputError(f"{path[-1]:.2f} m driven, expected at least {LENGTHS[0]:g} m", field="path")
    shift, turn = planar_errors(matched.reference, matched.estimate, first, ends[which, first])
    lengths = np.array(LENGTHS)[which]
    return DriftResult(lengths, shift / lengths, turn / lengths)


def loop_closing_error(estimate: Trajectory, reference: Trajectory) -> PoseErrors:
    """How far apart an estimate puts two visits of the same place, at the stamps [n, 2] of both, against the truth.

    Each pose is compared with the earliest one within ``SAME_PLACE`` of it by the reference that lies more than
    ``LEAST_PATH`` of path before it.
    """
    matched = match(*oriented(estimate, reference))
    chosen = evenly(np.arange(len(matched.stamps)), MAX_RETURNS)
    true, path = matched.reference[chosen], travelled(matched.reference)[0][chosen]
    pairs = association.tree_of(true[:, :2]).query_pairs(SAME_PLACE, output_type="ndarray")
    earliest = np.arange(len(true))
    np.minimum.at(earliest, pairs[:, 1], pairs[:, 0])
    later = np.flatnonzero(path - path[earliest] > LEAST_PATH)
    if not len(later):
        near = f"none within {SAME_PLACE:g} m of an earlier one more than {LEAST_PATH:g} m of path before it"
        raise InputError(f"no place visited twice: {near}", field="path")
    stamps = matched.stamps[chosen]
    visits = np.column_stack((stamps[earliest[later]], stamps[later]))
    return PoseErrors(visits, *planar_errors(true, matched.estimate[chosen], earliest[later], later))


def _errors(matched: Matched, first: Indices, last: Indices) -> tuple[Array, Array | None]:
    """Of pairs [k] the errors of translation [m] and rotation [rad]; of positions alone that of their distance."""
    if not matched.oriented:
        flat = (matched.estimate[:, :2], matched.reference[:, :2])
        pair = flat if matched.space is None else tuple(space.positions for space in matched.space)
        there, true = (np.linalg.norm(points[last] - points[first], axis=1) for points in pair)
        return np.abs(there - true), None
    if matched.space is None:
        return planar_errors(matched.reference, matched.estimate, first, last)
    moved, turned = [], []
    for space in matched.space:
        back = np.swapaxes(space.rotations[first], 1, 2)
        moved.append((back @ (space.positions[last] - space.positions[first])[:, :, None])[:, :, 0])
        turned.append(back @ space.rotations[last])
    return np.linalg.norm(moved[0] - moved[1], axis=1), association.angles(np.swapaxes(turned[1], 1, 2) @ turned[0])


def planar_errors(true: Poses, estimated: Poses, first: Indices, last: Indices) -> tuple[Array, Array]:
    """Errors [k] of translation [m] and rotation [rad] of the poses ``last`` [k] seen from the poses ``first`` [k]."""
    errors = between(between(true[first], true[last]), between(estimated[first], estimated[last]))
    return np.hypot(errors[:, 0], errors[:, 1]), np.abs(errors[:, 2])


def _pairs(stamps: Array, positions: Array, delta: float, unit: Unit, *, all_pairs: bool) -> Pairs:
    if unit == "frames":
        first = np.arange(0, len(positions) - int(delta), 1 if all_pairs else int(delta))
        return first, first + int(delta)
    steps = np.diff(stamps) if unit == "s" else np.sqrt((np.diff(positions, axis=0) ** 2).sum(axis=1))
    # Unix stamps are known to a microsecond: ten times 0.1 s is a second, whichever way it rounds
    return (_every if all_pairs else _end_to_end)(steps, delta - 1e-6 if unit == "s" else delta)


def _end_to_end(steps: Array, delta: float) -> Pairs:
    ends, travelled = [0], 0.0
    for index, step in enumerate(steps.tolist(), start=1):
        travelled += step
        if travelled >= delta:
            ends.append(index)
            travelled = 0.0
    return np.array(ends[:-1], np.intp), np.array(ends[1:], np.intp)


def _every(steps: Array, delta: float) -> Pairs:
    travelled = np.concatenate(([0.0], np.cumsum(steps)))
    first = np.arange(len(travelled) - 1)
    # the nearest to travelled + delta is on one side of it or the other; of equals the first counts
    above = np.maximum(np.searchsorted(travelled, travelled[first] + delta), first + 1)
    above = np.minimum(above, len(travelled) - 1)
    below = np.maximum(np.searchsorted(travelled, travelled[np.maximum(above - 1, first + 1)]), first + 1)
    to_above = np.abs(travelled[above] - travelled[first] - delta)
    to_below = np.abs(travelled[below] - travelled[first] - delta)
    last = np.where(to_below <= to_above, below, above)
    good = np.minimum(to_below, to_above) <= delta * RELATIVE_TOLERANCE
    return first[good], last[good]
