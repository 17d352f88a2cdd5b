"""What the camera sees: the kernel against rays followed one by one, floor and walls, colours and disparities."""

import numpy as np
import pytest
from kernel_cases import rays_of
from twins.camera import look
from ucsd_robot import CAMERA

from moteslam.kernels.camera import depth_view_of, render_colour, render_disparity, view_of
from moteslam.kernels.raycast import build_buckets, cast_rays
from moteslam.robot import rgbd
from moteslam.robot.se2 import transform_points

MOUNT = CAMERA
ROTATION = rgbd.mount_rotation(MOUNT)
# a room with a slanted wall, a box, and an opening in the east through which nothing is seen
WALLS = np.array(
    [(-3, -2, 6, -2.5), (-3, 2, 6, 2), (-3, -2, -3, 2), (6, -2.5, 6, -0.6), (6, 0.7, 6, 2),
     (2.0, -0.9, 2.4, -0.9), (2.4, -0.9, 2.4, -0.5), (2.4, -0.5, 2.0, -0.5), (2.0, -0.5, 2.0, -0.9)],
    np.float64,
)  # fmt: skip
POSES = np.array([(0.0, 0.0, 0.0), (0.4, 0.3, 2.2), (4.0, -1.2, -0.7)])
FLOOR_CELL = 0.02


def place(colour: bool) -> np.ndarray:
    return np.array((MOUNT.x, MOUNT.y, MOUNT.z)) + ROTATION @ np.array((rgbd.RGB_OFFSET * colour, 0.0, 0.0))


def view(colour: bool):
    optical = rgbd.optical_rays(colour=colour)
    return view_of(np.concatenate((optical @ ROTATION.T, optical[..., 2:]), axis=-1), height=float(place(colour)[2]))


def reaches(bearings: np.ndarray, colour: bool) -> tuple[np.ndarray, np.ndarray]:
    cameras = POSES.copy()
    for camera in cameras:
        camera[:2] = transform_points(camera, place(colour)[:2])
    origins, angles = rays_of(cameras, bearings)
    return cameras, cast_rays(build_buckets(WALLS), origins, angles, max_range=100.0).reshape(len(cameras), -1)


@pytest.fixture(scope="module")
def chosen() -> np.ndarray:
    """Pixels (row, column) to look at, 60 a pose."""
    rng = np.random.default_rng(5)
    return np.stack((rng.integers(0, 480, 60), rng.integers(0, 640, 60)), axis=-1)


@pytest.mark.usefixtures("taichi")
def test_disparities_are_those_of_rays_followed_one_by_one(chosen: np.ndarray) -> None:
    depth = depth_view_of(
        view(False), scale=1.03, offset=3.31, slope=-0.00304, nothing=2047, nearest=0.4, farthest=4.0, grazing=0.05
    )
    _, far = reaches(depth.view.bearings, False)
    pixels = 480 * 640
    images = render_disparity(depth, far, noise=np.zeros(pixels, np.float32), starts=np.zeros(3, int))
    images = images.reshape(3, 480, 640)
    off, walls, nothing = 0, 0, 0
    for image, pose in zip(images, POSES, strict=True):
        for row, column in chosen:
            point, metres, on_floor = look((row, column), pose, WALLS, colour=False)
            seen = 0.4 <= metres <= 4.0
            if on_floor:  # too flat a ray is lost
                seen &= bool(0.36 / np.hypot(*(point[:2] - transform_points(pose, place(False)[:2]))) >= 0.05)
            expected = (3.31 - 1.03 / metres) / 0.00304 if seen else 2047
            off += bool(abs(float(image[row, column]) - expected) > 0.51)
            walls += seen and not on_floor
            nothing += not seen
    assert walls > 20
    assert nothing > 2
    assert off <= 2  # at the edge of a box, half a pixel decides


@pytest.mark.usefixtures("taichi")
def test_colours_are_those_of_the_floor_where_the_rays_meet_it(chosen: np.ndarray) -> None:
    seen_from = view(True)
    cameras, far = reaches(seen_from.bearings, True)
    columns, rows = np.meshgrid(np.arange(700), np.arange(400))
    floor = (columns % 256 + 256 * (rows % 256) + 65536 * (columns // 256 + 8 * (rows // 256))).astype(np.int32)
    corner = (-5.0, -4.0)
    noise = np.zeros(480 * 640 + 2 * 640, np.float32)
    packed = render_colour(
        seen_from, cameras, far, floor, corner=corner, cell_size=FLOOR_CELL, noise=noise, starts=np.zeros(3, int)
    ).reshape(3, 480, 640)
    floors, off = 0, 0
    for image, pose in zip(packed, POSES, strict=True):
        for row, column in chosen:
            point, metres, on_floor = look((row, column), pose, WALLS, colour=True)
            if on_floor and metres < 4:
                floors += 1
                red, green, blue = (int(image[row, column]) >> shift & 255 for shift in (0, 8, 16))
                cell = np.array((red + 256 * (blue % 8), green + 256 * (blue // 8)))
                off += bool(np.abs((cell + 0.5) * FLOOR_CELL + corner - point[:2]).max() > FLOOR_CELL / 2 + 1e-3)
    assert floors > 90
    assert off <= 1


@pytest.mark.usefixtures("taichi")
def test_noise_is_added_and_lost_pixels_are_nothing() -> None:
    depth = depth_view_of(
        view(False), scale=1.03, offset=3.31, slope=-0.00304, nothing=2047, nearest=0.4, farthest=8.0, grazing=0.0
    )
    _, far = reaches(depth.view.bearings, False)
    noise = np.zeros(480 * 640 + 10, np.float32)
    plain = render_disparity(depth, far[:1], noise=noise, starts=[0])[0]
    noise[7], noise[9] = 5.0, np.inf
    noise[11 + 470 * 640 :] = 3.0
    other = render_disparity(depth, far[:1], noise=noise, starts=[2])[0]
    assert other[5] in (plain[5] + 5, 2047)
    assert other[7] == 2047
    bottom = slice(9 + 470 * 640, None)
    assert (other[bottom] == plain[bottom] + 3).mean() > 0.99
    assert (other[1000 : 400 * 640] == plain[1000 : 400 * 640]).all()
