"""The Kinect's geometry: the published alignment is a pinhole camera, and the mount looks where the drawing says."""

import numpy as np
import pytest
from twins.camera import optical_to_robot
from ucsd_robot import CAMERA

from moteslam.robot import rgbd


def test_the_alignment_is_a_camera_26_mm_to_the_right() -> None:
    point = np.array((0.3, -0.2, 1.7))
    i, j = rgbd.FOCAL * point[:2] / point[2] + rgbd.CENTRE
    dd = 1.03 / point[2]
    published = ((526.37 * i - 4.5 * 1750.46 * dd + 19276) / 585.051, (526.37 * j + 16662) / 585.051)
    seen = rgbd.RGB_FOCAL * (point[:2] - (rgbd.RGB_OFFSET, 0)) / point[2] + rgbd.RGB_CENTRE
    assert seen == pytest.approx(published, abs=1e-9)
    assert pytest.approx(0.0263, abs=1e-4) == rgbd.RGB_OFFSET


def test_the_mount_turns_as_the_twin_does() -> None:
    points = np.random.default_rng(0).normal(size=(20, 3))
    mount = CAMERA
    turned = points @ rgbd.mount_rotation(mount).T + (mount.x, mount.y, mount.z)
    assert turned == pytest.approx(optical_to_robot(points), abs=1e-12)
    assert np.linalg.det(rgbd.mount_rotation(mount)) == pytest.approx(1.0)


def test_the_camera_looks_ahead_and_down() -> None:
    ahead = rgbd.mount_rotation(CAMERA) @ (0, 0, 1)
    assert np.arctan2(-ahead[2], np.hypot(*ahead[:2])) == pytest.approx(0.36)
    assert np.arctan2(ahead[1], ahead[0]) == pytest.approx(0.021)
    right = rgbd.mount_rotation(CAMERA.model_copy(update={"yaw": 0.0})) @ (1, 0, 0)
    assert right == pytest.approx((0, -1, 0), abs=1e-12)
