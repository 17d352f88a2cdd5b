"""Trajectories in ROS bags: ``BAG:TOPIC``, and ``BAG:tf:parent:child``, the transforms from one frame to another.

Topics of PoseStamped, PoseWithCovarianceStamped, Odometry, Path (the last message), TransformStamped and PointStamped.
"""

from __future__ import annotations

import warnings
from array import array
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from moteslam.errors import InputError
from moteslam.robot.trajectory import UNIT, Array, Trajectory, interpolated, quaternions_of, rotations_of, trajectory_of
from moteslam.robot.values import Issue, counted

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

ENDINGS = (".bag", ".mcap", ".db3", ".active")
PARTS = ("*.mcap", "*.db3")
NOWHERE = (0.0, 0.0, 0.0, 0.0)
POSES: dict[str, Callable[[Any], tuple[Any, Any]]] = {
    "geometry_msgs/msg/PoseStamped": lambda message: (message.pose.position, message.pose.orientation),
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda message: (
        message.pose.pose.position,
        message.pose.pose.orientation,
    ),
    "nav_msgs/msg/Odometry": lambda message: (message.pose.pose.position, message.pose.pose.orientation),
    "geometry_msgs/msg/TransformStamped": lambda message: (message.transform.translation, message.transform.rotation),
    "geometry_msgs/msg/PointStamped": lambda message: (message.point, None),
}
"""Position and orientation of a message, by its type."""
PATH = "nav_msgs/msg/Path"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
MOST = 20_000_000
"""Poses of a topic, and transforms of a bag, are no more."""


def parts_of(path: str | PathLike[str]) -> tuple[Path, str] | None:
    """The bag of ``BAG:TOPIC`` and what is named in it; None where a path is not of this form."""
    text = str(path)
    for at in (k for k, letter in enumerate(text) if letter == ":" and 0 < k < len(text) - 1):
        if is_bag(text[:at]) and not Path(text).exists():
            return Path(text[:at]), text[at + 1 :]
    return None


def is_bag(path: str | PathLike[str]) -> bool:
    """Whether a path is a bag: a file of ROS 1, MCAP or SQLite, or a folder of ROS 2, by its name."""
    path = Path(path)
    try:
        if path.suffix in ENDINGS:
            return path.is_file()
        return path.is_dir() and ((path / "metadata.yaml").is_file() or bool(_parts(path)))
    except (OSError, ValueError):
        return False


def _parts(folder: Path) -> list[Path]:
    """The files of a recording in a folder."""
    return next((sorted(found) for kind in PARTS if (found := list(folder.glob(kind)))), [])


def without_topic(bag: Path) -> str:
    """What is wrong with a bag whose topic is not named, with those that may be."""
    with _opened(bag) as reader:
        return f"is a bag, expected its topic, {bag.name}:TOPIC or {bag.name}:tf:PARENT:CHILD; {_topics(reader)}"


def read_bag(bag: Path, name: str) -> Trajectory:
    """Read a topic of poses, or ``tf:parent:child``: the pose of the child's frame in the parent's."""
    file = Path(f"{bag}:{name}")
    left_out: tuple[Issue, ...] = ()
    try:
        with _opened(bag) as reader:
            if name.startswith("tf:"):
                rows = _along(reader, name)
            else:
                rows, left_out = _of_topic(reader, name)
            if len(reader.paths) > 1:
                text = f"no metadata.yaml: {len(reader.paths)} files are taken for parts of one recording"
                left_out += (Issue("no-metadata", text, len(reader.paths)),)
        stamps, positions, quaternions, more = _in_order(rows)
        issues = tuple(Issue(one.code, f"{file}: {one.message}", one.count) for one in (*left_out, *more))
        return trajectory_of(file, stamps, positions, quaternions if rows[:, 4:].any() else None, warnings=issues)
    except InputError as error:
        raise InputError(error.problem, file=f"{bag}:{name}", field=error.field) from error


