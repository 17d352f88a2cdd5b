"""Files of trajectories, all behind `read_trajectory` and `write_trajectory`, and trajectories in ROS bags.

In a bag: ``BAG:TOPIC``, a topic of PoseStamped, PoseWithCovarianceStamped, Odometry, Path (the last message),
TransformStamped or PointStamped; and ``BAG:tf:parent:child``, the transforms from one frame to another.
"""

from array import array
from collections.abc import Callable, Iterator
from dataclasses import replace
from operator import attrgetter
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from moteslam.errors import ConfigError, InputError, OutputError
from moteslam.files import open_regular
from moteslam.robot.formats.bags.bag import Bag, is_bag
from moteslam.robot.formats.bags.definitions import decode
from moteslam.robot.formats.bags.motion import TRANSFORMS
from moteslam.robot.formats.bags.storage import Topic
from moteslam.robot.formats.lines import HEAD
from moteslam.robot.trajectories import text
from moteslam.robot.trajectories.columns import columns_of, decoded, finite_numbers, numbered
from moteslam.robot.trajectory import UNIT, Array, Trajectory, interpolated, trajectory_of
from moteslam.robot.values import Issue, counted

__all__ = ["WRITERS", "format_to_write", "is_g2o", "is_trajectory", "read_trajectory", "write_trajectory"]

WRITERS: dict[str, tuple[str, Callable[[Path, Trajectory], None]]] = {
    "g2o": (".g2o", text.write_vertices),
    "euroc": (".csv", text.write_euroc),
    "tum": (".tum", text.write_tum),
    "kitti": (".kitti", text.write_kitti),
}
"""By the format: the ending that stands for it, and what writes it."""

POSES = {
    "geometry_msgs/PoseStamped": "pose",
    "geometry_msgs/PoseWithCovarianceStamped": "pose.pose",
    "nav_msgs/Odometry": "pose.pose",
    "geometry_msgs/TransformStamped": "transform",
    "geometry_msgs/PointStamped": "point",
}
"""Where in a message the pose stands, by its type."""
PATH = "nav_msgs/Path"


def read_trajectory(path: str | PathLike[str]) -> Trajectory:
    """Read a trajectory of any format: TUM, EuRoC and other CSV, KITTI, g2o, known by the content, not by the name.

    Poses are projected to the plane; those in space are kept in ``space``. What was assumed is in ``warnings``: stamps
    that a file does not have, or in another unit; orientations that it does not have. The axes are those of the file.

    Args:
        path: of the file; of a ROS bag ``BAG:TOPIC`` or ``BAG:tf:parent:child``.
    """
    if (parts := _parts(path)) is not None:
        return _read_bag(*parts)
    path = Path(path)
    if is_bag(path):
        expected = f"expected its topic, {path.name}:TOPIC or {path.name}:tf:PARENT:CHILD"
        raise InputError(f"is a bag, {expected}; {_topics(Bag(path))}", file=path)
    return _reader(path)(path)


def write_trajectory(path: str | PathLike[str], trajectory: Trajectory, file_format: str | None = None) -> None:
    """Write a trajectory in the format of the name's ending: ``.tum``, ``.kitti``, ``.csv`` (EuRoC) or ``.g2o``.

    ``file_format`` is ``tum``, ``kitti``, ``euroc`` or ``g2o``, whatever the name ends in.
    """
    _, write = WRITERS[format_to_write(path, file_format)]
    write(Path(path), trajectory)


def format_to_write(path: str | PathLike[str], name: str | None = None) -> str:
    """The name of a format: the one that is given, or the one that the ending of a path stands for."""
    if name is not None:
        if name not in WRITERS:
            raise ConfigError(f"{name!r}, expected one of {', '.join(sorted(WRITERS))}", field="file_format")
        return name
    for known, (ending, _) in WRITERS.items():
        if Path(path).name.lower().endswith(ending):
            return known
    endings = ", ".join(sorted(ending for ending, _ in WRITERS.values()))
    raise OutputError(f"expected a name that ends in {endings}, or a format", file=path)


def is_trajectory(path: str | PathLike[str]) -> bool:
    """Whether a path is a file whose first lines are those of a trajectory, or one within a bag."""
    if (parts := _parts(path)) is not None or is_bag(Path(path)):
        return parts is not None
    try:
        _reader(path)
    except InputError:
        return False
    return True


def is_g2o(path: str | PathLike[str]) -> bool:
    """Whether a file is a pose graph of g2o."""
    return is_trajectory(path) and _parts(path) is None and _reader(path) is text.read_vertices


