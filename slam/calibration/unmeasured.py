"""Scans of which nothing can be measured: what is said of them, and how they are known."""

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.se2 import Array
from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.inputs.lapses import STILL
from moteslam.slam.inputs.odometry_path import OdometryPath, jumps

Indices = NDArray[np.intp]

FEWEST = 40
"""Fewer scans, beams or pairs of scans say nothing."""
DRIVES, TURNED = 2.0, 2 * np.pi
"""A robot that goes no farther is not said to show nothing [m]; one whose odometry turns by more does turn [rad]."""
PACKED, SIZES = 0.9, 3
"""Beams are not in their place where more than this share of the scans that have some without a return have all of them
at an end, and in so many numbers: a part that the robot hides has one."""
BACKWARDS, SOME_BACKWARDS = 3.0, 0.1
"""Neighbouring scans are in opposite order where one, turned round, is this many times more like the other, and of two
lidars where the next but one is; told of more than this share of them."""
NEARLY, DROPS, CODES = 0.05, 0.03, 10
"""Nearly the longest range, and nearly 0, by this share of it; of sound lidars at most 1 % of the scans drop from there
to here from one beam to the next, and in more of them to few ranges, which are codes."""
EDGE, AT_REST = 0.3, 0.1
"""A beam passes an edge where its range changes by more than the first [m], and by less than the second share of that
from the scan before to the former."""
GOES_ON, SMOOTHED, EDGES = (0.3, 1.1), 0.5, 100
"""Ranges are smoothed in time where it goes on so in the next scan, by a share of that from the first to the second, at
more than this share of as many edges: at 0.3 at most of those of sound lidars."""


class UnmeasuredError(Exception):
    """Nothing can be measured: the code and the text of what is said of it."""


class UnfitScansError(UnmeasuredError):
    """Scans do not fit each other: ``share`` of the pairs do, be their turns bound by what they see or not."""

    def __init__(self, code: str, text: str, share: float = 0.0) -> None:
        super().__init__(code, text)
        self.share = share


def turned_round(which: str, time: str) -> None:
    """Raise ``UnmeasuredError`` of scans that for a time turn against the odometry: which of lidar, odometry, gyro and
    clock is wrong then, if that is known.
    """
    if which == "clock":
        text = f"lidar: {time} its scans turn as the odometry does some time before or after: were stamps counted, or "
        text += "scans lost? Motions, and with them the map, are wrong by as much"
        raise UnmeasuredError("other-clock", text)
    text = f"lidar: {time} its scans turn the other way, by the odometry: its beams are in the other order there, or "
    text += "it hangs upside down, and a map of both parts is wrong"
    if which == "odometry":
        text = f"odometry: {time} its turns have the wrong sign, by scans and gyro"
    elif which == "gyro":
        text = f"imu: {time} its yaw rate has the wrong sign, by scans and wheels"
    elif not which:
        text += "; unless it is the odometry that changes the sign of its turns"
    raise UnmeasuredError("scans-unfit", f"{text}. Take one part")


def unmeasured(odometry: Array) -> None:
    """Raise ``UnmeasuredError`` of a robot that drives, by poses [n, 3] at scans."""
    if (extent := float(np.hypot(*np.ptp(odometry[:, :2], axis=0)))) > DRIVES:
        turned = float(np.abs(np.diff(np.unwrap(odometry[:, 2]))).sum())
        why = f"the robot hardly turns over {extent:.0f} m" if turned < TURNED else "scans do not turn as odometry does"
        text = f"{why}, the room is round, or scans are too few to be held against odometry. Ranges, wheels, clocks "
        text += "or units of angles that are not as stated make path and map wrong by as much, and nothing tells"
        raise UnmeasuredError("not-calibrated", text)


def between_jumps(path: OdometryPath, stamps: Array, first: Indices, last: Indices) -> tuple[Indices, Indices]:
    """Those of pairs of scans, at stamps [n] [s], between which the odometry neither jumps nor stands before a jump.

    Raises ``UnmeasuredError`` where too few are left.
    """
    leaps = np.flatnonzero(jumps(path.stamps, path.poses, SyncConfig()))
    moves = np.append(True, np.hypot(*np.diff(path.poses[:, :2], axis=0).T) > STILL)
    latest = np.maximum.accumulate(np.where(moves, np.arange(len(moves)), 0))
    begins, ends = path.stamps[latest[leaps - 1]], path.stamps[leaps]
    left = np.searchsorted(begins, stamps[last]) <= np.searchsorted(ends, stamps[first], side="right")
    if left.sum() < FEWEST <= len(first):
        text = f"odometry jumps, or stands still until it does, in {(~left).sum()} of {len(first)} pairs of scans: "
        raise UnmeasuredError("not-calibrated", f"{text}lidar and odometry are not held against each other")
    return first[left], last[left]


