"""A pose graph: the poses of a robot, and what was measured between them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.arrays import frozen
from moteslam.robot.summary import Summarised
from moteslam.robot.wording import counted

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class PoseGraph(Summarised):
    """Nodes in the order in which the robot was there, and edges between them.

    Attributes:
        ids: [n] of the nodes, rising; what files know them by.
        poses: [n, 3] x [m], y [m], theta [rad].
        first, second: [e] indices of the nodes that an edge binds, into ``poses``.
        relative: [e, 3] measured pose of the second in the frame of the first.
        information: [e, 3, 3], symmetric, of its error in the frame of the measured pose: what is left of the second's
            pose there [1/m^2, 1/(m rad), 1/rad^2].
        stamps: [n] of the nodes [s], not decreasing; None where they are not known.
        fixed: [k] indices of the nodes that hold the frame.

    Raises:
        InputError: arrays of other shapes, ids that do not rise, stamps that go back, an index of no node, or an edge
            from a node to itself.
    """

    ids: Indices
    poses: Array
    first: Indices
    second: Indices
    relative: Array
    information: Array
    stamps: Array | None = None
    fixed: Indices = field(default_factory=lambda: np.zeros(0, np.int64))

    def __post_init__(self) -> None:
        n, e = len(self.ids), len(self.first)
        shapes = {"ids": (n,), "poses": (n, 3), "first": (e,), "second": (e,), "relative": (e, 3)}
        shapes |= {"information": (e, 3, 3), "stamps": (n,), "fixed": (len(self.fixed),)}
        for name, shape in shapes.items():
            if (value := getattr(self, name)) is None:
                continue
            array = frozen(value, np.int64 if name in ("ids", "first", "second", "fixed") else np.float64)
            if array.shape != shape:
                raise InputError(f"{list(array.shape)}, expected {list(shape)}", field=name)
            object.__setattr__(self, name, array)
        if (np.diff(self.ids) <= 0).any():
            raise InputError("expected rising ids", field="ids")
        if self.stamps is not None and not (np.diff(self.stamps) >= 0).all():
            raise InputError("stamps go back, expected rising seconds", field="stamps")
        for name in ("first", "second", "fixed"):
            index = getattr(self, name)
            if len(index) and not 0 <= index.min() <= index.max() < n:
                raise InputError(f"expected indices of {counted(n, 'node')}", field=name)
        if (self.first == self.second).any():
            raise InputError("an edge from a node to itself, expected one between two", field="second")

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def loops(self) -> NDArray[np.bool_]:
        """[e] which edges are loops: those between nodes that do not follow each other."""
        return np.asarray(np.abs(self.second - self.first) != 1)

    def _summary(self) -> str:
        loops = int(self.loops.sum())
        return f"{counted(len(self), 'node')}, {counted(len(self.first), 'edge')}, {counted(loops, 'loop')} of these"