def _reader(path: str | PathLike[str]) -> Callable[[Path], Trajectory]:
    with open_regular(path, "a trajectory") as file:
        head = decoded(file.read(HEAD), "replace")
    comments = []
    for number, line in numbered(head):
        if line.startswith(("#", "%")):
            comments.append(line)
        elif line.startswith(("VERTEX_", "EDGE_", "PARAMS_", "FIX ")):
            return text.read_vertices
        else:
            try:
                columns_of(comments, line)
            except ValueError as error:
                row = finite_numbers(line.split())
                if row is not None and len(row) == 12:
                    return text.read_kitti
                raise InputError(str(error), file=path, line=number) from error
            return text.read_tum
    raise InputError("no poses, expected a trajectory", file=path)


def _parts(path: str | PathLike[str]) -> tuple[Path, str] | None:
    """The bag of ``BAG:TOPIC`` and what is named in it; None for other paths."""
    text = str(path)
    for at in (k for k, letter in enumerate(text) if letter == ":" and 0 < k < len(text) - 1):
        if is_bag(Path(text[:at])) and not Path(text).exists():
            return Path(text[:at]), text[at + 1 :]
    return None


def _read_bag(path: Path, name: str) -> Trajectory:
    """Read a topic of poses, or ``tf:parent:child``: the pose of the child's frame in the parent's."""
    file = Path(f"{path}:{name}")
    try:
        bag = Bag(path)
        rows, left_out = (_along(bag, name), ()) if name.startswith("tf:") else _of_topic(bag, name)
        rows, doubles = _in_order(rows)
        issues = (replace(one, message=f"{file}: {one.message}") for one in (*bag.issues, *left_out, *doubles))
        turns = rows[:, 4:] if rows[:, 4:].any() else None
        return trajectory_of(file, rows[:, 0], rows[:, 1:4], turns, warnings=tuple(issues))
    except InputError as error:
        raise InputError(error.problem, file=file, field=error.field) from error


def _messages(bag: Bag, wanted: Callable[[Topic], bool]) -> Iterator[tuple[Topic, int, Any]]:
    """The messages of some topics, with the times of their reception [ns]."""
    for topic, received, _, raw in bag.sweep(wanted):
        try:
            yield topic, received, decode(topic, raw)
        except ValueError as error:
            raise InputError(f"a message of {topic.name} cannot be read: {error}") from error


def _topics(bag: Bag) -> str:
    list(bag.sweep(lambda topic: False))
    known = {one.name: one.kind for one in bag.topics if one.kind in (*POSES, PATH, *TRANSFORMS)}
    listed = ", ".join(f"{topic[:80]} ({kind.split('/')[-1]})" for topic, kind in sorted(known.items())[:12])
    return f"topics of poses: {listed or 'none'}"


def _of_topic(bag: Bag, name: str) -> tuple[Array, tuple[Issue, ...]]:
    """Rows of stamp, position and quaternion [n, 8] of a topic."""
    rows, received = array("d"), array("d")
    frames: dict[str, None] = {}
    path = None
    name = name.strip("/")
    wanted = (*POSES, PATH)
    for topic, time, message in _messages(bag, lambda topic: topic.name.strip("/") == name and topic.kind in wanted):
        received.append(time / 1e9)
        if topic.kind == PATH:
            path = message
            continue
        rows.extend(_row(message.header.stamp, attrgetter(POSES[topic.kind])(message)))
        frames[f"{getattr(message, 'child_frame_id', '') or 'poses'} in {message.header.frame_id}"] = None
    kinds = {topic.kind for topic in bag.topics if topic.name.strip("/") == name}
    if len(kinds) != 1 or not kinds <= {*POSES, PATH}:
        what = f"is of {', '.join(sorted(kinds))}" if kinds else "is not there"
        raise InputError(f"the topic {what}; {_topics(bag)}")
    if len(frames) > 1:
        raise InputError(f"poses of several frames ({', '.join([*frames][:3])}), expected those of one")
    issues: tuple[Issue, ...] = ()
    if path is not None:
        for one in path.poses:
            rows.extend(_row(one.header.stamp, one.pose))
        if len(received) > 1:
            issues = (Issue("last-path", f"the last of {len(received)} paths counts, of {len(path.poses)} poses"),)
    table = np.array(rows).reshape(-1, 8)
    unset = table[:, 0] == 0
    if path is not None and len(table) and unset.all():
        raise InputError("the poses of the path have no stamps, expected seconds")
    if len(table) and unset.all():
        table[:, 0] = received
        issues += (Issue("no-stamps", "messages without stamps: those of the bag's reception are taken", len(table)),)
    elif count := int(unset.sum()):
        table = table[~unset]
        issues += (Issue("zero-stamps", f"{counted(count, 'message')} without a stamp left out", count),)
    return table, issues


