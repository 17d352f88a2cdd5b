"""Whether a robot that was found in a map is there, also by whether its scans are those of any place in the map."""

import math

import numpy as np

from moteslam.errors import ConfigError
from moteslam.robot.formats.map_server import FREE, OCCUPIED, seamed
from moteslam.robot.raster import Raster
from moteslam.robot.values import Issue
from moteslam.slam.known_map.search import APART, CROSSING, ON_SURFACE, OUTLIER, WINDOW
from moteslam.slam.registration.localisation import CORRELATION
from moteslam.slam.tsdf.doubt import Doubt, ScanFit

FIRST, LARGEST, MOST = 3.0, 7.0, 2.0
"""The log-odds of the place where a robot was found are at most the first, and at most the second after a drive; scans
of ``APART`` metres change them by at most the third [nats]."""
LONGEST = 3.0
"""... or so many times that after as many drives of ``WINDOW``: who was there for long is not elsewhere because people
stand around."""
FOREIGN = 1.1
"""Cost of an endpoint of a robot in another building at the best place of this map [nats]: ``ELSEWHERE`` of the search
less what that takes off for all its places (13 nats of 200 endpoints, one in ten of which errs independently)."""
BEFORE_SURFACES, FAR_OF_CROSSED = 0.9, 3.0
"""Cost of an endpoint that lies before the surfaces, beyond that of another one [nats]: a floor plan lacks the
furniture, 14 % of what a robot sees in simulated offices, up to 45 % at some places, and few rays go through its walls.
In another building one does for every three endpoints far from surfaces: so many are not taken for furniture."""
LEAST_DRIVEN = 0.02  # A scan counts at least by this share of `APART`: a robot that is carried has not driven


class Presence(Doubt):
    """Doubts a pose also by whether its scans are those of a place in the map at all, however they fitted before.

    The log-odds of a place against a robot elsewhere, as the search has them, add up along the path. Once they are at
    their largest the place is ``proved``: what the map does not know no longer counts, and from there a robot may drive
    on beyond the map. The more places were ``given_up`` soon, one after the other, the longer a drive must prove the
    next.
    """

    grows = False

    def __init__(self, given_up: int = 0) -> None:
        super().__init__()
        self._here, self.proved, self.driven = FIRST, False, 0.0  # since the robot was found [m]
        self.passed = 0.0  # rays of the next scan that nothing answered and that go through surfaces of the map
        self._most = MOST / (1 + given_up)

    @property
    def probability(self) -> float:
        """That the pose is wrong, by the scans until now."""
        return max(super().probability, 1 / (1 + float(np.exp(self._here))))

    def observe(self, driven: float, scan: ScanFit | None, *, turned: float = 0.0, carried: bool = False) -> None:
        super().observe(driven, scan, turned=turned, carried=carried)
        self.driven += driven
        if scan is None:
            return
        seen = scan.known if self.proved else scan.points
        crossed = scan.crossed + self.passed
        before = max(scan.far - FAR_OF_CROSSED * crossed, 0.0)  # surfaces, by something that the map lacks
        against = (OUTLIER - ON_SURFACE) * (scan.far - before + seen - scan.known) + CROSSING * crossed
        against += BEFORE_SURFACES * before
        nats = (FOREIGN - ON_SURFACE) * seen - against
        share = min(max(driven / APART, LEAST_DRIVEN), 1.0)
        most = LARGEST * min(max(self.driven / WINDOW, 1.0), LONGEST)
        self._here = min(self._here + share * min(max(nats / CORRELATION, -MOST), self._most), most)
        self.proved |= self._here >= LARGEST


def not_in_map(occupancy: Raster, *, was_sure: bool) -> Issue:
    """What is said of a robot whose scans fit nowhere in a map for long."""
    text = f"nowhere in the map do the scans fit for {WINDOW:g} m: the robot is not in this map, or the map is not of "
    text += "this place or scale, or lacks what stands before its walls, as a plan without furniture; "
    text += f"the poses may mean nothing in it{', even the sure ones' * was_sure}"
    if (occupancy.values == OCCUPIED).sum() > (occupancy.values == FREE).sum():
        text += ". Or its greys are inverted (negate): more of it is occupied than free"
    elif seamed(occupancy):
        text += ". Or its image was scaled, blurred or compressed: before most walls lie unknown cells"
    return Issue("not-in-this-map", text)


def expect_near(occupancy: Raster, x: float, y: float) -> None:
    """``ConfigError`` for a start that is ``WINDOW`` beyond the edges of a map, or farther [m]."""
    left, right, bottom, top = occupancy.extent
    if (off := math.hypot(max(left - x, x - right, 0.0), max(bottom - y, y - top, 0.0))) > WINDOW:
        edges = f"x {left:.1f} to {right:.1f}, y {bottom:.1f} to {top:.1f} m"
        raise ConfigError(f"{off:.0f} m outside of the map, expected a place in it, or near: {edges}", field="start")
