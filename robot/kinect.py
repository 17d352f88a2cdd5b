"""The Kinect of the UCSD robot: raw disparity, depth, and how the colour camera sees what the depth camera sees.

Optical axes: x right, y down, z forward; pixels (column i, row j) of images 480 high and 640 wide. The depth camera
has the intrinsics (``FOCAL``, ``CENTRE``); a depth pixel whose disparity is known belongs to one pixel of the colour
image, by the published calibration

    dd = -0.00304 d + 3.31,  depth = 1.03 / dd,
    rgb_i = (526.37 i - 4.5 * 1750.46 dd + 19276) / 585.051,  rgb_j = (526.37 j + 16662) / 585.051.

Put into metres that is itself a pinhole camera (``RGB_FOCAL``, ``RGB_CENTRE``), 26 mm to the right of the depth
camera (``RGB_OFFSET``): what the simulator draws and what the texture mapping undoes are one and the same geometry.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from moteslam.robot.specs import CameraSpec

HEIGHT, WIDTH = 480, 640
"""Rows and columns of both images."""

FOCAL = 585.05108211
"""Of the depth camera, in both directions [pixels]."""

CENTRE = (315.83800193, 242.94140713)
"""Principal point of the depth camera: column, row. Several public copies swap them, which turns the floor by 7 deg."""

DISPARITY_SLOPE, DISPARITY_OFFSET = -0.00304, 3.31
"""dd = slope * d + offset."""

DEPTH_SCALE = 1.03
"""depth = scale / dd [m]."""

NO_DISPARITY = 2047
"""The raw disparity of a pixel that saw nothing: all eleven bits."""

ALIGN_SCALE, ALIGN_DIVISOR = 526.37, 585.051
ALIGN_DISPARITY = 4.5 * 1750.46
ALIGN_COLUMN, ALIGN_ROW = 19276.0, 16662.0

RGB_FOCAL = ALIGN_SCALE / ALIGN_DIVISOR * FOCAL
RGB_CENTRE = (
    (ALIGN_SCALE * CENTRE[0] + ALIGN_COLUMN) / ALIGN_DIVISOR,
    (ALIGN_SCALE * CENTRE[1] + ALIGN_ROW) / ALIGN_DIVISOR,
)
RGB_OFFSET = ALIGN_DISPARITY * DEPTH_SCALE / ALIGN_DIVISOR / RGB_FOCAL
"""How far the colour camera stands to the right of the depth camera, along its x axis [m]."""

OPTICAL_TO_BODY: NDArray[np.float64] = np.array(((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0)))
"""Equation III.7 with the sign that makes it a rotation (the paper's has determinant -1)."""
OPTICAL_TO_BODY.setflags(write=False)


def depth_of(disparity: NDArray[np.uint16]) -> NDArray[np.float64]:
    """Depths [m] of raw disparities of any shape; NaN where nothing was seen, or behind what can be."""
    dd = DISPARITY_SLOPE * disparity.astype(np.float64) + DISPARITY_OFFSET
    return np.where((disparity < NO_DISPARITY) & (dd > 0), DEPTH_SCALE / np.where(dd > 0, dd, 1.0), np.nan)


def disparity_of(depth: NDArray[np.floating]) -> NDArray[np.uint16]:
    """The nearest raw disparities of depths [m] of any shape: 2047 where a depth is not positive, or not finite."""
    known = np.isfinite(depth) & (depth > 0)
    raw = (DEPTH_SCALE / np.where(known, depth, 1.0).astype(np.float64) - DISPARITY_OFFSET) / DISPARITY_SLOPE
    seen = known & (raw > -0.5) & (raw < NO_DISPARITY - 0.5)
    return np.where(seen, np.rint(np.where(seen, raw, 0.0)), NO_DISPARITY).astype(np.uint16)


def mount_of(rotation: NDArray[np.float64]) -> tuple[float, float, float]:
    """Roll, pitch and yaw [rad] of the mount whose ``mount_rotation`` is a rotation [3, 3] from optical axes."""
    from scipy.spatial.transform import Rotation

    yaw, pitch, roll = Rotation.from_matrix(rotation @ OPTICAL_TO_BODY.T).as_euler("ZYX")
    return float(roll), float(pitch), float(yaw)


def mount_rotation(mount: CameraSpec) -> NDArray[np.float64]:
    """The rotation [3, 3] from optical axes to the robot's: III.7, then roll, pitch and yaw of the mount.

    They turn about the robot's x, y and z, so that a positive pitch looks down.
    """
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_euler("ZYX", (mount.yaw, mount.pitch, mount.roll))
    return np.asarray(turn.as_matrix() @ OPTICAL_TO_BODY)


def optical_rays(*, colour: bool) -> NDArray[np.float64]:
    """Directions [480, 640, 3] of the pixels' centres in optical axes, with z = 1, of the colour or depth camera."""
    focal, (cx, cy) = (RGB_FOCAL, RGB_CENTRE) if colour else (FOCAL, CENTRE)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    return np.stack(((columns - cx) / focal, (rows - cy) / focal, np.ones_like(rows)), axis=-1)
