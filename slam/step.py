"""The one kind of event that SLAM sees: how the robot moved, and the scan at the end of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.recording import Recording
from moteslam.slam.config import SyncConfig
from moteslam.slam.floor_views import FloorView, FloorViews
from moteslam.slam.scans import Scans
from moteslam.slam.synchronise import jumps, odometry_at_scans, require_lidar, tells_motion


@dataclass(frozen=True, eq=False)
class Step:
    """One scan and the motion since the scan before.

    Attributes:
        index: of the scan in the recording.
        stamp: of the scan [s].
        dt: time since the scan before [s]; 0 for scans that share a stamp.
        motion: [3] increment of the robot's pose, in the frame of its pose at the scan before; zeros where nothing
            measured it.
        points: [k, 2] float32 the finite endpoints in the robot's frame [m].
        origin: [2] where the rays start, in the robot's frame [m]: the lidar.
        guess: nothing measured the motion, or the odometry jumped: who takes the step in had better guess it from
            what came before.
        look: reads what the camera last saw of the floor, which takes time: to be called at most once, and only
            where it is made use of. None where colours are not asked for, or where there is no camera.
    """

    index: int
    stamp: float
    dt: float
    motion: NDArray[np.float64]
    points: NDArray[np.float32]
    origin: NDArray[np.float64]
    guess: bool = False
    look: Callable[[], FloorView | None] | None = None


def steps(
    recording: Recording, config: SyncConfig, *, max_range: float = np.inf, views: FloorViews | None = None
) -> Iterator[Step]:
    """One step a scan: the motion since the scan before and the scan's endpoints in the robot's frame.

    Without odometry, or with one that never moves, the steps say that their motion is a guess, and so
    do those where it jumps.

    Args:
        recording: needs a lidar.
        config: how motion is synchronised with scans.
        max_range: endpoints beyond it are left out [m].
        views: of the floor, by the camera; None where they are not asked for.

    Raises:
        InputError: there is no lidar.
    """
    stamps = require_lidar(recording).stamps
    known = tells_motion(recording)
    odometry = odometry_at_scans(recording, config) if known else np.zeros((len(stamps), 3))
    guesses = jumps(stamps, odometry) if known else np.ones(len(stamps), np.bool_)
    motions = np.vstack((np.zeros(3), se2.between(odometry[:-1], odometry[1:])))
    scans = Scans(recording, config, max_range=max_range)
    for index, stamp in enumerate(stamps):
        dt = float(stamp - stamps[index - 1]) if index else 0.0
        look = None if views is None else partial(views.at, index)
        yield Step(
            index, float(stamp), dt, motions[index], scans.points(index), scans.origin, bool(guesses[index]), look
        )
