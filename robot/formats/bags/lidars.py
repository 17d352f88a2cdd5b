"""Lidars that give clouds in place of scans, and several lidars as one fan about the robot's centre.

Where all points of some clouds (``sensor_msgs/PointCloud2``) lie in one plane of their frame, at directions that are a
whole number of steps apart, the steps are the beams; a beam without a point says nothing.

Of several lidars a scan of the first is joined with the scan of each other one that is nearest in time; what the robot
moves in between, at most half the time between two scans, is left out of account. Every endpoint falls into the beam of
its direction from the robot's centre, and the nearest one in a beam counts. A beam without one has no return if a beam
of a lidar without return ends in it, put at that lidar's limit; a beam in which nothing falls says nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.formats.bags.bag import Bag, Table, Topic
from moteslam.robot.formats.bags.frames import Mount
from moteslam.robot.formats.bags.scans import SAMPLE, Ranges, Scans, lay
from moteslam.robot.formats.bags.times import Rows, Times
from moteslam.robot.formats.streams import SICK_REACH, Fan
from moteslam.robot.platform import MAX_BEAMS
from moteslam.robot.recording import nearest_stamp

GAP = 1.5
"""A scan further away in time than this many times between two scans is not joined: that lidar was silent."""

PLANE = 0.05
"""Points of a planar lidar lie within this of one height in their frame [m]."""

_FIT, _ON_STEPS = 0.1, 0.98
"""How far a direction may lie from a beam's, in steps, and the share of the points that lie so in a regular fan."""
_NEAREST = 0.05
"""Points nearer than this [m] are the lidar's own invalid readings, and say nothing of its angles."""
_SAME = 5e-5
"""Directions closer than this [rad] are one beam's: coordinates are float32."""


def cloud_scans(bag: Bag, table: Table, times: Times) -> Scans:
    """The scans of a topic of clouds."""
    kept, stamps = times.used(table)
    places = table.places_of(kept)

    def points_of(data: bytes) -> NDArray[np.float64]:
        try:
            points = _points(bag.decode(table.topic, data))
        except ValueError as error:
            raise InputError(f"a cloud is broken: {error}", file=bag.path, field=table.topic.name) from error
        return points[np.isfinite(points).all(axis=1)]

    sample = np.unique(np.linspace(0, len(kept) - 1, min(SAMPLE, len(kept))).astype(np.intp))
    fan = _fan(bag.path, table.topic, np.concatenate([points_of(data) for data in bag.payloads(places[sample])]))

    def load(indices: Rows) -> Ranges:
        rows = np.full((len(indices), fan.beams), np.nan, np.float32)
        for row, data in zip(rows, bag.payloads(places[indices]), strict=True):
            x, y, _ = points_of(data).T
            ranges = np.hypot(x, y)
            lay(row, ranges[ranges > 0].astype(np.float32), np.arctan2(y, x)[ranges > 0], fan)
        return rows

    return Scans(table.topic.name, table.frame(int(kept[0])), stamps, fan, load)


def _points(cloud: Any) -> NDArray[np.float64]:
    """The points [n, 3] of a cloud [m]."""
    height, width, step, row_step = cloud.height, cloud.width, cloud.point_step, cloud.row_step
    if row_step < width * step or len(cloud.data) < row_step * height:
        raise ValueError("fewer points than it declares")
    rows = cloud.data[: row_step * height].reshape(height, row_step)[:, : width * step].reshape(height * width, step)
    kinds = {7: "f4", 8: "f8"}  # sensor_msgs/PointField
    fields = {field.name: field for field in cloud.fields if field.datatype in kinds}
    if not {"x", "y", "z"} <= fields.keys():
        raise ValueError("no x, y and z of a floating kind")
    order, places = ">" if cloud.is_bigendian else "<", [fields[name] for name in "xyz"]
    formats, offsets = [order + kinds[place.datatype] for place in places], [place.offset for place in places]
    dtype = np.dtype({"names": ["x", "y", "z"], "formats": formats, "offsets": offsets, "itemsize": step})
    points = np.ascontiguousarray(rows).reshape(-1).view(dtype)
    return np.column_stack([points[name].astype(np.float64) for name in "xyz"])


