"""Scans of ``sensor_msgs/PointCloud2``: a planar lidar's cloud, turned back into ranges by its regular angles.

Several drivers give no scans but points. Where all points of some clouds lie in one plane of their frame, at
directions that are a whole number of steps apart, the steps are the beams; a beam without a point says nothing.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.formats.bags.bag import Bag, Topic
from moteslam.robot.formats.bags.cursor import BrokenMessageError, Cursor
from moteslam.robot.formats.bags.heads import HeadReader
from moteslam.robot.formats.bags.scans import SAMPLE, Fan, Rows, Scans
from moteslam.robot.formats.bags.times import used_messages
from moteslam.robot.formats.bags.transforms import frame_name
from moteslam.robot.formats.no_return import SICK_REACH
from moteslam.robot.issues import Issue
from moteslam.robot.specs import MAX_BEAMS

PLANE = 0.05
"""Points of a planar lidar lie within this of one height in their frame [m]."""

MAX_FIELDS = 100
"""Of a point."""

_KINDS = {7: "f4", 8: "f8"}
"""Of a coordinate, by the numbers of sensor_msgs/PointField."""
_FIT = 0.1
"""How far a direction may lie from a beam's, in steps."""
_ON_STEPS = 0.98
"""Share of the points whose direction is a beam's, in a regular fan."""
_NEAREST = 0.05
"""Points nearer than this [m] are the lidar's own invalid readings, and say nothing of its angles."""
_SAME = 5e-5
"""Directions closer than this [rad] are one beam's: coordinates are float32."""


def cloud_reader(topic: Topic, *, ros1: bool) -> HeadReader:
    """What reads the heads of clouds: stamp and frame."""
    return HeadReader(len(topic), ros1=ros1, texts=1, kind="u4", width=0)


def cloud_scans(bag: Bag, topic: Topic, reader: HeadReader, issues: list[Issue]) -> Scans:
    """The scans of a topic of clouds.

    Raises:
        InputError: clouds that are not planar, whose directions are not regular, or that are broken; or absurd stamps.
    """
    heads = reader.heads()
    kept, stamps = used_messages(bag.path, topic, heads.stamps, heads.broken, issues)
    frame = frame_name(heads.texts[int(kept[0])][0])
    sample = kept[np.unique(np.linspace(0, len(kept) - 1, min(SAMPLE, len(kept))).astype(np.intp))]
    points = [_points(bag, topic, data) for data in bag.messages(topic, sample)]
    fan = _fan(bag.path, topic, points)

    def load(indices: NDArray[np.intp]) -> Rows:
        rows = np.full((len(indices), fan.beams), np.nan, np.float32)
        for row, data in zip(rows, bag.messages(topic, kept[indices]), strict=True):
            _lay(row, _points(bag, topic, data), fan)
        return rows

    return Scans(topic.name, frame, stamps, fan, load)


def _points(bag: Bag, topic: Topic, data: bytes) -> NDArray[np.float64]:
    """The finite points [n, 3] of a cloud [m]."""
    try:
        points = _parsed(data, ros1=bag.ros1)
    except (BrokenMessageError, ValueError) as error:
        raise InputError(f"a cloud is broken: {error}", file=bag.path, field=topic.name) from error
    return points[np.isfinite(points).all(axis=1)]


def _parsed(data: bytes, *, ros1: bool) -> NDArray[np.float64]:
    cursor = Cursor(data, ros1=ros1)
    cursor.position = 12
    cursor.raw_text()
    height, width, count = cursor.numbers("III")
    if count > MAX_FIELDS:
        raise BrokenMessageError(f"{count} fields of a point")
    fields = {}
    for _ in range(count):
        name = cursor.text()
        offset = cursor.number("I")
        fields[name] = (offset, cursor.number("B"))
        cursor.number("I")
    big = cursor.number("B")
    step, row_step = cursor.numbers("II")
    content = cursor.array("u1")
    columns = []
    for name in ("x", "y", "z"):
        offset, kind = fields.get(name, (0, 0))
        if kind not in _KINDS:
            raise BrokenMessageError(f"no {name} of a floating kind")
        columns.append((offset, np.dtype(f"{'>' if big else '<'}{_KINDS[kind]}")))
    if not step or max(offset + dtype.itemsize for offset, dtype in columns) > step:
        raise BrokenMessageError("coordinates beyond a point's end")
    if row_step < width * step or len(content) < row_step * height:
        raise BrokenMessageError("fewer points than it declares")
    rows = content[: row_step * height].reshape(height, row_step)[:, : width * step].reshape(height * width, step)
    return np.column_stack([_column(rows, offset, dtype) for offset, dtype in columns])


def _column(rows: NDArray[np.uint8], offset: int, dtype: np.dtype[Any]) -> NDArray[np.float64]:
    return np.ascontiguousarray(rows[:, offset : offset + dtype.itemsize]).view(dtype)[:, 0].astype(np.float64)


def _fan(path: Path, topic: Topic, clouds: list[NDArray[np.float64]]) -> Fan:
    """The fan of some clouds.

    Raises:
        InputError: they have none; one line says why.
    """
    points = np.concatenate(clouds)
    points = points[np.hypot(points[:, 0], points[:, 1]) > _NEAREST]
    if len(points) < 2:
        raise InputError("no points in its clouds, expected those of a planar lidar", file=path, field=topic.name)
    spread = float(np.quantile(np.abs(points[:, 2] - np.median(points[:, 2])), 0.99))
    if spread > PLANE:
        problem = f"points up to {spread:.2f} m from a plane, expected those of a planar lidar"
        raise InputError(problem, file=path, field=topic.name)
    angles = np.sort(np.arctan2(points[:, 1], points[:, 0]))
    starts = np.flatnonzero(np.diff(angles, prepend=-np.inf) > _SAME)
    directions = np.add.reduceat(angles, starts) / np.diff(starts, append=len(angles))
    steps = np.diff(directions)
    if not len(steps):
        raise InputError("points in one direction, expected a fan", file=path, field=topic.name)
    # the common step is the frequent one; refined over the whole fan, from the first direction to the last
    common = float(np.median(steps[steps < 1.5 * np.quantile(steps, 0.1)]))
    around = round(2 * np.pi / common)
    span = float(angles[-1] - angles[0])
    increment = 2 * np.pi / around if span > 2 * np.pi - 1.5 * common else span / max(1, round(span / common))
    beams = round(span / increment) + 1
    off = (angles - angles[0]) / increment
    regular = float((np.abs(off - np.round(off)) <= _FIT).mean())
    if regular < _ON_STEPS or beams > MAX_BEAMS:
        problem = f"directions of {1 - regular:.0%} of the points between beams, expected a regular fan"
        raise InputError(problem, file=path, field=topic.name)
    return Fan(min(beams, around), float(angles[0]), increment, 0.0, SICK_REACH)


def _lay(row: Rows, points: NDArray[np.float64], fan: Fan) -> None:
    """Put the points of a cloud into their beams; of two in one the nearer counts."""
    ranges = np.hypot(points[:, 0], points[:, 1])
    angles = np.arctan2(points[:, 1], points[:, 0])
    beams = np.rint(np.mod(angles - fan.angle_min + fan.angle_increment / 2, 2 * np.pi) / fan.angle_increment - 0.5)
    inside = (beams < fan.beams) & (ranges > 0)
    np.fmin.at(row, beams[inside].astype(np.intp), ranges[inside].astype(np.float32))
