"""Several planar lidars as one fan about the robot's centre.

A scan of the first lidar is joined with the scan of each other one that is nearest in time; what the robot moves in
between, at most half the time between two scans, is left out of account. Every endpoint falls into the beam of its
direction from the robot's centre, and the nearest one in a beam counts. A beam without one has no return if a beam of
a lidar without return ends in it, put at that lidar's limit; a beam in which nothing falls says nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.formats.bags.mount import Mount
from moteslam.robot.formats.bags.scans import Fan, Rows, Scans
from moteslam.robot.specs import MAX_BEAMS
from moteslam.robot.stamps import nearest_stamp

GAP = 1.5
"""A scan further away in time than this many times between two scans is not joined: that lidar was silent."""


@dataclass(frozen=True, eq=False)
class _Part:
    """One of the lidars.

    Attributes:
        scans: of it.
        fan: with its limits, upside down where it hangs so.
        mount: where it stands.
        nearest: [n] its scan for each scan of the first lidar; -1 where there is none near.
    """

    scans: Scans
    fan: Fan
    mount: Mount
    nearest: NDArray[np.intp]


def merged_scans(path: Path, lidars: list[Scans], mounts: list[Mount]) -> Scans:
    """The scans of several lidars as one fan about the robot's centre.

    Args:
        path: of the bag.
        lidars: two or more; the first sets the stamps.
        mounts: of each.

    Raises:
        InputError: two of them stand at one place looking the same way, as lidars without transforms seem to.
    """
    first = lidars[0]
    fans = [
        scans.fan.flipped() if mount.upside_down else scans.fan for scans, mount in zip(lidars, mounts, strict=True)
    ]
    beams = min(MAX_BEAMS, round(2 * np.pi / min(abs(fan.angle_increment) for fan in fans)))
    reach = max(fan.range_max + float(np.hypot(mount.x, mount.y)) for fan, mount in zip(fans, mounts, strict=True))
    whole = Fan(beams, -np.pi + np.pi / beams, 2 * np.pi / beams, 0.0, reach)
    if len(set(mounts)) < len(mounts):
        names = ", ".join(scans.topic for scans in lidars)
        raise InputError("two lidars at one place, expected a transform to each", file=path, field=names)
    parts = [
        _Part(scans, fan, mount, _nearest(first.stamps, scans.stamps))
        for scans, fan, mount in zip(lidars, fans, mounts, strict=True)
    ]

    def load(indices: NDArray[np.intp]) -> Rows:
        rows = np.full((len(indices), beams), np.nan, np.float32)
        for part in parts:
            _lay(rows, part, indices, whole)
        return rows

    return Scans(", ".join(scans.topic for scans in lidars), "", first.stamps, whole, load)


def _nearest(stamps: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.intp]:
    found = nearest_stamp(others, stamps)
    period = float(np.median(np.diff(others))) if len(others) > 1 else 0.0
    return np.where(np.abs(others[found] - stamps) <= GAP * period, found, -1)


def _lay(rows: Rows, part: _Part, indices: NDArray[np.intp], whole: Fan) -> None:
    """Lay the scans of a lidar into the rows [k, beams] of the whole fan; what is nearer stays."""
    there = part.nearest[indices]
    used = np.flatnonzero(there >= 0)
    if not len(used):
        return
    ranges = part.scans.cleaned(there[used], part.fan).astype(np.float64)
    echo = np.isfinite(ranges)
    placed = np.where(np.isinf(ranges), part.fan.range_max, ranges)
    angles = part.mount.yaw + part.fan.angle_min + part.fan.angle_increment * np.arange(part.fan.beams)
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