@contextmanager
def _opened(bag: Path) -> Iterator[AnyReader]:
    """A bag; whatever the library stumbles over is an error of one line."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    if bag.suffix == ".active":
        raise InputError("was not closed and has no index, expected a bag that rosbag reindex has mended", file=bag)
    files = _parts(bag) if bag.is_dir() else [bag]
    for log in (file.with_name(f"{file.name}-wal") for file in files):
        if log.exists() and log.stat().st_size:
            expected = "expected it merged: sqlite3 FILE 'PRAGMA wal_checkpoint(TRUNCATE)'"
            raise InputError(f"{log.name} beside it holds the latest messages, {expected}", file=bag)
    if not bag.is_dir() or (bag / "metadata.yaml").is_file():
        files = [bag]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with AnyReader(files, default_typestore=get_typestore(Stores.LATEST)) as reader:
                yield reader
    except InputError:
        raise
    except Exception as error:
        said = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"cannot be read as a bag: {said}", file=bag) from error


def _topics(reader: AnyReader) -> str:
    known = {one.topic: one.msgtype for one in reader.connections if one.msgtype in (*POSES, PATH, *TRANSFORMS)}
    listed = ", ".join(f"{topic[:80]} ({kind.split('/')[-1]})" for topic, kind in sorted(known.items())[:12])
    return f"topics of poses: {listed or 'none'}"


def _of_topic(reader: AnyReader, name: str) -> tuple[Array, tuple[Issue, ...]]:
    """Rows of stamp, position and quaternion [n, 8] of a topic."""
    there = [one for one in reader.connections if one.topic.strip("/") == name.strip("/")]
    kinds = {one.msgtype for one in there}
    if len(kinds) != 1 or not kinds <= {*POSES, PATH}:
        what = f"is of {', '.join(sorted(kinds))}" if kinds else "is not there"
        raise InputError(f"the topic {what}; {_topics(reader)}")
    (kind,) = kinds
    rows, frames = array("d"), Counter[tuple[str, str]]()
    issues: tuple[Issue, ...] = ()
    if kind == PATH:
        count, raw = 0, b""
        for count, (_, _, raw) in enumerate(reader.messages(there), start=1):  # noqa: B007 - the last counts
            pass
        if not count:
            raise InputError("no messages, expected a path")
        path: Any = reader.deserialize(raw, kind)
        for stamped in path.poses:
            frames[path.header.frame_id, ""] += 1
            rows.extend(_row(stamped.header.stamp, *POSES["geometry_msgs/msg/PoseStamped"](stamped)))
        if count > 1:
            issues = (Issue("last-path", f"the last of {count} paths counts, of {len(path.poses)} poses", 1),)
    received = array("d")
    if kind != PATH:
        for connection, time, raw in reader.messages(there):
            message: Any = reader.deserialize(raw, connection.msgtype)
            frames[message.header.frame_id, getattr(message, "child_frame_id", "")] += 1
            rows.extend(_row(message.header.stamp, *POSES[kind](message)))
            received.append(time / 1e9)
            if len(received) > MOST:
                raise InputError(f"over {MOST} poses, expected fewer")
    table = np.array(rows).reshape(-1, 8)
    if len(frames) > 1:
        shown = ", ".join(f"{child or 'poses'} in {parent}" for parent, child in list(frames)[:3])
        raise InputError(f"poses of several frames ({shown}), expected those of one")
    if len(table) and not table[:, 0].any():
        if kind == PATH:
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


def _along(reader: AnyReader, name: str) -> Array:
    """The poses [n, 8] of a frame in another, of the transforms between, at the stamps of the most frequent."""
    _, *frames = (part.strip("/") for part in name.split(":"))
    if len(frames) != 2 or not all(frames):
        raise InputError("expected tf:PARENT:CHILD")
    parent, child = frames
    edges: dict[tuple[str, str], array[float]] = {}
    fixed: set[tuple[str, str]] = set()
    there = [one for one in reader.connections if one.msgtype in TRANSFORMS]
    count = 0
    for connection, _, raw in reader.messages(there) if there else ():
        message: Any = reader.deserialize(raw, connection.msgtype)
        for one in message.transforms:
            edge = one.child_frame_id.strip("/"), one.header.frame_id.strip("/")
            row = _row(one.header.stamp, one.transform.translation, one.transform.rotation)
            if connection.topic.endswith("tf_static"):
                fixed.add(edge)
                edges[edge] = array("d", row)  # the last counts
            else:
                edges.setdefault(edge, array("d")).extend(row)
            if (count := count + 1) > MOST:
                raise InputError(f"over {MOST} transforms, expected fewer")
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
