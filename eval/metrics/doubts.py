"""What is doubtful where a trajectory is compared with another one: clocks, units, axes, planes, few partners."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import inf

import numpy as np

from moteslam.eval.metrics import association, clocks
from moteslam.eval.metrics.association import MAX_DIFFERENCE, MAX_GAP, covered, evenly, in_space, rescaled, spatial
from moteslam.eval.metrics.ate import AteResult, absolute_trajectory_error
from moteslam.eval.metrics.clocks import ALIKE, FINE, FITS, GAIN, GAIN_METRES, LEAST, ROUNDS, SHAPE, STEP, shifting
from moteslam.eval.metrics.steps import SMALL, STEPS, filled, of_path, stepping
from moteslam.eval.tables import length
from moteslam.robot import se2
from moteslam.robot.se2 import Array
from moteslam.robot.trajectory import TILT, Space, Trajectory, rotations_of, tilt_of
from moteslam.robot.values import Issue

Reasons = Iterator[tuple[float, Issue]]  # What explains errors, each with the error that it leaves [m]

SAME = 1e-4  # No measurement is as near to the truth [m]
AXES, TURNS = np.deg2rad(30.0), 0.1
"""Orientations that differ by more than the first [rad] are of other axes, or another order, unit or sign; turns below
the second [rad] show no offset on the robot: on a straight drive, drift looks like a long one."""
HEIGHTS, AXIS = 0.05, np.deg2rad(5.0)  # Heights spread by less pass [m]; a direction is an axis that is off by less
OTHERWISE, STANDS = 0.15, 0.2
"""In more than the first share of the seconds in which the reference turns, estimates of it do not turn otherwise, nor
odometry (0.11 at most), by half of that; an estimate spread by less than the second share of it hardly moves."""
UNLIKE, MOST = 0.5, 0.9
"""Two paths have nothing in common where the error is more than the first share of the spread of the reference; errors
are of a part where less than the second share is compared of what there is while both last."""

LAGS, NOISE = np.deg2rad((1.5, 4.0))
"""Errors of the heading that are less show no lag, and that are mostly less may be noise [rad]."""
STRIDE, DEGREES = 1.0, 180 / np.pi  # Directions are compared over so much path, or less [m]; a radian [degrees]
LATEST, APART = 2.0, 0.02  # Offsets of a clock that are tried on relations, and on headings alone: up to [s], every [s]


def _lever_arm(estimate: Trajectory, reference: Trajectory, ate: AteResult, share: float) -> Reasons:
    """The fixed offset on the robot that leaves less than a share of the error, in the body axes of the estimate, or of
    the reference where only that has orientations.

    Gauss-Newton of ``true = Q (there + R arm) + t`` over ``arm`` [3], Q and t; where the body turns too little to show
    it (``TURNS``), a part of the arm is 0, as that along the axis of all turns.
    """
    own = estimate.oriented
    if not (own or reference.oriented) or ate.rmse < GAIN_METRES or len(ate.stamps) < LEAST:
        return
    some = evenly(np.arange(len(ate.stamps)), FINE)
    pair = ate.space or [spatial(Trajectory(ate.stamps, poses)) for poses in (ate.aligned, ate.reference)]
    there, true = (one[some] for one in (pair if own else pair[::-1]))
    goal, size = true.positions - true.positions.mean(axis=0), float(true.positions.std(axis=0).max())
    turn, arm, best = np.eye(3), np.zeros(3), (inf, np.zeros(3))
    for _ in range(ROUNDS):
        moved = (there.positions + there.rotations @ arm) @ turn.T
        moved -= moved.mean(axis=0)
        off = goal - moved
        best = min(best, (clocks.rmse_of(off), arm), key=lambda one: one[0])
        about = np.cross(np.eye(3)[:, None], moved / max(size, SAME))
        design = np.concatenate((about, np.moveaxis(turn @ there.rotations, 2, 0)))
        design -= design.mean(axis=1, keepdims=True)
        step = np.linalg.lstsq(design.reshape(6, -1).T, off.ravel(), rcond=TURNS)[0]
        arm, turn = arm + step[3:], rotations_of(np.array([(*step[:3] / max(size, SAME) / 2, 1.0)]))[0] @ turn
    rmse, (x, y, z) = best
    if rmse < share * ate.rmse and ate.rmse - rmse > GAIN_METRES:
        flat, whose = abs(z) < GAIN_METRES, "estimate" if own else "reference"
        text = f"the point at x {x:.3f} m, y {y:.3f} m{'' if flat else f', z {z:.3f} m'} on the robot, in the axes of "
        text += f"the {whose}'s body, has an ATE of {length(rmse)}: is one path the lidar's, the other the base's?"
        option = f"{'' if own else 'exchange the files: '}--est-offset {x:.3f} {y:.3f} 0"
        mend = option if flat else f"add it, turned by each orientation, to the positions of the {whose}"
        yield rmse, Issue("lever-arm", f"{text} ({mend})")


def doubts(
    estimate: Trajectory, reference: Trajectory, ate: AteResult, *, align: bool = True, apart: float = MAX_DIFFERENCE
) -> tuple[Issue, ...]:
    """What was assumed when both were read, the space and the part of them that are compared, and what explains errors:
    units, signs, clocks, another point of the robot, whichever leaves least; where they are aligned, all of these.
    ``apart`` is the ``max_difference`` of the error.
    """
    left_out = "out-of-plane" if in_space(estimate, reference) else ""  # it matters in x and y
    issues = [issue for issue in (*estimate.warnings, *reference.warnings) if issue.code != left_out]
    reasons, found = [*_shapes(ate)], clocks.clock_offset(estimate, reference, ate.rmse) if align else None
    if align:
        reasons += _inverted(estimate, reference, ate, apart)
        reasons += _lever_arm(estimate, reference, ate, SHAPE if found is None else 1.0)
        left = min([ate.rmse, *(rmse for rmse, _ in reasons), *(found or ())[:1]])
        both = None if in_space(estimate, reference) else clocks.offset_and_arm(estimate, reference, ate.rmse)
        if both is not None and both[0] < min(SHAPE * left, left - GAIN_METRES):
            reasons.append((both[0], Issue("clocks-differ", both[1])))
    if found is not None:  # between poses, where it is fitted, noise is less
        reasons.append((ALIKE**2 * found[0], Issue("clocks-differ", found[1])))
    reasons.sort(key=lambda reason: reason[0])
    best = [issue for _, issue in reasons[:1]]
    if found is not None and best[0].code == "lever-arm" and found[0] < ALIKE * reasons[0][0]:  # at an even speed
        best = [replace(best[0], message=f"{best[0].message}; or else {found[1]}")]
    few_off = float(np.median(ate.errors)) < UNLIKE * float(np.linalg.norm(ate.reference[:, :2].std(axis=0)))
    gaps = tuple(filled(estimate, reference, ate))
    if gaps or (few_off and {"implausible-speed", "poses-held"} & {issue.code for issue in issues}):
        best = [issue for issue in best if issue.code != "unlike"]  # these make paths unlike
    lags = not best and not gaps
    turns = () if any(issue.code == "clocks-differ" for issue in best) else _of_turns(ate, lags=lags)
    of_both = *_of_space(estimate, reference), *best, *turns, *gaps, *_parts(estimate, reference, ate)
    alone = *dict.fromkeys(issues), *of_path(reference)
    explained = STEPS | {"lever-arm", "clocks-differ"}
    steps = () if explained & {issue.code for issue in (*alone, *gaps, *best)} else stepping(ate)
    return (*alone, *steps, *of_both)


def _parts(estimate: Trajectory, reference: Trajectory, ate: AteResult) -> Sequence[Issue]:
    """Whether much of the path of one is not covered by the other, or few poses have a partner."""
    found: list[Issue] = []
    sides = (estimate, "estimate"), (reference, "reference")
    for (one, whose), (other, what) in (sides, sides[::-1]):
        gap = max(MAX_GAP, 3 * float(np.median(np.diff(other.stamps)))) if len(other) > 1 else MAX_GAP
        there = covered(one.stamps, other.stamps, gap=gap)
        steps = np.linalg.norm(np.diff(spatial(one).positions, axis=0), axis=1)
        both = (one.stamps[:-1] >= other.stamps[0]) & (one.stamps[1:] <= other.stamps[-1])
        for least, part, where in ((association.FEW, both | True, ""), (MOST, both, ", from its start to its end,")):
            seen, length = (float(steps[some & part].sum()) for some in (there[1:] & there[:-1], part))
            if seen < least * length and len(ate.stamps) >= association.ALL_FIT:
                text = f"the {what}{where} covers {seen:.1f} m of the {length:.1f} m of the {whose}"
                found.append(Issue("few-matched", f"{text}: errors are those of this part alone", len(ate.stamps)))
                break
    question = "are these the same drive, on the same clock?"
    return found or association.few_matched(len(ate.stamps), min(len(estimate), len(reference)), "poses", question)


def _of_space(estimate: Trajectory, reference: Trajectory) -> Iterator[Issue]:
    spaces = [one.space for one in (estimate, reference) if one.space is not None]
    if in_space(estimate, reference):
        own, tilt = (0.0 if one.space is None else tilt_of(one.space.positions) for one in (estimate, reference))
        why, tilt = "the reference " if tilt > max(TILT, own) else "", max(own, tilt)
        why += f"moves in a plane {np.rad2deg(tilt):.0f} degrees out of x and y" if tilt > TILT else "moves in z, too"
        compared = "aligned and compared in space; errors are those of three coordinates, turns those about any axis"
        yield Issue("in-space", f"{why}: {compared}", len(reference))
    elif spaces and (spread := float(spaces[0].positions[:, 2].std())) >= HEIGHTS:
        whose = "estimate" if estimate.space is not None else "reference"
        text = f"heights of the {whose}, spread by {spread:.2f} m, are left out: the other one is in the plane"
        yield Issue("heights-left-out", text, len(reference))


def _inverted(estimate: Trajectory, reference: Trajectory, ate: AteResult, apart: float) -> Reasons:
    """Whether they fit where the poses of one of them are taken for their inverse: the world in the body."""
    if ate.rotation_errors is None or ate.rmse < SMALL:
        return
    for whose, pair in ("estimate", (_inverse(estimate), reference)), ("reference", (estimate, _inverse(reference))):
        found = absolute_trajectory_error(*pair, max_difference=apart)
        if found.rmse < min(SHAPE * ate.rmse, FITS * float(np.linalg.norm(found.reference[:, :2].std(axis=0)))):
            text = f"inverted the {whose}'s poses fit with an ATE of {length(found.rmse)} in place of "
            text += f"{length(ate.rmse)}: are they those of the world in the body?"
            yield found.rmse, Issue("poses-inverted", text)


def _inverse(trajectory: Trajectory) -> Trajectory:
    other = replace(trajectory, poses=se2.inverse(trajectory.poses))
    if (there := trajectory.space) is not None:
        turns = np.swapaxes(there.rotations, 1, 2)
        other = replace(other, space=Space(-(turns @ there.positions[:, :, None])[:, :, 0], turns))
    return other


def _shapes(ate: AteResult) -> Reasons:
    """What is said of the shapes of two paths, with the error in the plane that it leaves; points are complex."""
    there, true = ((one[:, :2] - one[:, :2].mean(axis=0)) @ (1, 1j) for one in (ate.aligned, ate.reference))
    own, spread = float(np.square(np.abs(there)).mean()), float(np.sqrt(np.square(np.abs(true)).mean()))
    straight, mirror = (float(np.abs((one * true).mean())) for one in (there.conj(), there))
    rigid, mirrored = (float(np.sqrt(max(0.0, own + spread**2 - 2 * cross))) for cross in (straight, mirror))
    same = max(rigid, 0.0 if ate.motion is None else ate.rmse) < SAME
    if same and spread > SMALL and len(there) >= association.ALL_FIT:
        text = f"agrees with the reference to {1000 * SAME:g} mm, as no measurement does: is it the reference itself,"
        yield rigid, Issue("same-path", f"{text} or made from it? Then its errors say nothing", len(there))
    if rigid <= SMALL or own == 0:
        return
    left, least = float(np.sqrt(max(0.0, spread**2 - straight**2 / own))), SHAPE * min(rigid, spread)
    how, shown = rescaled(straight / own, left)
    why = ": ranges or wheels that are off, another unit, a clock along a line?" * (how[0] != "m")
    if left >= least and (found := _stretched(there, true, ate)) is not None and found[0] < GAIN * least:
        (left, how), shown = found, found[0]
        why = ": a plan or projection of another scale in one direction, or a way along bare walls?"
    if left < least:  # else it shrinks to the middle of a path that it has nothing to do with
        fits = f"the estimate fits with an ATE of {length(shown)} in place of {length(rigid)}"
        yield left, Issue("sizes-differ", f"{how} {fits}{why}")
    if ate.motion is None and mirrored < SHAPE * rigid:
        text = (
            "the estimate fits the reference as its mirror image: in one of them y and turns have the wrong sign, or "
        )
        text += "z points down (NED)"
        yield mirrored, Issue("mirrored", text)
    if rigid > UNLIKE * spread:
        text = f"errors of {length(rigid)} where the reference itself is spread by {length(spread)}: "
        why = "another drive or building, or an estimate that is lost"
        if own < (STANDS * spread) ** 2:
            why = f"the estimate hardly moves ({length(float(np.sqrt(own)))}): are these increments, or map to odom?"
        yield inf, Issue("unlike", text + why)
    elif ate.rotation_errors is not None and np.median(ate.rotation_errors) < AXES:
        each = np.unique(np.searchsorted(ate.stamps, np.arange(ate.stamps[0], ate.stamps[-1])))  # second
        turned, goal = (se2.wrap(np.diff(poses[each, 2])) for poses in (ate.aligned, ate.reference))
        turns = np.abs(goal) > TURNS
        count = int((turns & (np.abs(se2.wrap(turned - goal)) > np.abs(goal) / 2)).sum())
        if turns.sum() >= LEAST and count > OTHERWISE * turns.sum():
            text = f"turns otherwise than the reference in {count} of the {turns.sum()} seconds in which that turns: "
            yield inf, Issue("unlike", f"{text}lost, another drive, or a clock that runs unevenly?", count)


def _stretched(there: Array, true: Array, ate: AteResult) -> tuple[float, str] | None:
    """What a scale along x or y of either leaves, and how large it is, by ``true = a there + b conj(there)``."""
    design = np.column_stack((there, there.conj()))
    a, b = np.linalg.lstsq(design, true, rcond=None)[0]
    one, other = sorted((abs(a) + abs(b), abs(a) - abs(b)), key=lambda factor: -abs(factor - 1))
    sizes, way = np.array((one - 1, other - 1)), (np.angle(b) + np.angle(a)) / 2 + (np.pi / 2 if one < other else 0)
    off = min(abs(np.sin(2 * along)) for along in (way, way - np.angle(a) - ate.transform[2]))
    # the opposite across is a shear, as a wrong turn between two legs makes; one that shrinks it to a line fits a line
    if off > np.sin(2 * AXIS) or min(one, other) < GAIN or sizes.prod() < -SHAPE * np.square(sizes).max():
        return None
    how = f"stretched by {one:.4g} along {np.rad2deg(way) % 180:.0f} degrees of the reference's axes (y is 90)"
    return clocks.rmse_of(np.abs(true - design @ (a, b))[:, None]), f"{how}, {other:.4g} across,"


def _of_turns(ate: AteResult, *, lags: bool) -> Iterator[Issue]:
    """Where positions agree, and the directions of travel with them, but headings do not."""
    turns, spread = ate.rotation_errors, float(np.linalg.norm(ate.reference[:, :2].std(axis=0)))
    if turns is None or ate.rmse > max(SMALL, UNLIKE * spread):
        return
    own, goal = (np.unwrap(poses[:, 2]) for poses in (ate.aligned, ate.reference))
    if (middle := float(np.median(turns))) < AXES:
        there = np.flatnonzero(turns > AXES)
        true = np.abs(se2.wrap(np.stack((goal - ate.transform[2], own)))[:, there])  # in the frame of either file
        passing = (true > np.pi * 3 / 4).all(axis=1).any() and turns.max() > np.pi * 3 / 4
        if len(there) and passing:
            text = f"headings of {len(there)} of {len(turns)} poses differ, by up to {np.rad2deg(turns.max()):.0f} "
            text += "degrees, all where one passes 180 degrees: angles taken halfway from there to -180? Errors of "
            yield Issue("implausible-speed", f"{text}rotation are wrong by it", len(there))
            return
        offsets, some = np.arange(-LATEST, LATEST + APART / 2, APART), evenly(np.arange(len(own)), FINE)
        off = own[some] - [np.interp(ate.stamps[some] + seconds, ate.stamps, goal) for seconds in offsets]
        left = off.std(axis=1)
        best, as_is = int(left.argmin()), float(left[len(left) // 2])
        late = float(offsets[best])
        if lags and as_is > LAGS and left[best] < SHAPE * as_is and abs(late) >= STEP and len(turns) >= LEAST:
            moved = [np.interp(ate.stamps + late, ate.stamps, column) for column in ate.reference[:, :2].T]
            behind = f"{abs(late):.2f} s {'late' if late > 0 else 'early'}"
            if ALIKE * np.hypot(*(ate.aligned[:, :2] - np.transpose(moved)).T).mean() < ate.errors.mean():
                text = f"stamps of the reference are {behind}: its clock seems another one {shifting(f'{late:.2f}')}"
            else:
                text = f"headings of the reference are {behind}, its positions not: errors of rotation, "
                text += f"{np.rad2deg(as_is):.2g} degrees about their mean, are wrong by it"
            yield Issue("clocks-differ", text, len(turns))
            return
    path, _ = association.travelled(ate.reference)
    some = np.unique(np.searchsorted(path, np.linspace(0, path[-1], max(2 * LEAST, int(path[-1] / STRIDE)))))
    moves = [np.diff(poses[some, :2], axis=0) for poses in (ate.aligned, ate.reference)]
    ways = np.hypot(*(moves[0] - moves[1]).T) / np.maximum(np.hypot(*moves[1].T), SMALL)
    share = float(np.median(ways)) if len(ways) else 0.0  # of a robot that stands there are none
    off = np.diff(ate.aligned[:, :2] - ate.reference[:, :2], axis=0)
    noise = clocks.rmse_of(off) > SHAPE * ate.rmse  # errors of poses next to each other are not alike
    if lags and not noise and share > max(OTHERWISE, 2 * _spread_of(own - goal)):
        text = f"positions move otherwise than the reference's, by {share:.0%} of the way, where headings agree: "
        yield Issue("unlike", f"{text}x and y of other rows, smoothed, or wheels that slip?", len(turns))
        return
    angle, seen = contradicted(turns[some], *moves)
    if not seen and middle < AXES:
        return
    ahead = (one[some[1:]] - np.arctan2(*move.T[::-1]) for one, move in zip((own, goal), moves, strict=True))
    slips = [_spread_of(2 * off) for off in ahead]  # of the doubled angle: a robot may back
    wrong, right, whose = (goal, own, "reference") if slips[1] > slips[0] else (own, goal, "estimate")
    if whose == "estimate":  # as in its file
        wrong, right = wrong - ate.transform[2], right - ate.transform[2]
    slope = float(np.polyfit(right, wrong, 1)[0]) if np.ptp(right) > TURNS else 1.0
    tries = (slope, right), (DEGREES, right), (DEGREES, se2.wrap(right))
    left, factor = min((_spread_of(wrong - by * one), by) for by, one in tries)
    alike, why = _spread_of(wrong - right), "where positions agree: lost, another order, unit or sign, a mirrored path"
    if alike <= 0.2 * min(angle, AXES):
        why = "throughout: other axes of the body, as a camera's (turn them to x ahead, y left, z up), unit or sign, "
        why += "or a mirrored path"
    elif left < SHAPE * alike and len(some) > LEAST and abs(factor) > TURNS:
        as_if = "in degrees, taken for radians" if abs(factor / DEGREES - 1) < TURNS else f"multiplied by {factor:.3g}"
        why = f"where positions agree: those of the {whose} are as if {as_if}"
    text = f"orientations differ by {np.rad2deg(angle if seen else middle):.2g} degrees{seen} {why}; errors of rotation"
    yield Issue("body-axes", f"{text} and relative errors are wrong by it, the ATE of positions is not", len(turns))


def contradicted(turns: Array, own: Array, goal: Array) -> tuple[float, str]:
    """By how much headings are off [rad], and what is said where many are by far more than moves [n, 2] are."""
    each = turns, own - goal, goal
    angle, allowed, size = (float(np.sqrt(np.square(off).sum() / max(len(off), 1))) for off in each)
    least = max(NOISE, allowed / max(SHAPE * size, SAME))
    apart = len(goal) >= LEAST and np.quantile(turns, 1 - OTHERWISE) > least
    return angle, f", directions by {np.rad2deg(allowed / size):.2g}," if apart else ""


def _spread_of(angles: Array) -> float:
    """The circular standard deviation [rad]."""
    return float(np.sqrt(-2 * np.log(np.clip(abs(np.exp(1j * angles).sum()) / max(len(angles), 1), SAME, 1.0))))
