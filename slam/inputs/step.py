"""The one kind of event that SLAM takes in: how the robot moved, and the scan at the end of it."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.scans import ThinnedScan, thin_scan, thin_scans
from moteslam.robot.se2 import Array
from moteslam.robot.values import Summarised
from moteslam.slam.inputs.camera import FloorView, FloorViews
from moteslam.slam.inputs.config import ThinningConfig
from moteslam.slam.inputs.inputs import Inputs
from moteslam.slam.inputs.lapses import Open
from moteslam.slam.inputs.scans import Scans

BLOCK = 64  # Scans that are projected and thinned at a time: of 1081 beams 0.5 MB


@dataclass(frozen=True, eq=False, repr=False)
class Step(Summarised):
    """One scan and the motion since the scan before."""

    index: int  # of the scan in the recording
    stamp: float  # of the scan [s]
    dt: float  # time since the scan before [s]; 0 for scans that share a stamp
    motion: Array  # [3] increment of the robot's pose, in the frame of that before; zeros where nothing measured it
    # whether the odometry measured that motion. A filter that can do without predicts the motion of other steps from
    # the steps before
    measured: bool
    points: NDArray[np.float32]  # [k, 2] float32 the finite endpoints in the robot's frame [m]
    origin: Array  # [2] where the rays start, in the robot's frame [m]: the lidar
    scan: ThinnedScan | None = None  # thinned as the filter asks for it (``Filter.thinning``); None if it does not
    # reads the newest camera frame of at most a given age [s], which takes time: call it at most once, and only to make
    # use of it. None if the run does not use the camera
    floor: Callable[[float], FloorView | None] | None = None
    # where the beams that nothing answered [k, 2] reach the largest range, in the robot's frame [m]
    silent: Callable[[], NDArray[np.float32]] = lambda: np.empty((0, 2), np.float32)
    # how far off a motion may be that was not measured, but of which more is known than the velocity before; else None
    open: Open | None = None


def steps(
    inputs: Inputs, views: FloorViews | None = None, *, thinning: ThinningConfig | None = None, first: int = 0
) -> Iterator[Step]:
    """One step a scan; the scans are projected and thinned ``BLOCK`` at a time. Views: None if they are not used."""
    indices = range(first, len(inputs))
    for begin in range(0, len(indices), BLOCK):
        some = indices[begin : begin + BLOCK]
        points, begins, counts = inputs.scans.block(some.start, some.stop)
        thinned: Sequence[ThinnedScan | None] = [None] * len(some)
        if thinning is not None:
            thinned = thin_scans(points, begins, counts, inputs.scans.origin, **vars(thinning))
        for number, (index, scan) in enumerate(zip(some, thinned, strict=True)):
            stamp = inputs.stamps[index]
            yield Step(
                index=index,
                stamp=float(stamp),
                dt=float(stamp - inputs.stamps[index - 1]) if index else 0.0,
                motion=inputs.motions[index],
                measured=bool(inputs.measured[index]),
                points=points[begins[number] : begins[number] + counts[number]],
                origin=inputs.scans.origin,
                scan=scan,
                floor=None if views is None else partial(views.at, index),
                silent=partial(inputs.scans.silent, index),
                open=inputs.open.get(index),
            )


def thin(points: NDArray[np.float32], origin: NDArray[np.float64], config: ThinningConfig) -> ThinnedScan:
    """Average neighbouring endpoints [k, 2], in the order of their beams, whose rays start at an origin [2] [m]."""
    return thin_scan(points, origin, **vars(config))


def thin_some(scans: Scans, indices: Sequence[int], config: ThinningConfig) -> list[ThinnedScan]:
    """Some of the scans, of these indices [m], one at least, each as by ``thin``, in one launch."""
    points = [scans.points(index) for index in indices]
    counts = np.array([len(each) for each in points], np.int32)
    begins = np.cumsum(counts, dtype=np.int32) - counts
    return thin_scans(np.concatenate(points), begins, counts, scans.origin, **vars(config))