def _fan(path: Path, topic: Topic, points: NDArray[np.float64]) -> Fan:
    """The fan of the points [n, 3] of some clouds."""
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
    return Fan(float(angles[0]), increment, 0.0, SICK_REACH, min(beams, around))


@dataclass(frozen=True, eq=False)
class _Part:
    """One of several lidars: scans, fan, mount, and its scan [n] for each of the first, -1 where there is none near."""

    scans: Scans
    fan: Fan
    mount: Mount
    nearest: Rows


def merged_scans(path: Path, lidars: list[Scans], mounts: list[Mount]) -> Scans:
    """The scans of two or more lidars as one fan about the robot's centre; the first sets the stamps."""
    first = lidars[0]
    fans = [one.fan.flipped() if mount.upside_down else one.fan for one, mount in zip(lidars, mounts, strict=True)]
    beams = min(MAX_BEAMS, round(2 * np.pi / min(abs(fan.angle_increment) for fan in fans)))
    reach = max(fan.range_max + float(np.hypot(mount.x, mount.y)) for fan, mount in zip(fans, mounts, strict=True))
    whole = Fan(-np.pi + np.pi / beams, 2 * np.pi / beams, 0.0, reach, beams)
    if len(set(mounts)) < len(mounts):
        names = ", ".join(scans.topic for scans in lidars)
        problem = (
            f'two lidars at one place, expected a transform to each, or a table [lidars."{first.topic}"] with x, y, '
        )
        raise InputError(f"{problem}yaw for each in the platform's file", file=path, field=names)
    parts = [
        _Part(scans, fan, mount, _nearest(first.stamps, scans.stamps))
        for scans, fan, mount in zip(lidars, fans, mounts, strict=True)
    ]

    def load(indices: Rows) -> Ranges:
        rows = np.full((len(indices), beams), np.nan, np.float32)
        for part in parts:
            _join(rows, part, indices, whole)
        return rows

    return Scans(", ".join(scans.topic for scans in lidars), "", first.stamps, whole, load)


def _nearest(stamps: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.intp]:
    found = nearest_stamp(others, stamps)
    period = float(np.median(np.diff(others))) if len(others) > 1 else 0.0
    return np.where(np.abs(others[found] - stamps) <= GAP * period, found, -1)


def _join(rows: Ranges, part: _Part, indices: Rows, whole: Fan) -> None:
    """Lay the scans of a lidar into the rows [k, beams] of the whole fan; what is nearer stays."""
    there = part.nearest[indices]
    used = np.flatnonzero(there >= 0)
    if not len(used):
        return
    ranges = part.scans.cleaned(there[used], part.fan).astype(np.float64)
    echo = np.isfinite(ranges)
    placed = np.where(np.isinf(ranges), part.fan.range_max, ranges)
    angles = part.mount.yaw + part.fan.angles
    x, y = part.mount.x + placed * np.cos(angles), part.mount.y + placed * np.sin(angles)
    known = np.isfinite(placed)
    turn = np.mod(np.arctan2(y[known], x[known]) + np.pi, 2 * np.pi)
    column = np.minimum((turn / whole.angle_increment).astype(np.intp), whole.beams - 1)
    row = np.broadcast_to(used[:, None], ranges.shape)[known]
    found = np.where(echo[known], np.hypot(x[known], y[known]), np.inf).astype(np.float32)
    laid = np.where(np.isnan(rows), np.inf, rows)  # as far as an endpoint goes, what says nothing is beyond reach
    np.minimum.at(laid, (row, column), found)
    seen = ~np.isnan(rows)
    seen[row, column] = True
    rows[:] = np.where(seen, laid, np.nan)
