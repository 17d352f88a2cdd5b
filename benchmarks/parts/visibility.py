"""Which cells of the floor a camera truly saw: those that a coloured map can be expected to colour."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import rgbd
from moteslam.sim.sensors.rgbd import CameraFrames


def seen_cells(
    frames: CameraFrames, origin: tuple[float, float], shape: tuple[int, int], cell_size: float
) -> NDArray[np.bool_]:
    """The cells whose centre the depth camera had in view and in range in some frame, with nothing in between.

    In range are cells that it measures: not too near, too far, or at too flat an angle.

    Args:
        frames: of a run.
        origin: (x, y) of the corner of cell [0, 0] in the world [m].
        shape: rows and columns.
        cell_size: [m].

    Returns:
        [H, W].
    """
    renderer = frames.renderer()
    mount, settings = renderer.mount, renderer.settings
    bearings = renderer.views[False].bearings
    rotation = rgbd.mount_rotation(mount)
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    centres = np.stack((columns, rows), axis=-1).reshape(-1, 2) * cell_size + np.asarray(origin) + cell_size / 2
    seen = np.zeros(len(centres), bool)
    for camera, reaches in zip(*renderer.reaches(frames.disparity, colour=False), strict=True):
        todo = np.flatnonzero(~seen)
        away = centres[todo] - camera[:2]
        level = np.hypot(*away.T)
        near = level < settings.farthest * 1.3
        todo, away, level = todo[near], away[near], np.maximum(level[near], 1e-9)
        cos, sin = np.cos(camera[2]), np.sin(camera[2])
        ahead = np.stack((away @ (cos, sin), away @ (-sin, cos), np.full(len(away), -mount.z)), axis=-1)
        right, down, depth = (ahead @ rotation).T  # back to optical axes
        front = np.where(depth > 0, depth, np.nan)
        column, row = (rgbd.FOCAL * v / front + c for v, c in zip((right, down), rgbd.CENTRE, strict=True))
        bearing = np.arctan2(ahead[:, 1], ahead[:, 0])
        at = np.rint((bearing - bearings[0]) / (bearings[1] - bearings[0]))
        reach = reaches[np.clip(at, 0, len(bearings) - 1).astype(np.intp)]
        with np.errstate(invalid="ignore"):
            inside = (column > -0.5) & (column < rgbd.WIDTH - 0.5) & (row > -0.5) & (row < rgbd.HEIGHT - 0.5)
        in_range = (depth >= settings.nearest) & (depth <= settings.farthest) & (mount.z / level >= settings.grazing)
        seen[todo[inside & in_range & (level < reach)]] = True
    return seen.reshape(shape)