def expect_sound(ranges: NDArray[np.float32]) -> None:
    """Raise ``UnmeasuredError`` where scans [k, beams], one after the other, are not those of one lidar."""
    _expect_one_lidar(ranges)
    _expect_new_scans(ranges)
    _expect_whole_ranges(ranges)


def _expect_one_lidar(ranges: NDArray[np.float32]) -> None:
    """Raise ``UnmeasuredError`` where beams of some scans [k, beams], one after another, go the other way, or each scan
    is like the next but one, and not like the next.
    """
    one, other = ranges[:-2], ranges[1:-1]
    differences = [np.abs(one - each) for each in (other, other[:, ::-1], ranges[2:])]
    both = np.isfinite(differences).all(axis=0)
    as_is, back, later = (np.where(both, np.minimum(each, 1.0), 0.0).sum(axis=1) for each in differences)
    for like, how, mend in (
        (back, "have their beams in the other order than the scan before", "Turn those round"),
        (later, "are like the next but one, and not like the next", "Keep those of one"),
    ):
        count = int((as_is > BACKWARDS * np.maximum(like, 0.01 * both.sum(axis=1))).sum())
        if count > SOME_BACKWARDS * len(one):
            text = f"lidar: {count} of {len(one)} scans {how}, as of two lidars in one stream: a map of them is wrong. "
            raise UnmeasuredError("scans-unfit", text + mend)


def _expect_whole_ranges(ranges: NDArray[np.float32]) -> None:
    """Raise ``UnmeasuredError`` where ranges of scans [k, beams] begin again at 0, as of a number of too few bits.

    From one beam to the next they then drop from nearly the longest to anything near 0.
    """
    ends = np.isfinite(ranges)
    most, both = float(np.max(ranges, initial=0.0, where=ends)), ends[:, :-1] & ends[:, 1:]
    nearer, farther = (each(ranges[:, :-1], ranges[:, 1:]) for each in (np.minimum, np.maximum))
    drops = both & (farther > (1 - NEARLY) * most) & (nearer < NEARLY * most)
    count = int(drops.any(axis=1).sum())
    if count > DROPS * len(ranges) and len(np.unique(nearer[drops])) > CODES:
        text = f"lidar: from one beam to the next ranges drop from {most:.2f} m to nearly 0, in {count} of "
        text += f"{len(ranges)} scans, as a number of too few bits begins again: what is farther off is taken to be "
        raise UnmeasuredError("scans-unfit", f"{text}near, and a map of them is wrong. Read them with all their bits")


def expect_beams_in_place(ranges: NDArray[np.float32]) -> None:
    """Raise ``UnmeasuredError`` where beams of scans [k, beams] without a return are not in their place, but at an end.

    Beams without a return lie anywhere in a fan: not even a twentieth of the scans of real lidars have all at one end.
    """
    none = ~np.isfinite(ranges)
    lost = none.sum(axis=1)
    some, numbers = (lost > 0) & (lost < none.shape[1]), np.arange(none.shape[1])
    last = none[some] == (numbers >= none.shape[1] - lost[some, None])
    first = none[some] == (numbers < lost[some, None])
    packed = int(max(each.all(axis=1).sum() for each in (last, first)))
    if packed >= FEWEST and packed > PACKED * some.sum() and len(np.unique(lost[some])) >= SIZES:
        text = f"lidar: {packed} of {some.sum()} scans have all beams without a return at one end, up to "
        text += f"{lost[some].max()} of them: their driver left those out and closed the gaps, so that angles, and a "
        raise UnmeasuredError("scans-unfit", f"{text}map of them, are wrong. Keep a range of 0 or inf in its place")


def _expect_new_scans(ranges: NDArray[np.float32]) -> None:
    """Raise ``UnmeasuredError`` where scans [k, beams], one after the other, are means of several.

    Where a beam passes an edge its range changes at once; that of a mean changes in several steps.
    """
    steps = np.diff(ranges.astype(np.float64), axis=0)
    before, step, after = steps[:-2], steps[1:-1], steps[2:]
    edge = np.isfinite(before) & np.isfinite(after) & (np.abs(step) > EDGE) & (np.abs(before) < AT_REST * np.abs(step))
    share = after[edge] / step[edge]
    smoothed = int(((share > GOES_ON[0]) & (share < GOES_ON[1])).sum())
    if len(share) >= EDGES and smoothed > SMOOTHED * len(share):
        text = f"lidar: ranges change in several steps at {smoothed} of {len(share)} edges that beams pass: its driver "
        text += "or a filter gives means of several scans. Places are mixed with those before, and poses come late"
        raise UnmeasuredError("scans-unfit", text)
