"""Files of trajectories, all behind `read_trajectory` and `write_trajectory`, and trajectories in ROS bags.

In a bag: ``BAG:TOPIC``, a topic of PoseStamped, PoseWithCovarianceStamped, Odometry, Path (the last message),
TransformStamped or PointStamped; and ``BAG:tf:parent:child``, the transforms from one frame to another.
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from moteslam.errors import ConfigError, InputError, OutputError
from moteslam.robot.files import open_regular
from moteslam.robot.formats.bags.bag import Bag, is_bag
from moteslam.robot.formats.bags.motion import TRANSFORMS
from moteslam.robot.formats.bags.storage import Topic, decode
from moteslam.robot.trajectories import g2o, text
from moteslam.robot.trajectories.columns import decoded
from moteslam.robot.trajectories.text import TrajectoryFormat
from moteslam.robot.trajectory import UNIT, Array, Trajectory, interpolated, quaternions_of, rotations_of, trajectory_of
from moteslam.robot.values import Issue, counted

__all__ = [
    "TRAJECTORY_FORMATS",
    "TrajectoryFormat",
    "is_trajectory",
    "parts_of",
    "read_trajectory",
    "trajectory_format_of",
    "trajectory_format_to_write",
    "write_trajectory",
]

TRAJECTORY_FORMATS = {
    "g2o": g2o.FORMAT,
    "euroc": text.EUROC_FORMAT,
    "tum": text.TUM_FORMAT,
    "kitti": text.KITTI_FORMAT,
}
"""By name, asked in this order."""

HEAD = 1 << 18
"""Bytes of a file that are looked at to know its format."""
NOWHERE = (0.0, 0.0, 0.0, 0.0)
POSES: dict[str, Callable[[Any], tuple[Any, Any]]] = {
    "geometry_msgs/PoseStamped": lambda message: (message.pose.position, message.pose.orientation),
    "geometry_msgs/PoseWithCovarianceStamped": lambda message: (
        message.pose.pose.position,
        message.pose.pose.orientation,
    ),
    "nav_msgs/Odometry": lambda message: (message.pose.pose.position, message.pose.pose.orientation),
    "geometry_msgs/TransformStamped": lambda message: (message.transform.translation, message.transform.rotation),
    "geometry_msgs/PointStamped": lambda message: (message.point, None),
}
"""Position and orientation of a message, by its type."""
PATH = "nav_msgs/Path"


def read_trajectory(path: str | PathLike[str]) -> Trajectory:
    """Read a trajectory in any format known here (`TRAJECTORY_FORMATS`): it is known by the content, not by the name.

    Poses are projected to the plane; those in space are kept in ``space``. What was assumed is in ``warnings``: stamps
    that a file does not have, or in another unit; orientations that it does not have. The axes are those of the file.

    Args:
        path: of the file; of a ROS bag ``BAG:TOPIC`` or ``BAG:tf:parent:child``.
    """
    if (parts := parts_of(path)) is not None:
        return _read_bag(*parts)
    path = Path(path)
    if is_bag(Path(path)):
        raise InputError(_without_topic(path), file=path)
    return trajectory_format_of(path).read(path)


def write_trajectory(path: str | PathLike[str], trajectory: Trajectory, file_format: str | None = None) -> None:
    """Write a trajectory in the format of the name's ending: ``.tum``, ``.kitti``, ``.csv`` (EuRoC) or ``.g2o``.

    ``file_format`` is ``tum``, ``kitti``, ``euroc`` or ``g2o``, whatever the name ends in.
    """
    _, known = trajectory_format_to_write(path, file_format)
    known.write(Path(path), trajectory)


def trajectory_format_to_write(path: str | PathLike[str], name: str | None = None) -> tuple[str, TrajectoryFormat]:
    """The name of a format and the format itself: the one named, or the one that the ending of a path stands for."""
    if name is not None:
        if name not in TRAJECTORY_FORMATS:
            names = ", ".join(sorted(TRAJECTORY_FORMATS))
            raise ConfigError(f"{name!r}, expected one of {names}", field="file_format")
        return name, TRAJECTORY_FORMATS[name]
    for each, known in TRAJECTORY_FORMATS.items():
        if Path(path).name.lower().endswith(known.endings):
            return each, known
    endings = sorted(ending for known in TRAJECTORY_FORMATS.values() for ending in known.endings)
    raise OutputError(f"expected a name that ends in {', '.join(endings)}, or a format", file=path)


def is_trajectory(path: str | PathLike[str]) -> bool:
    """Whether a path is a file whose first lines are those of a trajectory, or one within a bag."""
    if (parts := parts_of(path)) is not None or is_bag(Path(path)):
        return parts is not None
    try:
        trajectory_format_of(path)
    except InputError:
        return False
    return True


def trajectory_format_of(path: str | PathLike[str]) -> TrajectoryFormat:
    """The format of a file, by its comments and its first line that is none."""
    with open_regular(path, "a trajectory") as file:
        head = decoded(file.read(HEAD), "replace")
    comments = ""
    for number, line in enumerate(head.splitlines(), start=1):
        line = line.strip()
        if line.startswith(("#", "%")):
            comments += line + "\n"
        elif line:
            for known in TRAJECTORY_FORMATS.values():
                if known.recognise(comments, line):
                    return known
            names = ", ".join(known.name for known in TRAJECTORY_FORMATS.values())
            raise InputError(f"no line of a trajectory, expected one of {names}", file=path, line=number)
    raise InputError("no poses, expected a trajectory", file=path)


def parts_of(path: str | PathLike[str]) -> tuple[Path, str] | None:
    """The bag of ``BAG:TOPIC`` and what is named in it; None where a path is not of this form."""
    text = str(path)
    for at in (k for k, letter in enumerate(text) if letter == ":" and 0 < k < len(text) - 1):
        if is_bag(Path(text[:at])) and not Path(text).exists():
            return Path(text[:at]), text[at + 1 :]
    return None


def _without_topic(bag: Path) -> str:
    """What is wrong with a bag whose topic is not named, with those that may be."""
    expected = f"expected its topic, {bag.name}:TOPIC or {bag.name}:tf:PARENT:CHILD"
    return f"is a bag, {expected}; {_topics(Bag(bag))}"


def _read_bag(path: Path, name: str) -> Trajectory:
    """Read a topic of poses, or ``tf:parent:child``: the pose of the child's frame in the parent's."""
    file = Path(f"{path}:{name}")
    try:
        bag = Bag(path)
        rows, left_out = (_along(bag, name), ()) if name.startswith("tf:") else _of_topic(bag, name)
        stamps, positions, quaternions, more = _in_order(rows)
        issues = tuple(replace(one, message=f"{file}: {one.message}") for one in (*bag.issues, *left_out, *more))
        return trajectory_of(file, stamps, positions, quaternions if rows[:, 4:].any() else None, warnings=issues)
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
    for _ in bag.sweep(lambda _: False):
        pass
    known = {one.name: one.kind for one in bag.topics if one.kind in (*POSES, PATH, *TRANSFORMS)}
    listed = ", ".join(f"{topic[:80]} ({kind.split('/')[-1]})" for topic, kind in sorted(known.items())[:12])
    return f"topics of poses: {listed or 'none'}"


def _of_topic(bag: Bag, name: str) -> tuple[Array, tuple[Issue, ...]]:
    """Rows of stamp, position and quaternion [n, 8] of a topic."""

    def is_named(topic: Topic) -> bool:
        return topic.name.strip("/") == name.strip("/")

    rows, frames, received = array("d"), Counter[tuple[str, str]](), array("d")
    issues: tuple[Issue, ...] = ()
    count, path = 0, None
    for topic, time, message in _messages(bag, lambda one: is_named(one) and one.kind in (*POSES, PATH)):
        if topic.kind == PATH:
            count, path = count + 1, message  # the last counts
            continue
        frames[message.header.frame_id, getattr(message, "child_frame_id", "")] += 1
        rows.extend(_row(message.header.stamp, *POSES[topic.kind](message)))
        received.append(time / 1e9)
    kinds = {one.kind for one in bag.topics if is_named(one)}
    if len(kinds) != 1 or not kinds <= {*POSES, PATH}:
        what = f"is of {', '.join(sorted(kinds))}" if kinds else "is not there"
        raise InputError(f"the topic {what}; {_topics(bag)}")
    if path is not None:
        for stamped in path.poses:
            frames[path.header.frame_id, ""] += 1
            rows.extend(_row(stamped.header.stamp, *POSES["geometry_msgs/PoseStamped"](stamped)))
        if count > 1:
            issues = (Issue("last-path", f"the last of {count} paths counts, of {len(path.poses)} poses", 1),)
    table = np.array(rows).reshape(-1, 8)
    if len(frames) > 1:
        shown = ", ".join(f"{child or 'poses'} in {parent}" for parent, child in list(frames)[:3])
        raise InputError(f"poses of several frames ({shown}), expected those of one")
    if len(table) and not table[:, 0].any():
        if path is not None:
            raise InputError("the poses of the path have no stamps, expected seconds")
        table[:, 0] = received
        issues += (Issue("no-stamps", "messages without stamps: those of the bag's reception are taken", len(table)),)
    elif (none := int((table[:, 0] == 0).sum())) and len(table) > none:
        table = table[table[:, 0] != 0]
        issues += (Issue("zero-stamps", f"{counted(none, 'message')} without a stamp left out", none),)
    return table, issues


def _row(stamp: Any, position: Any, orientation: Any) -> tuple[float, ...]:
    turn = NOWHERE if orientation is None else (orientation.x, orientation.y, orientation.z, orientation.w)
    return ((stamp.sec * 10**9 + stamp.nanosec) / 10**9, position.x, position.y, position.z, *turn)


def _in_order(rows: Array) -> tuple[Array, Array, Array, tuple[Issue, ...]]:
    """Rising stamps, positions and quaternions of rows [n, 8], without those that stand twice."""
    if not len(rows):
        raise InputError("no poses, expected a trajectory")
    if not np.isfinite(rows).all():
        raise InputError(f"a pose that is not finite at message {int(np.argmin(np.isfinite(rows).all(axis=1)))}")
    back = np.diff(rows[:, 0]) < 0
    if back.any():
        at = int(np.argmax(back))
        first = f"first from {rows[at, 0]:.3f} to {rows[at + 1, 0]:.3f} s"
        raise InputError(f"time jumps back {counted(int(back.sum()), 'time')}, {first}, expected one run")
    twice = np.concatenate(([False], (np.diff(rows, axis=0) == 0).all(axis=1)))
    issues: tuple[Issue, ...] = ()
    if twice.any():
        issues = (Issue("doubles", f"{counted(int(twice.sum()), 'pose')} that stand twice left out", int(twice.sum())),)
    rows = rows[~twice]
    return rows[:, 0], rows[:, 1:4], rows[:, 4:], issues


def _along(bag: Bag, name: str) -> Array:
    """The poses [n, 8] of a frame in another, of the transforms between, at the stamps of the most frequent."""
    _, *frames = (part.strip("/") for part in name.split(":"))
    if len(frames) != 2 or not all(frames):
        raise InputError("expected tf:PARENT:CHILD")
    parent, child = frames
    edges: dict[tuple[str, str], array[float]] = {}
    fixed: set[tuple[str, str]] = set()
    for topic, _, message in _messages(bag, lambda topic: topic.kind in TRANSFORMS):
        for one in message.transforms:
            edge = one.child_frame_id.strip("/"), one.header.frame_id.strip("/")
            row = _row(one.header.stamp, one.transform.translation, one.transform.rotation)
            if topic.name.endswith("tf_static"):
                fixed.add(edge)
                edges[edge] = array("d", row)  # the last counts
            else:
                edges.setdefault(edge, array("d")).extend(row)
    chain = _chain(list(edges), parent, child)
    if chain is None:
        pairs = ", ".join(f"{above}:{below}" for below, above in list(edges)[:12])
        raise InputError(f"no transforms lead from {parent} to {child}; the bag has {pairs or 'none'}")
    tables = [np.column_stack(_in_order(np.array(edges[edge]).reshape(-1, 8))[:3]) for edge in chain]
    for (below, above), table in zip(chain, tables, strict=True):
        if not (np.abs(np.linalg.norm(table[:, 4:], axis=1) - 1) < UNIT).all():
            raise InputError(f"{above}:{below} has a quaternion of another length than 1")
    moving = [table for edge, table in zip(chain, tables, strict=True) if edge not in fixed]
    if not moving:
        raise InputError(f"{parent}:{child} is fixed, expected a frame that moves")
    stamps = max(moving, key=len)[:, 0]
    begin, end = max(table[0, 0] for table in moving), min(table[-1, 0] for table in moving)
    stamps = stamps[(stamps >= begin) & (stamps <= end)]
    if not len(stamps):
        raise InputError(f"the transforms from {parent} to {child} have no time in common")
    position, rotation = np.zeros((len(stamps), 3)), np.tile(np.eye(3), (len(stamps), 1, 1))
    for table in tables:  # from the child upward
        where, turn = interpolated(table[:, 0], table[:, 1:4], table[:, 4:], stamps)
        turn = rotations_of(turn)
        position, rotation = where + (turn @ position[:, :, None])[:, :, 0], turn @ rotation
    if len(chain) == 1:
        return np.column_stack((stamps, *interpolated(tables[0][:, 0], tables[0][:, 1:4], tables[0][:, 4:], stamps)))
    return np.column_stack((stamps, position, quaternions_of(rotation)))


def _chain(edges: list[tuple[str, str]], parent: str, child: str) -> list[tuple[str, str]] | None:
    """The shortest way of edges (below, above) upward from one frame to another."""
    ways: list[list[tuple[str, str]]] = [[edge] for edge in edges if edge[0] == child]
    seen = {child}
    while ways:
        longer = []
        for way in ways:
            top = way[-1][1]
            if top == parent:
                return way
            if top not in seen:
                seen.add(top)
                longer += [[*way, edge] for edge in edges if edge[0] == top]
        ways = longer
    return None
