"""What a format of trajectories is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from moteslam.robot.trajectory import Trajectory


@dataclass(frozen=True)
class TrajectoryFormat:
    """How a trajectory is stored, in lines of text.

    Attributes:
        name: what it is called, and what its lines are.
        recognise: ``recognise(comments, line)``: whether a file is of this format, by the comments that it begins with
            (``#``, with their line ends) and its first line that is none; must not raise for any other.
        read: ``read(path)``.
        write: ``write(path, trajectory)`` writes a file that reads back the same, but for what the format cannot hold.
        endings: of the names of its files, by which one to be written is known.
    """

    name: str
    recognise: Callable[[str, str], bool]
    read: Callable[[Path], Trajectory]
    write: Callable[[Path, Trajectory], None]
    endings: tuple[str, ...]
