"""Scans of an interlaced lidar in a CARMEN log, brought to one grid of bearings.

A SICK LMS that measures every degree can begin each scan at another quarter or half of one, so that several scans
together are four or two times as dense. Its log has that many kinds of scan, in turns.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from moteslam.robot.formats.carmen_lines import ScanKind, Scans

MAX_INTERLACE = 8
"""Bearings of the grid in a step between beams, at most; a SICK LMS has 2 or 4."""

SAME_ANGLE = 1e-4
"""First angles are taken for those of the grid when they are this near [rad]; logs have six digits."""


class Interlaced(NamedTuple):
    """The scans of an interlaced lidar.

    Attributes:
        kind: line, number of beams, first angle and step [rad] of the grid.
        scans: in the order of the file; 0, which says nothing, at the beams that a scan does not measure.
        interlace: a scan measures every so manieth beam of the grid.
        kinds: those of the log that are in it.
    """

    kind: ScanKind
    scans: Scans
    interlace: int
    kinds: frozenset[ScanKind]


def interlaced(scans: Mapping[ScanKind, Scans], usual: ScanKind, most_others: int) -> Interlaced | None:
    """The scans of a log as those of one interlaced lidar, or None where they are not.

    They are where there are several kinds of scan that begin at different bearings of one grid, less than a step
    apart, and are otherwise alike: step, limit, and number of beams, give or take the one at the end.

    Args:
        scans: of the log, by kind.
        usual: the most frequent kind.
        most_others: up to this many other scans are no second bearing but strays.
    """
    alike = [kind for kind in scans if _alike(kind, usual) and scans[kind].stated == scans[usual].stated]
    frequent = [kind for kind in alike if kind == usual or len(scans[kind]) > most_others]
    if sum(len(scans[kind]) for kind in alike if kind != usual) <= most_others:
        return None
    for kinds in (alike, frequent):
        for interlace in range(2, MAX_INTERLACE + 1) if len(kinds) > 1 else ():
            first = min(kind.angle_min for kind in kinds)
            grid = ScanKind(usual.line, 0, first, usual.angle_increment / interlace)
            found = [_phase(kind, grid, interlace) for kind in kinds]
            if None not in found and len(set(found)) == len(kinds):
                return _merged(scans, dict(zip(kinds, found, strict=True)), grid, interlace)  # type: ignore[arg-type]
    return None


def _alike(kind: ScanKind, usual: ScanKind) -> bool:
    return (
        kind.line == usual.line
        and abs(kind.beams - usual.beams) <= 1
        and abs(kind.angle_min - usual.angle_min) < usual.angle_increment - SAME_ANGLE
        and abs(kind.angle_increment - usual.angle_increment) * usual.beams < SAME_ANGLE
    )


def _phase(kind: ScanKind, grid: ScanKind, interlace: int) -> int | None:
    """At which beam of the grid a kind of scan begins; None where it begins at none before the second step."""
    phase = round((kind.angle_min - grid.angle_min) / grid.angle_increment)
    off = abs(kind.angle_min - grid.angle_min - phase * grid.angle_increment)
    return phase if off < SAME_ANGLE and 0 <= phase < interlace else None


def _merged(
    scans: Mapping[ScanKind, Scans], begins: Mapping[ScanKind, int], grid: ScanKind, interlace: int
) -> Interlaced:
    """The scans of some kinds, which begin at these beams of the grid, in the order of the file."""
    beams = max(begin + interlace * (kind.beams - 1) + 1 for kind, begin in begins.items())
    numbers = np.concatenate([np.array(scans[kind].numbers, np.int64) for kind in begins])
    places = np.argsort(np.argsort(numbers))
    ranges, rows = np.zeros((len(numbers), beams), np.float32), np.zeros((len(numbers), 8))
    done = 0
    for kind, begin in begins.items():
        some = scans[kind]
        here = places[done : done + len(some)]
        columns = begin + interlace * np.arange(kind.beams)
        ranges[here[:, None], columns] = np.array(some.ranges, np.float32).reshape(-1, kind.beams)
        rows[here] = np.array(some.rows).reshape(-1, 8)
        done += len(some)
    first = min((scans[kind] for kind in begins), key=lambda some: some.first_line)
    flat = array("f", ranges.tobytes()), array("d", rows.tobytes()), array("q", np.sort(numbers).tobytes())
    return Interlaced(
        grid._replace(beams=beams), Scans(first.first_line, first.stated, *flat), interlace, frozenset(begins)
    )
