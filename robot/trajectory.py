"""Trajectories and pose graphs; poses in space and what is left of them in the plane."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.recording import Stream
from moteslam.robot.values import Issue, Summarised, counted, frozen

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

UNIT, FARTHEST, TILT = 0.05, 1e9, np.deg2rad(10.0)
"""Lengths of quaternions, and of rows of rotation matrices, are off 1 by less, however they were rounded; no position
is farther away [m]; a plane of motion that is tilted by more is not that of x and y."""
SAME, STANDS, FEW = 1e-6, 0.05, 3
"""Orientations and heights that differ by less are the same; a path that is spread by less [m], or of fewer poses, says
nothing of orientations."""
FASTEST, MANY, ROUNDED, JUMP = 100.0, 0.1, 0.01, 5
"""No robot is faster [m/s]; stamps of which a larger share are those of the pose before, with more path between [m],
were rounded; after poses that repeat each other so many times the usual step is a jump."""
DIGITS, FEW_VALUES, MOST_VALUES = 0.015, 4, 0.9
"""A coordinate of more values, and of fewer than this share of the poses, all multiples of more [m], was rounded."""
BINARY, REGULAR, SEVERAL = 16, 0.8, 20
"""Stamps of more poses that are all whole multiples of a second over the first, with fewer than this share of the steps
alike, were rounded as float32 does: clocks count in tenths."""
STRIDE, ACROSS, FITS = 0.2, np.sin(np.deg2rad(10.0)) ** 2, 0.2
"""Directions of travel over some path [m] that are off a fixed direction of the body by more than the second, in the
mean squared sine, do not follow it; other orientations that leave less than this share of it are what was meant."""


@dataclass(frozen=True, eq=False, repr=False)
class Space(Summarised):
    """The poses of a trajectory in space."""

    positions: Array  # [n, 3] x, y, z [m]
    rotations: Array  # [n, 3, 3] of the body in the frame of the positions

    def __getitem__(self, index: NDArray[np.integer | np.bool_]) -> "Space":
        return Space(self.positions[index], self.rotations[index])


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(Stream):
    """Poses of a frame over time.

    Attributes:
        stamps: [n] float64 [s], not decreasing; equal stamps are kept in file order.
        poses: [n, 3] float64: x [m], y [m], theta [rad].
        oriented: whether the headings are known; else they are 0 and mean nothing.
        space: the poses in space, of a file whose poses are not all upright at one height; ``poses`` are projected.
        warnings: what was assumed or left out when it was read.
    """

    poses: Array
    oriented: bool = True
    space: Space | None = None
    warnings: tuple[Issue, ...] = ()
    _reading: ClassVar[str] = "pose"

    def __post_init__(self) -> None:
        for name in ("stamps", "poses"):
            object.__setattr__(self, name, frozen(getattr(self, name), np.float64))
        super().__post_init__()

    @property
    def length(self) -> float:
        """The distance travelled [m]: the sum of the steps between poses."""
        return float(np.hypot(*np.diff(self.poses[:, :2], axis=0).T).sum())

    def take(self, which: NDArray[np.bool_ | np.intp]) -> Self:
        return replace(super().take(which), space=None if self.space is None else self.space[which])

    def at(self, stamps: Array) -> "Trajectory":
        """The trajectory in the plane at other stamps [m] [s], not decreasing, and held beyond its ends."""
        return Trajectory(stamps, se2.interpolate(self.stamps, self.poses, stamps), self.oriented)

    def _summary(self) -> str:
        return f"{super()._summary()}, {self.length:.1f} m"


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class PoseGraph(Summarised):
    """Nodes in the order in which the robot was there, and edges between them.

    Attributes:
        ids: [n] of the nodes, rising; what files know them by.
        poses: [n, 3] x [m], y [m], theta [rad].
        first, second: [e] indices of the nodes that an edge binds, into ``poses``.
        relative: [e, 3] measured pose of the second in the frame of the first.
        information: [e, 3, 3], symmetric, of its error in the frame of the measured pose: what is left of the second's
            pose there [1/m^2, 1/(m rad), 1/rad^2].
        stamps: [n] of the nodes [s], not decreasing; None if not known.
        fixed: [k] indices of the nodes that hold the frame.
    """

    ids: Indices
    poses: Array
    first: Indices = field(default_factory=lambda: np.zeros(0, np.int64))
    second: Indices = field(default_factory=lambda: np.zeros(0, np.int64))
    relative: Array = field(default_factory=lambda: np.zeros((0, 3)))
    information: Array = field(default_factory=lambda: np.zeros((0, 3, 3)))
    stamps: Array | None = None
    fixed: Indices = field(default_factory=lambda: np.zeros(0, np.int64))

    def __post_init__(self) -> None:
        n, e = len(self.ids), len(self.first)
        shapes = {"ids": (n,), "poses": (n, 3), "first": (e,), "second": (e,), "relative": (e, 3)}
        shapes |= {"information": (e, 3, 3), "stamps": (n,), "fixed": (len(self.fixed),)}
        for name, shape in shapes.items():
            if (value := getattr(self, name)) is None:
                continue
            array = frozen(value, np.int64 if name in ("ids", "first", "second", "fixed") else np.float64)
            if array.shape != shape:
                raise InputError(f"{list(array.shape)}, expected {list(shape)}", field=name)
            object.__setattr__(self, name, array)
        if (np.diff(self.ids) <= 0).any():
            raise InputError("expected rising ids", field="ids")
        if self.stamps is not None and not (np.diff(self.stamps) >= 0).all():
            raise InputError("stamps go back, expected rising seconds", field="stamps")
        for name in ("first", "second", "fixed"):
            index = getattr(self, name)
            if len(index) and not 0 <= index.min() <= index.max() < n:
                raise InputError(f"expected indices of {counted(n, 'node')}", field=name)
        if (self.first == self.second).any():
            raise InputError("an edge from a node to itself, expected one between two", field="second")

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def loops(self) -> NDArray[np.bool_]:
        """[e] which edges are loops: those between nodes that do not follow each other."""
        return np.asarray(np.abs(self.second - self.first) != 1)

    def _summary(self) -> str:
        loops = int(self.loops.sum())
        return f"{counted(len(self), 'node')}, {counted(len(self.first), 'edge')}, {counted(loops, 'loop')} of these"


def trajectory_of(
    path: Path,
    stamps: Array,
    positions: Array,
    quaternions: Array | None,
    *,
    lines: Sequence[int] = (),
    warnings: tuple[Issue, ...] = (),
    else_turned: Mapping[str, Array] | None = None,
) -> Trajectory:
    """The trajectory of poses in space: stamps [n] [s], positions [n, 3] [m], quaternions [n, 4] (x, y, z, w) if any.

    ``lines`` say where in the file each pose stands; ``warnings`` what was assumed so far; ``else_turned`` has
    quaternions that may be meant instead, by what they are.
    """

    def refuse(wrong: ArrayLike, problem: str) -> None:
        raise InputError(problem, file=path, line=lines[int(np.argmax(wrong))] if len(lines) else None)

    if (far := (np.abs(positions) > FARTHEST).any(axis=1)).any():
        refuse(far, f"position beyond {FARTHEST:g} m, expected metres")
    why = "has no orientation" if quaternions is None else ""
    if quaternions is not None:
        length = np.linalg.norm(quaternions, axis=1)
        if not length.any() and len(length):
            quaternions, why = None, "has orientations of length 0 throughout"
        elif (bad := np.abs(length - 1) > UNIT).any():
            refuse(bad, f"quaternion of length {length[bad][0]:.3g}, expected one of length 1")
        elif _contradicts(positions, quaternions):
            shown = " ".join(f"{value:g}" for value in quaternions[0].tolist())
            why = f"has the orientation {shown} throughout, whichever way it goes"
    warnings += tuple(_doubts(path, stamps, positions, None if why else quaternions, else_turned or {}))
    if quaternions is None:
        quaternions = np.tile((0.0, 0.0, 0.0, 1.0), (len(stamps), 1))
    if why:
        text = f"{path}: {why}: taken for positions; no errors of headings, relative errors are those of distances"
        warnings += (Issue("no-orientation", text, len(stamps)),)
    poses = np.column_stack((positions[:, :2], se2.heading(quaternions)))
    flat = not len(stamps) or float(np.ptp(positions[:, 2])) < SAME
    upright = bool((np.abs(quaternions[:, :2]) < SAME).all())
    space = None if flat and upright else Space(positions, rotations_of(quaternions))
    if space is not None and (tilt := np.rad2deg(tilt_of(positions))) > np.rad2deg(TILT):
        left_out = f"of z, which is left out in x and y, the path spans {np.ptp(positions[:, 2]):.1f} m"
        text = f"{path}: moves in a plane {tilt:.0f} degrees out of x and y, as in a camera's axes: {left_out}"
        warnings += (Issue("out-of-plane", text, len(stamps)),)
    return Trajectory(stamps, poses, not why, space, warnings)


def _doubts(
    path: Path, stamps: Array, positions: Array, quaternions: Array | None, else_turned: Mapping[str, Array]
) -> Iterator[Issue]:
    """What no robot does: is at two places at once, jumps after standing, moves at 100 m/s, turns unlike its path."""
    if (n := len(stamps)) < FEW:
        return
    there = positions if quaternions is None else np.column_stack((positions, quaternions))
    kept = np.append(True, (np.diff(there, axis=0) != 0).any(axis=1) | (np.diff(stamps) > 0))  # no line twice
    there, places, zero = there[kept], positions[kept], (positions[kept] == 0).all(axis=1)
    steps, times = np.linalg.norm(np.diff(places, axis=0), axis=1), np.diff(stamps[kept])
    shared = times == 0
    apart = float(np.bincount(np.cumsum(~shared), steps * shared).max(initial=0))
    if shared.sum() > MANY * len(there) and apart > ROUNDED:
        text = f"{path}: {shared.sum()} of {n} poses have the stamp of the one before, with up to {apart:.2f} m between"
        yield Issue("equal-stamps", f"{text}: stamps were rounded; errors are wrong by that much", int(shared.sum()))
    ticks = stamps * BINARY
    even = np.diff(ticks) == np.diff(ticks).min()
    if n > SEVERAL and (ticks == np.rint(ticks)).all() and (ticks % BINARY).any() and 0.0 < even.mean() < REGULAR:
        text = f"{path}: stamps are multiples of {1 / BINARY:g} s, unevenly: digits were lost, in float32?"
        yield Issue("equal-stamps", f"{text} Errors hold what is driven in a step", n)
    for name, values in zip("xyz", map(np.unique, places.T), strict=True):
        digit = float(np.diff(values).min(initial=np.inf))
        if FEW_VALUES < len(values) < MOST_VALUES * n and digit > DIGITS:
            multiples = np.diff(values) / digit
            if np.abs(multiples - np.round(multiples)).max() < ROUNDED:
                text = f"{path}: {name} comes in steps of {digit:.3g} m: digits were lost, in float32 or in writing?"
                yield Issue("positions-rounded", f"{text} Errors hold half a step", n)
    speed = float(steps.sum() / times.sum()) if times.max(initial=0) > 1e-3 else 0.0  # or no seconds at all
    if speed > FASTEST:
        yield Issue("implausible-speed", f"{path}: moves at {speed:.3g} m/s: positions in mm? Errors are, too", n)
    still = (np.diff(there, axis=0) == 0).all(axis=1) | (zero[1:] & zero[:-1])
    begins = np.flatnonzero(np.append(True, ~still))  # of runs of poses that are all the same
    counts = np.diff(np.append(begins, len(there)))
    repeats = (counts > (1 if np.median(counts) > 1 else 2)) | zero[begins]  # a few doubles are none
    repeats[0] &= counts[0] > 1  # many begin at 0 0 0
    moves = steps[~still]  # from one run to the next
    lone = ~(repeats[1:] | repeats[:-1])
    usual = moves[lone]
    jumps = np.maximum(np.append(0, moves), np.append(moves, 0))
    held = repeats & (jumps > max(STANDS, JUMP * float(np.median(usual)) if len(usual) else 0.0))
    if held.any():
        number, first = int(counts[held].sum()), stamps[kept][begins[np.argmax(held)]]
        text = f"{path}: {number} of {n} poses, from {first:.3f} s on, repeat others to the last bit or are 0 0 0, the"
        text += f" next is up to {jumps[held].max():.2f} m away: tracking lost, or poses held? Errors are wrong by it"
        yield Issue("poses-held", text, number)
    fast = lone & (moves > FASTEST * np.maximum(times[~still], times.sum() / n))  # stamps of a burst are closer
    if 0 < speed <= FASTEST and fast.any():
        first = stamps[kept][begins[1:][np.argmax(fast)]]
        text = f"{path}: goes up to {moves[fast].max():.1f} m from a pose to the next, first at {first:.3f} s, beyond"
        text += f" {FASTEST:g} m/s: poses that are off, or a jump? Errors are wrong by it"
        yield Issue("implausible-speed", text, int(fast.sum()))
    if quaternions is None or (off := _across(positions, quaternions)) < ACROSS:
        return
    for what, others in (*else_turned.items(), ("turns, or y, of the other sign", quaternions * (-1, -1, -1, 1))):
        if _across(positions, others) < FITS * off:
            text = f"{path}: orientations would follow the path as {what}: errors of rotation and RPE are wrong"
            yield Issue("orientation-order", text, n)
            return


def _across(positions: Array, quaternions: Array) -> float:
    """How far directions of travel, or if that is more the normal of their plane, are off a fixed one of the body: the
    mean squared sine; 0 where few are known.
    """
    path = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1)))
    some = np.unique(np.searchsorted(path, np.arange(0.0, min(path[-1], 1e5), STRIDE)))
    moved = np.diff(positions[some], axis=0)
    size = np.linalg.norm(moved, axis=1)
    far = np.flatnonzero(size > STRIDE / 2)
    if len(far) < 10:
        return 0.0
    some, ways = some[np.concatenate((far, far + 1))], np.tile(moved[far] / size[far, None], (2, 1))  # at both ends
    seen = np.stack((ways, np.tile(normal_of(positions), (len(some), 1))))[:, :, None] @ rotations_of(quaternions[some])
    return 1 - float(np.linalg.eigvalsh((np.swapaxes(seen, 2, 3) @ seen).mean(axis=1))[:, -1].min())


def rotations_of(quaternions: Array) -> Array:
    """The rotation matrices [n, 3, 3] of quaternions [n, 4] (x, y, z, w) of any length but 0."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(quaternions).as_matrix())


