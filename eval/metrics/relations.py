"""Relations between poses, checked by hand: a truth for real logs that no SLAM has written (Kuemmerle et al. 2009)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from moteslam.errors import File, InputError
from moteslam.eval.metrics.association import covered, from_to, laid, nearest_rotation, rescaled
from moteslam.eval.metrics.ate import PoseErrors
from moteslam.eval.metrics.clocks import ALIKE, GAIN_METRES, SHAPE, shifting
from moteslam.eval.metrics.doubts import APART, AXES, DEGREES, LATEST, SAME, UNLIKE, contradicted
from moteslam.eval.tables import length
from moteslam.files import open_regular
from moteslam.robot import se2
from moteslam.robot.formats.streams import MAX_JUMP
from moteslam.robot.recording import nearest_stamp
from moteslam.robot.se2 import Array, Poses, between
from moteslam.robot.se2 import interpolate as interpolated
from moteslam.robot.trajectories.columns import number_lines
from moteslam.robot.trajectories.text import MAX_TURN
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import Issue, Summarised, expect_type

TOLERANCE = 1e-4
"""Stamps of a relation and of a pose that are the same reading differ by less than this [s]."""
UPRIGHT, HEAD = 0.2, 100_000
"""A file of relations is known by so many bytes: height [m], roll and pitch [rad] are less than this."""
FEW_RELATIONS = 5  # So many relations always fit some clock, arm or axes


@dataclass(frozen=True, eq=False, repr=False)
class Relations(Summarised):
    """Where the robot was at one time, seen from where it was at another.

    ``poses`` [n, 3] are at the second of the stamps [n, 2] [s], in the frame of the first.
    """

    stamps: Array
    poses: Poses

    def __len__(self) -> int:
        return len(self.stamps)


@dataclass(frozen=True, eq=False, repr=False)
class RelationResult(PoseErrors):
    """The errors of the relations [n, 3] that could be used, at their stamps [n, 2], of ``total`` in the file, and the
    poses [n, 2, 3] of the trajectory there; of those alone that have a pose at both of their stamps, and of those that
    are clear: their stamps each belong to exactly one pose.
    """

    rotation_errors: Array
    total: int
    relations: Poses
    poses: Array
    at_stamps: PoseErrors | None
    clear: PoseErrors | None
    _what: ClassVar[str] = "relation"

    def as_dict(self) -> dict[str, Any]:
        matched = 0 if self.at_stamps is None else self.at_stamps.pairs
        counts = {"total": self.total, "used": self.pairs, "interpolated": self.pairs - matched}
        some = {"at_stamps": self.at_stamps, "clear": self.clear}
        some_or_none = {name: None if errors is None else errors.as_dict() for name, errors in some.items()}
        return {**counts, "all": super().as_dict(), **some_or_none}


def is_relations(path: File) -> bool:
    """Whether a file holds relations rather than TUM poses; both are eight numbers a line.

    The last four of a TUM line are a quaternion: of length 1, or 0 throughout where there is no orientation. Of a
    relation they are 0, 0, 0 (or nearly) and an angle, which is not 1 rad in every line, and the first two are times of
    one clock. A file named ``.relations`` holds some; one that cannot be read, or has no such lines, holds none.
    """
    try:
        with open_regular(path, "relations") as file:
            head = file.read(HEAD).decode("utf-8-sig", errors="replace")
        text = head if len(head) < HEAD else head.rpartition("\n")[0]
        rows = np.array([line.split() for line in text.splitlines() if line.strip() and line[0] != "#"], np.float64)
    except (OSError, InputError, ValueError):
        return False
    if rows.ndim != 2 or rows.shape[1] != 8:
        return False
    if Path(path).suffix == ".relations":
        return True
    angles = (np.abs(rows[:, 4:7]) < UPRIGHT).all() and (np.abs(np.linalg.norm(rows[:, 4:], axis=1) - 1) > 0.01).any()
    clock = np.median(np.abs(rows[:, 1] - rows[:, 0])) < MAX_JUMP
    return bool(angles and clock and rows[:, 4:].any())


def read_relations(path: File) -> Relations:
    """Read ``t1 t2 x y z roll pitch yaw`` lines (metres, radians), of which x, y and yaw count."""
    path = Path(path)
    rows, lines = number_lines(path, "relations", 8, "t1 t2 x y z roll pitch yaw")
    table = np.array(rows, np.float64)
    tilt = UPRIGHT if table[:, 7].any() else UPRIGHT / 10  # yaw may stand first
    for k, field, most in ((5, "roll", tilt), (6, "pitch", tilt), (7, "yaw", MAX_TURN)):
        if (large := np.abs(table[:, k]) > most).any():
            first = int(np.argmax(large))
            problem = f"an angle of {table[first, k]:g}, expected radians, at most {most:g}: x y z roll pitch yaw"
            raise InputError(problem, file=path, line=lines[first], field=field)
    return Relations(table[:, :2], table[:, [2, 3, 7]])


def evaluate_relations(
    trajectory: Trajectory, relations: Relations, *, interpolate: bool = True, tolerance: float = TOLERANCE
) -> RelationResult:
    """How far the trajectory's relative poses are from the relations'.

    The error of a relation is the pose est (-) ref, where both are the pose at t2 seen from the pose at t1: the
    length of its translation [m] and its absolute angle [rad].

    A log may repeat a stamp for distinct scans, and then it is unknown which of them a relation meant. Of several poses
    with one stamp the first stands for it. A stamp between two poses at most ``MAX_GAP`` apart has the pose
    interpolated there, unless ``interpolate`` is false. The stamps of a relation and of its pose are at most
    ``tolerance`` apart [s].
    """
    expect_type(trajectory, Trajectory, "trajectory", "read_trajectory(path) reads one")
    expect_type(relations, Relations, "relations", "read_relations(path) reads some")
    if not trajectory.oriented:
        raise InputError("a trajectory without orientation, expected headings: relations are poses")
    if not len(trajectory):
        raise InputError("a trajectory without poses, expected one at every scan")
    stamps, nearest = trajectory.stamps, nearest_stamp(trajectory.stamps, relations.stamps)
    first = np.searchsorted(stamps, stamps[nearest], side="left")
    count = np.searchsorted(stamps, stamps[nearest], side="right") - first
    count[np.abs(stamps[nearest] - relations.stamps) > tolerance] = 0  # poses at the very stamp
    reachable = count > 0
    if interpolate:
        reachable = reachable | covered(relations.stamps, stamps, 0.0)
    used = reachable.all(axis=1)
    if not used.any():
        problem = f"none of {len(relations)} relations has a pose at both of its stamps"
        covers = f"they cover {from_to(np.sort(relations.stamps.ravel()))}, the trajectory {from_to(stamps)}"
        raise InputError(f"{problem}, expected the relations of this log: {covers}")
    at, count = relations.stamps[used], count[used]
    between_poses = interpolated(stamps, trajectory.poses, at.ravel()).reshape(-1, 2, 3)
    poses = np.where((count > 0)[..., None], trajectory.poses[first[used]], between_poses)
    errors = between(relations.poses[used], between(poses[:, 0], poses[:, 1]))
    found = at, np.hypot(errors[:, 0], errors[:, 1]), np.abs(errors[:, 2])
    which = (those.all(axis=1) for those in (count > 0, count == 1))
    some = (PoseErrors(*(each[those] for each in found)) if those.any() else None for those in which)
    return RelationResult(*found, len(relations), relations.poses[used], poses, *some)


def relation_doubts(estimate: Trajectory, missed: RelationResult) -> tuple[Issue, ...]:
    """What explains errors of relations best: another form, unit or clock, or another point of the robot."""
    given, (one, other) = missed.relations, np.moveaxis(missed.poses, 1, 0)
    there, mean, turned = between(one, other), missed.translation.mean, float(missed.rotation_errors.mean())
    angle, seen = contradicted(missed.rotation_errors, there[:, :2], given[:, :2])
    if mean < GAIN_METRES and turned < AXES and not seen:
        return ()
    x, y, turn = given.T
    many = len(given) > FEW_RELATIONS
    most, reasons = (SHAPE if many else SHAPE**2) * mean, []
    turning = float(np.abs(there[:, 2]).mean())  # none: nothing tells a sign or a unit
    forms = {
        "the other way round, t1 seen from t2,": se2.inverse(given),
        "with x and y exchanged": given[:, [1, 0, 2]],
        "with x and y in the axes at t2": se2.compose(given * (0, 0, 1), given * (1, 1, 0)),
        "with y of the other sign": given * (1, -1, 1),
        "with angles of the other sign": given * (1, 1, -1),
        "as their mirror image": given * (1, -1, -1),
        "with angles in degrees": given * (1, 1, 1 / DEGREES),
    }
    for how, poses in forms.items():
        off = between(poses, there)
        left, turns = float(np.hypot(off[:, 0], off[:, 1]).mean()), float(np.abs(off[:, 2]).mean())
        means = f"{length(left)} and {np.rad2deg(turns):.2g} degrees in place of {length(mean)} and "
        text = f"relations {how} are missed by {means}{np.rad2deg(turned):.2g}"
        places = left < most and turns < ALIKE * turned
        headings = turns < SHAPE * min(turned, turning) and left < ALIKE * mean
        if places or headings:
            reasons.append((min(left, mean), turns, "relations-inverted", text))

    def explains(off: Array, code: str, text: str, size: float = 1.0) -> None:
        if (left := float(np.linalg.norm(off, axis=1).mean())) < most and many:
            explained = f"{text} relations are missed by {length(size * left)} in place of {length(mean)}"
            reasons.append((left, turned, code, explained))

    moved = other[:, :2] - one[:, :2]
    turn_to, _ = nearest_rotation(moved.T @ given[:, :2])
    explains(moved - given[:, :2] @ turn_to.T, "relations-inverted", "if x and y are taken in the axes of the map,")
    turn_to, shift, _ = laid(given[:, :2], other[:, :2])
    off = given[:, :2] @ turn_to.T + shift - other[:, :2]
    explains(off, "relations-inverted", "if they are taken as poses at t2 in a map, not seen from t1,")
    turn_to, _ = nearest_rotation(there[:, :2].T @ given[:, :2])
    degrees = np.rad2deg(np.arctan2(turn_to[1, 0], turn_to[0, 0]))
    text = f"with x and y turned by {degrees:.0f} degrees, in other axes of the robot,"
    explains(given[:, :2] @ turn_to.T - there[:, :2], "body-axes", text)
    factor = float((given[:, :2] * there[:, :2]).sum() / max(np.square(given[:, :2]).sum(), SAME**2))
    text, size = rescaled(1 / max(factor, SAME), 1 / max(factor, SAME))
    explains(factor * given[:, :2] - there[:, :2], "sizes-differ", text, size)
    c, s = np.cos(turn) - 1, np.sin(turn)
    design = np.concatenate((np.stack((c, -s), axis=1), np.stack((s, c), axis=1)))
    off = np.concatenate((x - there[:, 0], y - there[:, 1]))
    arm = np.linalg.lstsq(design, off, rcond=None)[0]
    text = f"of a point of the robot at x {arm[0]:.3f} m, y {arm[1]:.3f} m (--est-offset {arm[0]:.3f} {arm[1]:.3f} 0)"
    explains((off - design @ arm).reshape(2, -1).T, "lever-arm", text)
    for seconds in np.arange(-LATEST, LATEST + APART / 2, APART):
        late = interpolated(estimate.stamps, estimate.poses, (missed.stamps + seconds).ravel()).reshape(-1, 2, 3)
        text = f"with stamps moved by {seconds:+.2f} s, of another clock {shifting(f'{-seconds:.2f}')},"
        explains((between(late[:, 0], late[:, 1]) - given)[:, :2], "clocks-differ", text)
        text = f"with t2 alone moved by {seconds:+.2f} s"
        explains((between(one, late[:, 1]) - given)[:, :2], "clocks-differ", text)
    if seen and not reasons:
        text = f"angles of relations are missed by {np.rad2deg(angle):.2g} degrees{seen} where places agree: of another"
        text += " order or unit, or not known? Errors of rotation are wrong by it"
        reasons.append((mean, turned, "body-axes", text))
    if not reasons and many and mean > UNLIKE * (size := float(np.hypot(*there[:, :2].T).mean())):
        text = f"relations of {length(size)} in the estimate's mean are missed by {length(mean)}: an estimate that is "
        reasons.append((mean, turned, "unlike", f"{text}lost, of another drive, or distances without x and y?"))
    return tuple(Issue(code, text, len(given)) for _, _, code, text in sorted(reasons)[:1])
