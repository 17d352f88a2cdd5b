"""What evo makes of two drives."""

import copy
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

Drive = tuple[np.ndarray, np.ndarray, Rotation]
"""Stamps [n], positions [n, 3], orientations."""


def evo_metric(
    estimate: Drive,
    reference: Drive,
    relation: str = "translation_part",
    *,
    lay: str = "align",
    delta: float | None = None,
    unit: str = "m",
    all_pairs: bool = False,
    offset: float = 0.0,
    interpolate: bool = False,
) -> Any:
    """Its APE, or with a delta its RPE; ``lay`` is how the estimate is laid on the reference: "scale", "from_start"."""
    from evo.core import metrics, sync
    from evo.core.sync_method import SyncMethod
    from evo.core.trajectory import PoseTrajectory3D

    true, there = (
        PoseTrajectory3D(positions_xyz=p, orientations_quat_wxyz=q.as_quat()[:, [3, 0, 1, 2]], timestamps=t.copy())
        for t, p, q in (reference, estimate)
    )
    how = SyncMethod.interpolation if interpolate else SyncMethod.nearest_time
    matched = sync.associate_trajectories(true, there, max_diff=0.01, offset_2=offset, sync_method=how)
    true, there = copy.deepcopy(matched)
    if lay == "from_start":
        there.align_origin(true)
    elif lay != "not":
        there.align(true, correct_scale=lay == "scale")
    chosen, units = metrics.PoseRelation[relation], {"m": metrics.Unit.meters, "frames": metrics.Unit.frames}
    metric = metrics.APE(chosen) if delta is None else metrics.RPE(chosen, delta, units[unit], all_pairs=all_pairs)
    metric.process_data((true, there))
    return metric
