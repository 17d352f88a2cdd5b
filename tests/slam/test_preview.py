"""The small picture of an estimate: the map the right way up, and the path on it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from moteslam.robot.raster import Raster
from moteslam.slam.estimate import LONGEST, preview_png

SLAM = (0x00, 0x72, 0xB2)


def opened(png: bytes) -> np.ndarray:
    """The picture [height, width, 3], red, green, blue."""
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return image[..., ::-1].astype(int)


def room(rows: int, columns: int) -> Raster:
    """Free space with a wall along its top, somewhere."""
    log_odds = np.full((rows, columns), -9, np.float32)
    log_odds[-1] = 9
    return Raster(log_odds, 0.05, (-1.0, 2.0, 0.0))


@pytest.mark.parametrize(("rows", "columns"), [(40, 60), (400, 600), (1300, 2600)])
def test_the_largest_y_is_on_top_and_walls_stay(rows: int, columns: int) -> None:
    path = np.array([(-1.0, 2.0, 0.0), (-1.0 + 0.05 * columns, 2.0, 0.0)])
    image = opened(preview_png(room(rows, columns), path))
    assert max(image.shape) <= LONGEST
    assert max(image.shape) >= LONGEST / 2
    middle = image.shape[1] // 2
    assert image[0, middle].max() < 60
    blue = (abs(image - SLAM) < 40).all(axis=2)
    assert blue[-1, middle] or blue[-2, middle]
    assert not blue[: image.shape[0] // 2].any()


def test_unknown_space_is_cut_off() -> None:
    log_odds = np.zeros((500, 500), np.float32)
    log_odds[100:120, 200:260] = -9
    image = opened(preview_png(Raster(log_odds, 0.05), np.array([(11.0, 5.5, 0.0)])))
    height, width = image.shape[:2]
    assert width / height == pytest.approx((60 + 20) / (20 + 20), rel=0.02)


@pytest.mark.parametrize("place", [(0.0, 0.0), (1e4, -1e4)])
def test_a_robot_that_never_moved_and_knows_nothing(place: tuple[float, float]) -> None:
    still = np.array([(*place, 0.0)] * 2)
    assert opened(preview_png(Raster(np.zeros((10, 10), np.float32), 0.05), still)).size > 0