def quaternions_of(rotations: Array) -> Array:
    """The quaternions [n, 4] (x, y, z, w) of rotation matrices [n, 3, 3], rounded ones made proper."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotations).as_quat()) if len(rotations) else np.zeros((0, 4))


def interpolated(stamps: Array, positions: Array, quaternions: Array, at: Array) -> tuple[Array, Array]:
    """Positions [m, 3] on the straight line and quaternions [m, 4] on the great circle between those of stamps [n].

    Held beyond the ends. Source: Shoemake 1985.
    """
    from scipy.spatial.transform import Rotation

    after = np.clip(np.searchsorted(stamps, at, side="right"), 1, max(len(stamps) - 1, 1))
    before, after = after - 1, np.minimum(after, len(stamps) - 1)
    gap = stamps[after] - stamps[before]
    share = np.clip((at - stamps[before]) / np.where(gap > 0, gap, np.inf), 0.0, 1.0)[:, None]
    first, last = Rotation.from_quat(quaternions[before]), Rotation.from_quat(quaternions[after])
    turned = first * Rotation.from_rotvec(share * (first.inv() * last).as_rotvec())
    return positions[before] + share * (positions[after] - positions[before]), np.asarray(turned.as_quat())


def normal_of(positions: Array) -> Array:
    """The normal [3], upward, of the plane in which a path [n, 3] lies; of a straight one the steepest."""
    off = positions - positions.mean(axis=0)
    _, size, axes = np.linalg.svd(off.T @ off)
    up = np.array((0.0, 0.0, 1.0))
    if size[0] <= len(off) * STANDS**2:
        return up
    if size[1] > 1e-4 * size[0]:
        return np.asarray(axes[2] if axes[2, 2] >= 0 else -axes[2])
    up = up - axes[0] * axes[0, 2]
    return up / np.linalg.norm(up) if np.linalg.norm(up) > SAME else np.array((1.0, 0.0, 0.0))


def tilt_of(positions: Array) -> float:
    """The angle [rad] between the plane of a path [n, 3] and that of x and y."""
    return float(np.arccos(min(1.0, normal_of(positions)[2])))


def _contradicts(positions: Array, quaternions: Array) -> bool:
    """Whether orientations are all the same where the path goes another way than ahead (x, or z of a camera)."""
    same = (np.abs(np.abs(quaternions @ quaternions[0]) / np.square(quaternions[0]).sum() - 1) < SAME).all()
    if not same or len(positions) < FEW:
        return False
    spread = ((positions - positions.mean(axis=0)) @ rotations_of(quaternions[:1])[0]).std(axis=0)
    beside = (np.hypot(spread[1], spread[2]), np.hypot(spread[0], spread[1]))
    return bool(np.linalg.norm(spread) > STANDS and min(beside) > max(STANDS, 0.05 * np.linalg.norm(spread)))
