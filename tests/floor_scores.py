"""A picture of the floor against the true floor: colours, place, and which cells a camera saw."""

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.robot import rgbd
from moteslam.sim.sensors.rgbd import CameraFrames


def score_texture(estimate: ArrayLike, truth: ArrayLike, where: ArrayLike) -> tuple[float, float]:
    """Compare two pictures of the floor [H, W, 3] of levels 0 to 255, over the cells [H, W] that count.

    Returns:
        the mean error of a level over that of the best single colour, each channel's median of the true floor there;
        and the standard deviation of the true grey values.
    """
    seen, true = (np.asarray(picture, np.float64)[np.asarray(where, bool)] for picture in (estimate, truth))
    single = np.abs(true - np.median(true, axis=0)).mean()
    return float(np.abs(seen - true).mean() / single), float((true @ (0.299, 0.587, 0.114)).std())


def registration(estimate: ArrayLike, truth: ArrayLike, where: ArrayLike, *, reach: int = 4) -> tuple[int, int]:
    """By how many cells (columns, rows) the truth must be moved to fit the estimate best; (0, 0) is in place.

    The best fit has the smallest sum of squared differences.

    Args:
        estimate: [H, W, 3] levels 0 to 255.
        truth: [H, W, 3], on the same cells.
        where: [H, W] which cells count.
        reach: shifts up to this many cells are tried, each way; cells this close to an edge do not count.
    """
    estimate, truth, where = np.asarray(estimate, np.float32), np.asarray(truth, np.float32), np.asarray(where, bool)
    inner = (slice(reach, max(len(where) - reach, reach)), slice(reach, max(where.shape[1] - reach, reach)))
    if not where[inner].any():
        return 0, 0
    differences = cv2.matchTemplate(truth, estimate[inner], cv2.TM_SQDIFF, mask=where[inner].astype(np.float32))
    row, column = np.unravel_index(np.argmin(differences), differences.shape)
    return reach - int(column), reach - int(row)


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
