"""Patches of floor as one camera frame shows them, compared with a coloured map at any pose.

Beyond the paper, which names colourless matching as what fails between parallel walls that look alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.robot import se2
from moteslam.robot.platform import CameraSpec
from moteslam.robot.rgbd import CameraFrame
from moteslam.slam.texture.config import TextureConfig
from moteslam.slam.texture.floor_map import TextureMap, TextureMapper

SLANT = 0.5
"""The turn of a patch's cells against the robot's axes [rad]. Were they parallel to a map's cells, all would move from
one to the next at the same shift, and nothing finer than a cell could be measured."""


@dataclass(frozen=True, eq=False)
class FloorPatch:
    """The floor that one frame shows.

    Attributes:
        points: [k, 2] float32 centres of cells, in the robot's frame [m]; the cells' rows are turned by ``SLANT``.
        colours: [k] int32 red + 256 green + 65536 blue, the mean of the points in each cell.
    """

    points: NDArray[np.float32]
    colours: NDArray[np.int32]


def floor_patch(frame: CameraFrame, mount: CameraSpec, config: TextureConfig, *, max_depth: float) -> FloorPatch:
    """The floor near the robot as one frame shows it, a point a cell.

    Args:
        frame: what the camera saw.
        mount: of the camera.
        config: cell size and height limit.
        max_depth: points deeper than this are left out [m].
    """
    near = config.model_copy(update={"max_depth": max_depth})
    reach = 1.3 * max_depth + float(np.hypot(mount.x, mount.y))
    mapper = TextureMapper(mount, near, (-reach, -reach), (reach, reach))
    mapper.add(frame, (0.0, 0.0, SLANT))
    seen = mapper.snapshot()
    rows, columns = np.nonzero(seen.known)
    centres = (np.stack((columns, rows), axis=-1) + 0.5) * seen.cell_size + seen.origin[:2]
    centres = se2.transform_points(np.array((0.0, 0.0, -SLANT)), centres)
    return FloorPatch(centres.astype(np.float32), _packed(seen.values[rows, columns]))


def packed_map(texture: TextureMap) -> NDArray[np.int32]:
    """The map's colours as one number a cell [H, W], -1 where it has none."""
    return np.ascontiguousarray(np.where(texture.known, _packed(texture.values), -1), np.int32)


def colour_errors(
    patch: FloorPatch,
    poses: ArrayLike,
    texture: TextureMap,
    *,
    limit: int,
    packed: NDArray[np.int32] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The mean difference of a patch's colours from the map's at each pose, and the number of cells compared.

    A cell's difference is |r| + |g| + |b|, at most ``limit``: robust against what has moved.

    Args:
        patch: what the camera sees.
        poses: [n, 3] of the robot.
        texture: the coloured map.
        limit: of a cell's difference [levels].
        packed: ``packed_map(texture)``, to have it made once for many frames.

    Returns:
        float64 [n] the mean over the cells that lie on known floor [levels], half the limit where none does; int64 [n]
        the number of these cells.

    Raises:
        InputError: poses that are not finite.
    """
    from moteslam.kernels.colour_match import match_colours  # imports Taichi

    cells = packed_map(texture) if packed is None else packed
    sums = match_colours(
        patch.points, patch.colours, poses, cells, corner=texture.origin[:2], cell_size=texture.cell_size, limit=limit
    )
    difference, known = sums.T.astype(np.int64)
    return np.where(known > 0, difference / np.maximum(known, 1), limit / 2), known


def _packed(colours: NDArray[np.uint8]) -> NDArray[np.int32]:
    red, green, blue = np.moveaxis(colours.astype(np.int32), -1, 0)
    return np.ascontiguousarray(red | green << 8 | blue << 16)
