"""What the camera sees, against rays followed one by one; and colours into cells, against the published formulas."""

import numpy as np
import pytest
from kernel_cases import rays_of
from twins.camera import add_frame as twin
from twins.camera import disparity_of, look
from ucsd_robot import CAMERA

from moteslam.kernels.camera import depth_view_of, render_colour, render_disparity, view_of
from moteslam.kernels.raycast import build_buckets, cast_rays
from moteslam.kernels.texture import UNKNOWN, add_frame, match_colours
from moteslam.robot import rgbd
from moteslam.robot.rgbd import mount_rotation
from moteslam.robot.se2 import transform_points
from moteslam.sim.sensors.rgbd import optical_rays
from moteslam.slam.texture.floor_map import calibration

pytestmark = pytest.mark.usefixtures("taichi")

ROTATION = rgbd.mount_rotation(CAMERA)
# a room with a slanted wall, a box, and an opening in the east through which nothing is seen
WALLS = np.array(
    [(-3, -2, 6, -2.5), (-3, 2, 6, 2), (-3, -2, -3, 2), (6, -2.5, 6, -0.6), (6, 0.7, 6, 2),
     (2.0, -0.9, 2.4, -0.9), (2.4, -0.9, 2.4, -0.5), (2.4, -0.5, 2.0, -0.5), (2.0, -0.5, 2.0, -0.9)],
    np.float64,
)  # fmt: skip
POSES = np.array([(0.0, 0.0, 0.0), (0.4, 0.3, 2.2), (4.0, -1.2, -0.7)])
FLOOR_CELL = 0.02


def place(colour: bool) -> np.ndarray:
    return np.array((CAMERA.x, CAMERA.y, CAMERA.z)) + ROTATION @ np.array((rgbd.RGB_OFFSET * colour, 0.0, 0.0))


def view(colour: bool):
    optical = optical_rays(colour=colour)
    return view_of(np.concatenate((optical @ ROTATION.T, optical[..., 2:]), axis=-1), height=float(place(colour)[2]))


def depth_view(**limits: float):
    numbers = {"scale": 1.03, "offset": 3.31, "slope": -0.00304, "nothing": 2047, "nearest": 0.4}
    return depth_view_of(view(False), **numbers, **limits)


def reaches(bearings: np.ndarray, colour: bool) -> tuple[np.ndarray, np.ndarray]:
    cameras = POSES.copy()
    for camera in cameras:
        camera[:2] = transform_points(camera, place(colour)[:2])
    origins, angles = rays_of(cameras, bearings)
    return cameras, cast_rays(build_buckets(WALLS), origins, angles, max_range=100.0)[0].reshape(len(cameras), -1)


@pytest.fixture(scope="module")
def chosen() -> np.ndarray:
    """Pixels (row, column) to look at, 60 a pose."""
    rng = np.random.default_rng(5)
    return np.stack((rng.integers(0, 480, 60), rng.integers(0, 640, 60)), axis=-1)


def test_disparities_are_those_of_rays_followed_one_by_one(chosen: np.ndarray) -> None:
    depth = depth_view(farthest=4.0, grazing=0.05)
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


def test_noise_is_added_and_lost_pixels_are_nothing() -> None:
    depth = depth_view(farthest=8.0, grazing=0.0)
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


TO_ROBOT = np.column_stack((mount_rotation(CAMERA), (0.18, 0.005, 0.36)))
PLACE = {"corner": (-4.0, -4.0), "cell_size": 0.05}


