"""Doors: leaves that turn or slide, by the clock or at random, and stop for whoever is in their way."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from moteslam.robot.tables import Number, Section, Truth
from moteslam.sim.world.pieces import PLAIN, Point

if TYPE_CHECKING:
    import pymunk

MAX_DOORS = 60
"""In a scenario: every beam is tested against each of them."""

CLEAR = 0.12
"""A leaf stops this far from anyone [m]."""


class Door(Section):
    """A door's leaf that opens and shuts, by the clock or at random.

    Attributes:
        hinge, end: the two ends of the leaf when it is shut [m].
        kind: ``swing``: turns about its hinge; ``slide``: moves along itself past the hinge.
        opening: how far it swings [rad], counterclockwise positive.
        shut_for, open_for: in turns, beginning shut [s]: durations, or with ``random`` means (exponential).
        automatic: whether it opens for anyone within ``sensor`` [m] of its middle.
        takes: time to open or shut [s]. It does not shut on anyone.
    """

    hinge: Point
    end: Point
    kind: Literal["swing", "slide"] = "swing"
    opening: Annotated[Number, Field(ge=-math.pi, le=math.pi)] = math.pi / 2
    shut_for: Annotated[Number, Field(gt=0, le=3600)] = 10.0
    open_for: Annotated[Number, Field(gt=0, le=3600)] = 10.0
    random: Truth = False
    automatic: Truth = True
    sensor: Annotated[Number, Field(gt=0, le=10)] = 2.0
    takes: Annotated[Number, Field(ge=0.2, le=60)] = 1.5
    material: str = PLAIN

    @model_validator(mode="after")
    def _has_a_leaf_that_moves(self) -> Door:
        if math.dist(self.hinge, self.end) < 0.05:
            raise ValueError("a leaf under 0.05 m wide, expected hinge and end apart")
        if self.kind == "slide" and self.opening != math.pi / 2:  # the default is written with every door
            raise ValueError('an opening of a door that slides, expected kind = "swing" or no opening')
        return self


class Leaf:
    """The leaf of a door in the physics engine, with a schedule that covers ``duration`` [s]."""

    def __init__(self, door: Door, space: pymunk.Space, duration: float, rng: np.random.Generator) -> None:
        import pymunk

        self._door, self._space = door, space
        self._hinge = np.asarray(door.hinge)
        self._along = np.asarray(door.end) - self._hinge
        self.width = float(np.hypot(*self._along))
        self._angle = math.atan2(self._along[1], self._along[0])
        self._body = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        shape = pymunk.Segment(self._body, (0.0, 0.0), (self.width, 0.0), 0.01)
        shape.friction = 0.2
        space.add(self._body, shape)
        self._switches = _schedule(door, duration, rng)
        self.open = 0.0
        self._place()

    @property
    def middle(self) -> NDArray[np.float64]:
        """Of the doorway [2] [m]."""
        return np.asarray(self._hinge + self._along / 2)

    @property
    def ends(self) -> NDArray[np.float64]:
        """x0, y0, x1, y1 of the leaf as it stands [m]."""
        return self._ends(self.open)

    def _ends(self, opened: float) -> NDArray[np.float64]:
        if self._door.kind == "slide":
            shift = -opened * self._along
            return np.concatenate((self._hinge + shift, self._hinge + self._along + shift))
        angle = self._angle + opened * self._door.opening
        tip = self._hinge + self.width * np.array((math.cos(angle), math.sin(angle)))
        return np.concatenate((self._hinge, tip))

    def move(self, time: float, interval: float, bodies: NDArray[np.float64], radii: NDArray[np.float64]) -> None:
        """Move for an interval [s], with people and robot at ``bodies`` [n, 2] of ``radii`` [n] [m]."""
        from_middle = np.hypot(*(bodies - self.middle).T)
        door = self._door
        wanted = bool(np.searchsorted(self._switches, time, "right") % 2)
        wanted |= door.automatic and bool((from_middle < door.sensor).any())
        if not wanted and (from_middle - radii < self.width / 2 + CLEAR).any():
            return  # someone stands in it
        step = interval / door.takes
        after = min(max(self.open + (step if wanted else -step), 0.0), 1.0)
        if after == self.open:
            return
        near = _distance(bodies, self._ends(after)) - radii
        if ((near < CLEAR) & (near < _distance(bodies, self.ends) - radii)).any():
            return  # it would come nearer to someone who is near already
        self.open = after
        self._place()

    def _place(self) -> None:
        x0, y0, x1, y1 = self.ends.tolist()
        self._body.position, self._body.angle = (x0, y0), math.atan2(y1 - y0, x1 - x0)
        self._space.reindex_shapes_for_body(self._body)


def _schedule(door: Door, duration: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """When the door opens, shuts, opens ... [s]."""
    switches: list[float] = []
    time, spans = 0.0, (door.shut_for, door.open_for)
    while time < duration:
        span = spans[len(switches) % 2]
        time += max(float(rng.exponential(span)), 0.5) if door.random else span
        switches.append(time)
    return np.array(switches)


def _distance(points: NDArray[np.float64], line: NDArray[Any]) -> NDArray[np.float64]:
    """Of points [n, 2] from a segment [m]."""
    a, along = line[:2], line[2:] - line[:2]
    share = np.clip(((points - a) @ along) / max(float(along @ along), 1e-12), 0.0, 1.0)
    return np.asarray(np.hypot(*(points - a - share[:, None] * along).T))
