"""Two scans compared: which endpoints stand in the world between them, and which travel with the robot."""

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.platform import LidarSpec
from moteslam.robot.recording import LidarStream
from moteslam.robot.se2 import Array

Flags = NDArray[np.bool_]

LEAST_MOVED = 0.15
"""Only where a wall would have moved by more than this, seen from the robot, it differs from what travels [m]."""
SAME, OTHER, THROUGH = 0.25, 0.5, 0.35
"""Of that displacement: a range is where it was expected within the first share and not from the second on; from the
third on the place of a wall is seen through: floor that a tilted lidar sees aslant recedes by less than it moves."""
FEWEST = 5  # More endpoints must stand for the turn by odometry to be that of the robot
ASIDE = np.arange(-2, 3)[:, None, None]  # In these beams beside its own an expected endpoint is looked for, and through
BEAM = np.radians(1.0)  # Of a finer lidar beams this far apart are compared [rad]


class ComparedBeams:
    def __init__(self, lidar: LidarStream, mount: LidarSpec) -> None:
        beams = np.arange(0, lidar.ranges.shape[1], max(1, round(BEAM / abs(lidar.angle_increment))))
        self.beams = beams  # [b] their indices in a scan
        self.mount = mount.x, mount.y  # where the lidar is on the robot [m]
        angles = lidar.angles[beams] + mount.yaw
        # the angle of the first in the robot's frame [rad], the others follow a step apart; [b] of the angles; whether
        # they go all the way round
        self.first, self.cos, self.sin = angles[0], np.cos(angles), np.sin(angles)
        self.step = lidar.angle_increment * (beams[1] - beams[0] if len(beams) > 1 else 1)
        self.closed = bool(len(beams) * abs(self.step) > 2 * np.pi - 1.5 * abs(self.step))


def compare_scans(beams: ComparedBeams, ranges: NDArray[np.float32], odometry: Array) -> tuple[Flags, Flags, Flags]:
    """Which endpoints of each of some scans travel to the next, which stand in the world, and which may: [k, b] each.

    An endpoint that tells the two apart travels where the same beam has the same range and the place where a wall would
    be is seen through; it stands where the next scan has an endpoint there and the beam another range. An endpoint may
    do either where a wall would have moved, the beam has an endpoint again, and not both are so. Wheels that slip in a
    turn show walls elsewhere: unless most others stand, the place of a wall without the turn is seen through, too.

    Ranges are [k + 1, b] [m], the robot's poses by odometry [k + 1, 3].
    """
    known = np.where(np.isfinite(ranges), ranges, np.nan).astype(np.float64)
    before, after = known[:-1], known[1:]
    moved = se2.between(odometry[:-1], odometry[1:])
    with np.errstate(invalid="ignore"):
        kept = np.abs(after - before)
        displaced, there, through = _expected(beams, before, after, moved)
        may = (displaced > LEAST_MOVED) & np.isfinite(after) & ~((kept <= OTHER * displaced) & there)
        stand = may & there
        travel = through & (kept <= SAME * displaced)
        unsure = stand.sum(axis=1) <= np.maximum(FEWEST, (may & ~travel).sum(axis=1) / 2)
        if travel[unsure].any():
            travel &= ~unsure[:, None] | _expected(beams, before, after, moved * (1.0, 1.0, 0.0))[2]
    return travel, stand, may


def _expected(beams: ComparedBeams, before: Array, after: Array, moved: Array) -> tuple[Array, Flags, Flags]:
    """What the scans after see where endpoints of walls would be.

    Ranges of pairs of scans are [k, b], NaN where there is no return [m], the robot's motions between them [k, 3].

    Returns of each endpoint before [k, b] how far a wall moves as seen from the robot [m], whether one is seen there,
    and whether its place is seen through.
    """
    x, y = beams.mount
    points_x, points_y = x + before * beams.cos, y + before * beams.sin
    cos, sin = np.cos(moved[:, 2])[:, None], np.sin(moved[:, 2])[:, None]
    forward, left = points_x - moved[:, 0, None], points_y - moved[:, 1, None]
    there_x, there_y = cos * forward + sin * left, cos * left - sin * forward
    displaced = np.hypot(there_x - points_x, there_y - points_y)
    expected = np.hypot(there_x - x, there_y - y)
    bearing = np.arctan2(there_y - y, there_x - x) - beams.first
    number = np.floor(np.mod(bearing / beams.step + 0.5, 2 * np.pi / abs(beams.step)))
    known, count = np.isfinite(number), after.shape[1]
    beam = np.where(known, number, 0).astype(np.intp) + ASIDE
    inside = known if beams.closed else known & (beam >= 0) & (beam < count)
    beyond = np.where(inside, after[np.arange(len(after))[:, None], beam % count], np.nan) - expected
    there = (np.abs(beyond) <= SAME * displaced).any(axis=0)
    return displaced, there, (displaced > LEAST_MOVED) & (beyond >= THROUGH * displaced).all(axis=0)