def _row(stamp: Any, pose: Any) -> tuple[float, ...]:
    """Stamp, position and quaternion of a pose, a transform or a point."""
    place = getattr(pose, "position", getattr(pose, "translation", pose))
    turn = getattr(pose, "orientation", getattr(pose, "rotation", None))
    quaternion = 4 * (0.0,) if turn is None else (turn.x, turn.y, turn.z, turn.w)
    return ((stamp.sec * 10**9 + stamp.nanosec) / 10**9, place.x, place.y, place.z, *quaternion)


def _in_order(rows: Array) -> tuple[Array, tuple[Issue, ...]]:
    """Rows [n, 8] whose stamps rise, without those that stand twice."""
    if not len(rows):
        raise InputError("no poses, expected a trajectory")
    if not (finite := np.isfinite(rows).all(axis=1)).all():
        raise InputError(f"a pose that is not finite at message {int(np.argmin(finite))}")
    back = np.diff(rows[:, 0]) < 0
    if back.any():
        at = int(np.argmax(back))
        first = f"first from {rows[at, 0]:.3f} to {rows[at + 1, 0]:.3f} s"
        raise InputError(f"time jumps back {counted(int(back.sum()), 'time')}, {first}, expected one run")
    twice = np.concatenate(([False], (np.diff(rows, axis=0) == 0).all(axis=1)))
    if not (count := int(twice.sum())):
        return rows, ()
    return rows[~twice], (Issue("doubles", f"{counted(count, 'pose')} that stand twice left out", count),)


def _along(bag: Bag, name: str) -> Array:
    """The poses [n, 8] of a frame in another, of the transforms between, at the stamps of the most frequent."""
    from scipy.spatial.transform import Rotation

    _, *frames = (part.strip("/") for part in name.split(":"))
    if len(frames) != 2 or not all(frames):
        raise InputError("expected tf:PARENT:CHILD")
    parent, child = frames
    edges: dict[str, dict[str, array[float]]] = {}  # the frames above one, with rows of transforms
    fixed: set[tuple[str, str]] = set()
    for topic, _, message in _messages(bag, lambda topic: topic.kind in TRANSFORMS):
        for one in message.transforms:
            below, above = one.child_frame_id.strip("/"), one.header.frame_id.strip("/")
            rows = edges.setdefault(below, {}).setdefault(above, array("d"))
            if topic.name.endswith("tf_static"):
                fixed.add((below, above))
                del rows[:]  # the last counts
            rows.extend(_row(one.header.stamp, one.transform))
    under = {child: ""}  # from the child upward by the shortest way, which frame is below one
    for below in (queue := [child]):
        new = [above for above in edges.get(below, ()) if above not in under]
        under |= dict.fromkeys(new, below)
        queue += new
    if parent not in under:
        pairs = ", ".join([f"{above}:{below}" for below, some in edges.items() for above in some][:12])
        raise InputError(f"no transforms lead from {parent} to {child}; the bag has {pairs or 'none'}")
    chain, above = list[tuple[str, str]](), parent
    while above != child:
        chain.insert(0, (under[above], above))
        above = under[above]
    tables = [_in_order(np.array(edges[below][above]).reshape(-1, 8))[0] for below, above in chain]
    for (below, above), table in zip(chain, tables, strict=True):
        if not (np.abs(np.linalg.norm(table[:, 4:], axis=1) - 1) < UNIT).all():
            raise InputError(f"{above}:{below} has a quaternion of another length than 1")
    moving = [table[:, 0] for edge, table in zip(chain, tables, strict=True) if edge not in fixed]
    if not moving:
        raise InputError(f"{parent}:{child} is fixed, expected a frame that moves")
    stamps = max(moving, key=len)
    stamps = stamps[(stamps >= max(some[0] for some in moving)) & (stamps <= min(some[-1] for some in moving))]
    if not len(stamps):
        raise InputError(f"the transforms from {parent} to {child} have no time in common")
    position, rotation = np.zeros((len(stamps), 3)), Rotation.identity(len(stamps))
    for table in tables:  # from the child upward
        where, quaternions = interpolated(table[:, 0], table[:, 1:4], table[:, 4:], stamps)
        turn = Rotation.from_quat(quaternions)
        position, rotation = where + turn.apply(position), turn * rotation
    return np.column_stack((stamps, position, rotation.as_quat()))