def frame(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A disparity image of floor and things on it, with holes of every kind, and random colours."""
    rng = np.random.default_rng(seed)
    row = np.arange(480)[:, None] + np.zeros((1, 640))
    slope = np.maximum(np.sin(0.36) + np.cos(0.36) * (row - 242.94) / 585.05, 0.02)
    depth = 0.36 / slope * rng.uniform(0.6, 1.1, (480, 640))
    disparity = np.clip(np.rint(disparity_of(depth)), 1, 1085).astype(np.uint16)
    disparity[rng.random((480, 640)) < 0.05] = 2047
    disparity[rng.random((480, 640)) < 0.02] = 0
    disparity[rng.random((480, 640)) < 0.02] = 1500
    return disparity, rng.integers(0, 256, (480, 640, 3), dtype=np.uint8)


def add(sums: np.ndarray, disparity: np.ndarray, rgb: np.ndarray, pose: object, **changes: object) -> None:
    settings = {
        **PLACE, "calibration": calibration(), "mount": TO_ROBOT, "height_limit": 0.1, "max_depth": 5.0, "nothing": 2047
    }  # fmt: skip
    add_frame(sums, disparity, rgb, pose, **{**settings, **changes})  # type: ignore[arg-type]


@pytest.mark.parametrize("flat", [False, True])
def test_agrees_with_the_published_formulas(flat: bool) -> None:
    ours, theirs = np.zeros((160, 200, 4), np.int64), np.zeros((160, 200, 4), np.int64)
    for seed, pose in enumerate([(0.0, 0.0, 0.0), (0.7, -0.4, 2.0), (3.0, 1.0, -1.2)]):
        disparity, rgb = frame(seed)
        add(ours, disparity, rgb, pose, flat=flat)
        twin(
            theirs,
            disparity,
            rgb,
            pose,
            **PLACE,
            height_limit=0.1,
            max_depth=5.0,
            camera=TO_ROBOT[:, 3] if flat else None,
        )
    assert theirs[..., 3].sum() > 400_000
    # points within float32's reach of a cell's side, or colour pixels of a half, may fall to the other side
    assert np.abs(ours - theirs)[..., 3].sum() < 2e-4 * theirs[..., 3].sum()
    assert np.abs(ours - theirs)[..., :3].sum() < 1e-3 * theirs[..., :3].sum()


def test_only_what_is_low_near_and_inside_counts() -> None:
    disparity, rgb = frame(0)

    def count(**changes: object) -> int:
        sums = np.zeros((160, 160, 4), np.int64)
        add(sums, disparity, rgb, (0.0, 0.0, 0.0), **changes)
        return int(sums[..., 3].sum())

    assert count(height_limit=-1e3) == 0
    assert count(height_limit=0.0) < count() < count(height_limit=1e3)
    assert count(max_depth=1.0) < count()
    assert count(corner=(50.0, 50.0)) == 0
    assert count(nothing=1) == 0
    elsewhere = np.zeros((160, 160, 4), np.int64)
    add(elsewhere, disparity, rgb, (1e9, 0.0, 0.0))
    assert not elsewhere.any()


def compared_by_numpy(points, colours, poses, packed, *, corner, cell_size, limit):
    out = []
    for pose in poses:
        cells = np.floor((transform_points(pose, points) - corner) / cell_size).astype(int)
        inside = ((cells >= 0) & (cells < packed.shape[::-1])).all(axis=1)
        there = packed[cells[inside, 1], cells[inside, 0]]
        here = colours[inside][there != UNKNOWN]
        there = there[there != UNKNOWN]
        apart = sum(np.abs((here >> shift & 255) - (there >> shift & 255)) for shift in (0, 8, 16))
        out.append((np.minimum(apart, limit).sum(), len(there)))
    return np.array(out)


def case(seed: int):
    rng = np.random.default_rng(seed)
    points = rng.uniform((0, -2), (4, 2), (1500, 2)).astype(np.float32)
    colours = rng.integers(0, 2**24, 1500).astype(np.int32)
    packed = rng.integers(0, 2**24, (70, 90)).astype(np.int32)
    packed[rng.random(packed.shape) < 0.3] = UNKNOWN
    poses = rng.uniform((-3, -3, -3), (3, 3, 3), (40, 3))
    return points, colours, poses, packed


def test_agrees_with_numpy() -> None:
    given, options = case(0), {"corner": (-2.0, -1.5), "cell_size": 0.05, "limit": 200}
    ours, theirs = match_colours(*given, **options), compared_by_numpy(*given, **options)
    assert theirs[:, 1].max() > 300
    assert np.abs(ours - theirs)[:, 1].max() <= 1  # float32 at the side of a cell
    assert np.abs(ours - theirs)[:, 0].max() <= 200
