"""Steps of a trajectory that no robot makes: jumps, what was filled in over a gap, and noise of a reference."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from moteslam.eval.metrics.ate import AteResult
from moteslam.eval.metrics.clocks import LEAST, SHAPE
from moteslam.eval.tables import length
from moteslam.robot import se2
from moteslam.robot.se2 import Array
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import Issue, counted, when
from moteslam.slam.inputs.odometry_path import jumps

SMALL, TURNED = 0.1, 2.0
"""Errors and sizes below the first [m] are no other unit, and a robot that turns by more than the second in all [rad]
moves by more."""
EVENLY, FILLED = 2e-4, 2.0  # Velocities that differ by less [m/s] for so long [s] are of no robot that drives
ASIDE = 8.0  # A step of a reference that differs from the estimate's by so many medians is no noise of either
STEPS = {"implausible-speed", "poses-held", "equal-stamps", "positions-rounded"}  # Codes that explain steps


def of_path(reference: Trajectory) -> Iterator[Issue]:
    """Where a reference jumps, as only an estimate may that finds itself elsewhere; and one of next to no length."""
    stamps, poses = reference.stamps, reference.poses
    known = STEPS & {issue.code for issue in reference.warnings}
    if not known and reference.space is None and (at := np.flatnonzero(jumps(stamps, poses)).tolist()):
        steps = se2.between(poses[:-1], poses[1:])[np.array(at) - 1]
        far, turned = np.hypot(steps[:, 0], steps[:, 1]).max(), np.rad2deg(np.abs(steps[:, 2]).max())
        text = f"the reference jumps {counted(len(at), 'time')}, by up to {length(far)} and {turned:.0f} degrees, "
        text += f"{when([(float(stamps[k - 1]), float(stamps[k])) for k in at])}: tracking lost, or angles taken "
        yield Issue("implausible-speed", f"{text}halfway between -180 and 180 degrees? Errors are wrong by it", len(at))
    if reference.length < SMALL and np.abs(np.diff(np.unwrap(poses[:, 2]))).sum() > TURNED:
        text = f"the reference turns, but moves by {length(reference.length)} in all: are its positions in metres?"
        yield Issue("sizes-differ", f"{text} Degrees of latitude and longitude are none", len(reference))


def stepping(ate: AteResult) -> Iterator[Issue]:
    """Where positions of a reference step aside or shake between poses, and those of the estimate do not."""
    own, goal = (np.diff(poses[:, :2], axis=0) for poses in (ate.aligned, ate.reference))
    if len(goal) < LEAST:
        return
    off, bent = np.hypot(*(goal - own).T), []
    for steps in (own, goal):  # against the steps beside it
        around = np.vstack((steps[1:2], (steps[:-2] + steps[2:]) / 2, steps[-2:-1]))
        bent.append(np.hypot(*(steps - around).T))
    ways = (own[:-1] + own[1:]) @ (1, 1j)
    shakes = np.diff(own - goal, axis=0) @ (1, 1j) * np.exp(-1j * np.angle(ways))  # along the way, and across
    along, across = float(np.median(np.abs(shakes.real))), float(np.median(np.abs(shakes.imag)))
    shake, estimates = (float(np.median(one)) for one in bent[::-1])
    large = ate.rmse > SMALL / 10
    dense = float(np.median(np.diff(ate.stamps))) < FILLED  # else an estimate drifts by as much
    if large and dense and along > ate.rmse / 2 and across < SHAPE * along:
        text = f"positions shake by {length(along)} along the way from pose to pose, and hardly across: do stamps of "
        yield Issue("stamps-jitter", f"{text}the estimate or the reference jitter? Errors are of what is driven then")
    elif large and shake > ate.rmse and estimates < SHAPE * shake:
        text = f"the reference shakes by {length(shake)} from pose to pose, the estimate does not"
        yield Issue("reference-noise", f"{text}: most of the ATE is noise of the reference")
    seconds = np.diff(ate.stamps)
    aside = off > max(SMALL, ASIDE * float(np.median(off)))
    aside &= seconds < 2 * np.median(seconds)  # over a gap either may have stepped
    at = np.flatnonzero(aside & (bent[1] > off / 2) & (bent[0] < SHAPE * off)).tolist()
    if at:
        times = when([(float(ate.stamps[k]), float(ate.stamps[k + 1])) for k in at])
        text = f"the reference steps aside by up to {length(float(off[at].max()))}, {counted(len(at), 'time')}, {times}"
        text += ", where the estimate goes on: a fix that was lost, or markers exchanged? Errors are wrong by it"
        yield Issue("implausible-speed", text, len(at))


def filled(estimate: Trajectory, reference: Trajectory, ate: AteResult) -> Iterator[Issue]:
    """Where either moves on straight and evenly, as filled in over a gap, or keeps one coordinate, as held at a border,
    and errors are large, once the poses elsewhere are laid on each other, and also once these are.
    """
    held: list[tuple[str, float, float]] = []
    for one, whose in (reference, "reference"), (estimate, "estimate"):
        steps = np.diff(one.stamps)
        if len(steps) < LEAST or not (steps > 0).all():
            continue
        velocity = np.diff(one.poses[:, :2], axis=0) / steps[:, None]
        moves, changes = np.hypot(*velocity[1:].T) > 5 * EVENLY, np.abs(np.diff(velocity, axis=0)) < EVENLY
        of_none = np.zeros(len(moves), np.bool_)
        at_border = (velocity[1:] == 0).any(axis=1) & (one.space is None)
        for some, size in ((changes.all(axis=1), np.max), (at_border, np.min)):
            for first, last in _runs(moves & some):
                lasts = one.stamps[last + 1] - one.stamps[first] >= FILLED
                of_none[first:last] |= lasts and size(np.ptp(velocity[first + 1 : last + 1], axis=0)) < 5 * EVENLY
        held += [(whose, float(one.stamps[first]), float(one.stamps[last + 1])) for first, last in _runs(of_none)]
    inside = {which: (ate.stamps > which[1]) & (ate.stamps < which[2]) for which in held}
    elsewhere = ~np.any(list(inside.values()), axis=0) if held else np.zeros(0, np.bool_)
    if elsewhere.sum() < LEAST:
        return

    def errors(by: NDArray[np.bool_], of: NDArray[np.bool_]) -> Array:
        """Of some poses, once others are laid on each other [m]."""
        laid = se2.umeyama(ate.aligned[by, :2], ate.reference[by, :2])
        return np.asarray(np.hypot(*(se2.compose(laid, ate.aligned[of]) - ate.reference[of])[:, :2].T))

    usual = float(np.median(errors(elsewhere, elsewhere)))
    least = max(SMALL / 2, usual / SHAPE)
    for whose in ("reference", "estimate"):
        parts = [(times, there) for (which, *times), there in inside.items() if which == whose and there.sum() > 2]
        parts = [(times, there) for times, there in parts if np.median(errors(there, there)) > least / 2]
        off = [(times, some) for times, there in parts if np.median(some := errors(elsewhere, there)) > least]
        if off:
            there = float(np.median(np.concatenate([some for _, some in off])))
            text = f"the {whose} moves straight and evenly, or keeps one coordinate, "
            text += f"{when([(begin, end) for (begin, end), _ in off])}, as filled in over a gap or held at a border: "
            text += f"errors are {length(there)} there (median), {length(usual)} elsewhere"
            yield Issue("poses-held", text, len(off))


def _runs(flags: NDArray[np.bool_]) -> list[list[int]]:
    """Where runs of flags begin, and end before."""
    edges: list[list[int]] = np.flatnonzero(np.diff(flags, prepend=False, append=False)).reshape(-1, 2).tolist()
    return edges
