"""What a lidar sees that it should not: something that travels with the robot, and the floor where it is aslant."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from moteslam.errors import ConfigError
from moteslam.robot.platform import LidarSpec
from moteslam.robot.values import Number, Positive
from moteslam.sim.robot.mishaps import Interval

Array = NDArray[np.float64]


Length = Annotated[Number, Field(gt=0, le=20)]


class Cart(Interval):
    """Something that travels with the robot stands in the lidar's view: a box, or its four legs.

    It is at the same place in the robot's frame throughout, and goes through walls; what is nearer hides it.
    """

    kind: Literal["cart"] = "cart"
    distance: Length = 0.9  # from the lidar to the middle of its near side [m]
    # of that from the lidar, in the robot's frame [rad]; 0 is ahead
    bearing: Annotated[Number, Field(ge=-2 * np.pi, le=2 * np.pi)] = 0.0
    width: Length = 0.6  # across that direction [m]
    depth: Length = 0.4  # along it [m]
    # of four square legs at its corners, all that the lidar sees of it [m]; 0 for a box that is solid
    leg: Annotated[Number, Field(ge=0, le=1)] = 0.0

    @model_validator(mode="after")
    def _stands_on_its_legs(self) -> Cart:
        if self.leg > min(self.width, self.depth) / 2:
            raise ValueError(f"leg of {self.leg:g} m, expected at most half of width and depth")
        return self

    def ranges(self, origin: tuple[float, float], bearings: Array) -> Array:
        """The range [n], ``inf`` for a miss, from beside the lidar's mount [m] at bearings [n] in the robot's frame."""
        dx, dy = origin
        cos, sin = np.cos(self.bearing), np.sin(self.bearing)
        along, across = cos * dx + sin * dy, cos * dy - sin * dx
        found = np.full(len(bearings), np.inf)
        for near, far, right, left in self._boxes():
            box = (near - along, far - along, right - across, left - across)
            found = np.minimum(found, _box_ranges(box, bearings - self.bearing))
        return found

    def _boxes(self) -> list[tuple[float, float, float, float]]:
        """The solid boxes: from near to far and from right to left, from the lidar's mount towards the cart [m]."""
        near, far, half = self.distance, self.distance + self.depth, self.width / 2
        if not self.leg:
            return [(near, far, -half, half)]
        rows = ((near, near + self.leg), (far - self.leg, far))
        columns = ((-half, -half + self.leg), (half - self.leg, half))
        return [(*row, *column) for row in rows for column in columns]


class Tilt(Interval):
    """The lidar is mounted aslant: beams that go down end on the floor, and walls are a little further."""

    kind: Literal["tilt"] = "tilt"
    pitch: Annotated[Number, Field(ge=-0.5, le=0.5)] = 0.05  # forward positive [rad]
    roll: Annotated[Number, Field(ge=-0.5, le=0.5)] = 0.0  # to the right positive [rad]
    # of the lidar above the floor [m]; that of the robot's lidar by default
    height: Annotated[Positive, Field(le=10)] | None = None
    # floor that is met at a smaller angle sends nothing back [rad]
    grazing: Annotated[Number, Field(ge=0, le=0.5)] = 0.02

    @model_validator(mode="after")
    def _is_aslant(self) -> Tilt:
        if not self.pitch and not self.roll:
            raise ValueError("pitch and roll of 0, expected one of them other than 0")
        return self


def carts_in_view(
    exact: NDArray[np.float32], carts: Sequence[Cart], times: Array, origin: tuple[float, float], bearings: Array
) -> NDArray[np.float32]:
    """The ranges [n, beams] [m] of scans with carts in them: the nearer of what stands there and the cart.

    Args:
        times: [n, beams] of the beams, since the drive's start [s].
        origin: where the lidar is beside its mount [m].
        bearings: [beams] in the robot's frame [rad].
    """
    for cart in carts:
        met = np.where(cart.covers(times), cart.ranges(origin, bearings), np.inf)
        exact = np.where(np.isfinite(met), np.fmin(exact, met), exact).astype(np.float32)
    return exact


def leaning(leans: Array, z: float, tilts: Sequence[Tilt], times: Array) -> tuple[Array, Array | float, Array | float]:
    """Roll and pitch of beams, the height of their lidar, and from which angle on they measure the floor.

    Args:
        leans: [n, beams, 2] or [2] roll and pitch without the tilts [rad].
        z: the lidar's height without them [m].
        tilts: of its mount, which add up; of height and grazing the last one's count.
        times: [n, beams] of the beams, since the drive's start [s].
    """
    if not tilts:
        return leans, z, np.inf
    leans = np.array(np.broadcast_to(leans, (*times.shape, 2)))
    height, grazing = np.full(times.shape, z), np.full(times.shape, np.inf)
    for tilt in tilts:
        covered = tilt.covers(times)
        leans[covered] += (tilt.roll, tilt.pitch)
        grazing[covered] = tilt.grazing
        if tilt.height is not None:
            height[covered] = tilt.height
    return leans, height.reshape(-1), grazing.reshape(-1)


def check_tilt(tilt: Tilt, lidar: LidarSpec, *, field: str) -> None:
    """Refuse a tilt of a lidar whose height is not known."""
    if tilt.height is None and lidar.z <= 0:
        raise ConfigError(
            f"missing, expected it where the robot's lidar is at z = {lidar.z:g} m", field=f"{field}.height"
        )


def _box_ranges(box: tuple[float, float, float, float], bearings: Array) -> Array:
    """The range [n] from the origin to a box (least and largest x, least and largest y) along bearings [n]."""
    least_x, largest_x, least_y, largest_y = box
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = np.array(((least_x, largest_x), (least_y, largest_y)))[:, :, None] / np.stack(
            (np.cos(bearings), np.sin(bearings))
        ).reshape(2, 1, -1)
    enters, leaves = np.fmin(*sides.swapaxes(0, 1)).max(0), np.fmax(*sides.swapaxes(0, 1)).min(0)
    return np.where((leaves >= enters) & (enters > 0), enters, np.inf)
