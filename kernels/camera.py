"""What a camera over a floor sees: the colours and the depth of the floor and of walls that stand upright on it.

Every wall is taller than the view, so along one bearing nothing is seen beyond the first wall. For each frame a fan
of exact rays from the camera (``cast_rays``) gives the floor's reach at each bearing, and a pixel sees the floor if its
ray meets it within that reach. Between two bearings of the fan the inverse of the reach is interpolated, which changes
evenly along a straight wall; at a jump the nearer bearing counts. The camera does not tilt while it drives, so all else
about a pixel is the same in every frame and computed once.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.kernels.checks import as_finite, check_array
from moteslam.kernels.runtime import one_thread, ti
from moteslam.kernels.types import F32, F32_1D, F32_2D, I32, I32_1D, U16_1D, func, kernel, template

_FAR = 1e6
_RESOLUTION = 4e-4  # Of the fan [rad]; 2 mm at 5 m
_JUMP = 0.05  # Two neighbouring bearings whose inverse reaches differ by more than this share lie on different walls


@dataclass(frozen=True, eq=False)
class View:
    """A camera's pixels as rays from one point, in the robot's axes."""

    # [5, pixels] float32: cosine and sine of the bearing; its place between the fan's bearings before and after
    # it, 0 to 1; inverse distance to the floor [1/m], 0 where the ray does not meet it; rise [m/m].
    rays: NDArray[np.float32]
    bins: NDArray[np.int32]  # [pixels] int32 index of the fan's bearing before
    depths: NDArray[np.float32]  # [pixels] depth along the optical axis over the distance along the floor [m/m]
    bearings: NDArray[np.float64]  # [b] float64 of the fan [rad], evenly spaced
    height: float  # of the camera above the floor [m]
    run: int  # pixels that one thread draws one after another: a row of the image


@dataclass(frozen=True, eq=False)
class DepthView:
    """The view of a depth camera that gives raw disparities d: scale / depth = slope d + offset."""

    view: View  # its pixels
    # [4, pixels] float32: d of the floor, infinite where it is not met; d measured of it, infinite where it is
    # lost; factor of the inverse reach of a wall; place between bearings as in ``View.rays``.
    table: NDArray[np.float32]
    offset: float  # added to that product for the d of a wall
    limits: tuple[float, float]  # smallest and largest d that can be measured
    nothing: int  # value of a pixel that measures nothing


def view_of(directions: ArrayLike, *, height: float) -> View:
    """The view of a camera at a height above the floor [m].

    Its ``directions`` [rows, columns, 4] are of every pixel: x, y, z in the robot's axes, and the depth along the
    optical axis, all for the same length of the ray.
    """
    image = as_finite("directions", directions, np.float64, (None, None, 4))
    rays = image.reshape(-1, 4)
    level = np.maximum(np.hypot(rays[:, 0], rays[:, 1]), 1e-9)
    middle = float(np.arctan2(rays[:, 1].mean(), rays[:, 0].mean()))
    bearing = np.mod(np.arctan2(rays[:, 1], rays[:, 0]) - middle + np.pi, 2 * np.pi) - np.pi
    low, high = float(bearing.min()), float(bearing.max())
    count = max(2, int(np.ceil((high - low) / _RESOLUTION)) + 1)
    step = max(high - low, 1e-6) / (count - 1)
    at = (bearing - low) / step
    bins = np.clip(at.astype(np.int32), 0, count - 2)
    rise = rays[:, 2] / level
    rows = (rays[:, 0] / level, rays[:, 1] / level, at - bins, np.maximum(-rise, 0) / height, rise)
    return View(
        np.stack(rows).astype(np.float32),
        bins.astype(np.int32),
        (rays[:, 3] / level).astype(np.float32),
        middle + low + step * np.arange(count, dtype=np.float64),
        float(height),
        image.shape[1],
    )


def depth_view_of(
    view: View,
    *,
    scale: float,
    offset: float,
    slope: float,
    nothing: int,
    nearest: float,
    farthest: float,
    grazing: float,
) -> DepthView:
    """The view of a depth camera whose raw disparity grows with the depth.

    Args:
        scale: [m], offset, slope: scale / depth = slope d + offset, slope below 0.
        nothing: value of a pixel that measures nothing, above any disparity.
        nearest, farthest: depths that can be measured [m].
        grazing: floor that is met at a smaller slope than this is not measured [m/m].
    """
    inverse = view.rays[3].astype(np.float64)
    met = inverse > 0
    floor = np.where(met, (scale * inverse / view.depths - offset) / slope, np.inf)
    measured = np.where(met & (-view.rays[4] >= grazing), floor, np.inf)
    table = np.stack((floor, measured, scale / (view.depths.astype(np.float64) * slope), view.rays[2]))
    lowest, highest = ((scale / depth - offset) / slope for depth in (nearest, farthest))
    return DepthView(view, table.astype(np.float32), -offset / slope, (lowest, highest), nothing)


@func
def _inverse_reach(fan: template, frame: I32, before: I32, share: F32):
    """The inverse of the floor's reach at a bearing [1/m], from those of the fan [frames, b]."""
    a, b = fan[frame, before], fan[frame, before + 1]
    same_wall = abs(a - b) <= ti.f32(_JUMP) * ti.max(a, b)
    nearer = ti.select(share < ti.f32(0.5), a, b)
    return ti.select(same_wall, a + share * (b - a), nearer)


@func
def _level(value: F32):
    return ti.cast(ti.min(ti.max(value + ti.f32(0.5), ti.f32(0.0)), ti.f32(255.0)), ti.i32)


@kernel
def _colour(
    rays: F32_2D, bins: I32_1D, fan: F32_2D, cameras: F32_2D, height: F32, floor: I32_1D, rows: I32, columns: I32,
    per_metre: F32, noise: F32_1D, starts: I32_1D, run: I32, out: I32_1D,
):  # fmt: skip
    pixels = rays.shape[1]
    runs = pixels // run
    ti.loop_config(serialize=ti.static(one_thread()))
    for frame, r in ti.ndrange(cameras.shape[0], runs):
        x0, y0, ch, sh = cameras[frame, 0], cameras[frame, 1], cameras[frame, 2], cameras[frame, 3]
        start = starts[frame]
        for p in range(r * run, (r + 1) * run):
            c, s = rays[0, p], rays[1, p]
            inverse = _inverse_reach(fan, frame, bins[p], rays[2, p])
            on_floor = rays[3, p] >= inverse
            along = ti.f32(1.0) / ti.max(ti.max(rays[3, p], inverse), ti.f32(1.0 / _FAR))
            x = x0 + along * (ch * c - sh * s)
            y = y0 + along * (sh * c + ch * s)
            red, green, blue = ti.f32(0.0), ti.f32(0.0), ti.f32(0.0)
            if on_floor:
                col = ti.cast(ti.min(ti.max(x * per_metre, ti.f32(0.0)), ti.cast(columns - 1, ti.f32)), ti.i32)
                row = ti.cast(ti.min(ti.max(y * per_metre, ti.f32(0.0)), ti.cast(rows - 1, ti.f32)), ti.i32)
                texel = floor[row * columns + col]
                red = ti.cast(texel & 255, ti.f32)
                green = ti.cast((texel >> 8) & 255, ti.f32)
                blue = ti.cast((texel >> 16) & 255, ti.f32)
            else:  # the paint of a wall: upright panels of several tints over a dark skirting
                panel = ti.f32(0.382) * ti.floor(x * ti.f32(1.25)) + ti.f32(0.618) * ti.floor(y * ti.f32(1.25))
                tint = ti.f32(40.0) * (panel - ti.floor(panel))
                red, green, blue = ti.f32(206.0) - tint, ti.f32(204.0) - ti.f32(0.6) * tint, ti.f32(192.0)
                if height + along * rays[4, p] < ti.f32(0.08):
                    red, green, blue = ti.f32(70.0), ti.f32(58.0), ti.f32(50.0)
            at = start + p
            out[frame * pixels + p] = (
                _level(red + noise[at])
                | (_level(green + noise[at + run]) << 8)
                | (_level(blue + noise[at + 2 * run]) << 16)
            )


@kernel
def _disparity(
    floor: F32_2D, bins: I32_1D, fan: F32_2D, offset: F32, lowest: F32, highest: F32, nothing: F32, noise: F32_1D,
    starts: I32_1D, run: I32, out: U16_1D,
):  # fmt: skip
    pixels = floor.shape[1]
    ti.loop_config(serialize=ti.static(one_thread()))
    for frame, r in ti.ndrange(fan.shape[0], pixels // run):
        start = starts[frame]
        for p in range(r * run, (r + 1) * run):
            wall = floor[2, p] * _inverse_reach(fan, frame, bins[p], floor[3, p]) + offset
            value = ti.select(wall < floor[0, p], wall, floor[1, p])
            seen = (value >= lowest) & (value <= highest)
            value = ti.select(seen, ti.floor(value + noise[start + p] + ti.f32(0.5)), nothing)
            out[frame * pixels + p] = ti.cast(ti.min(ti.max(value, ti.f32(0.0)), nothing), ti.u16)


def render_colour(
    view: View,
    poses: ArrayLike,
    reaches: NDArray[np.float32],
    floor: NDArray[np.int32],
    *,
    corner: tuple[float, float],
    cell_size: float,
    noise: NDArray[np.float32],
    starts: ArrayLike,
) -> NDArray[np.int32]:
    """The colour images of a camera.

    Args:
        poses: [n, 3] of the camera: x, y [m] and the heading of the robot's axes [rad].
        reaches: [n, b] distance to the first wall at each bearing of the view [m], inf for none.
        floor: int32 [H, W] colours as red + 256 green + 65536 blue, row 0 the smallest y.
        corner: (x, y) of the corner of its cell [0, 0] [m].
        cell_size: of the floor's picture [m].
        noise: float32 [k] added to the levels; frame f reads it from ``starts[f]`` to ``starts[f] + pixels`` and two
            image rows more.
        starts: [n] of each frame in the noise.

    Returns int32 [n, pixels]: red + 256 green + 65536 blue.
    """
    cameras = as_finite("poses", poses, np.float64, (None, 3))
    fan, first = _prepared(view, len(cameras), reaches, noise, starts, 2 * view.run)
    check_array("floor", floor, np.int32, (None, None))
    x, y, heading = cameras.T
    columns = (x - corner[0], y - corner[1], np.cos(heading), np.sin(heading))
    moved = np.stack(columns, axis=-1).astype(np.float32)
    out = np.empty((len(cameras), len(view.bins)), np.int32)
    if len(cameras):
        _colour(
            view.rays, view.bins, fan, moved, view.height, floor.reshape(-1), *floor.shape, 1 / cell_size, noise,
            first, view.run, out.reshape(-1),
        )  # fmt: skip
    return out


def render_disparity(
    depth: DepthView, reaches: NDArray[np.float32], *, noise: NDArray[np.float32], starts: ArrayLike
) -> NDArray[np.uint16]:
    """The raw disparity images of a depth camera.

    Args:
        reaches: [n, b] distance to the first wall at each bearing of the view [m], inf for none.
        noise: float32 [k] added before rounding, infinite for a pixel that is lost; frame f reads it from
            ``starts[f]`` to ``starts[f] + pixels``.
        starts: [n] of each frame in the noise.

    Returns uint16 [n, pixels].
    """
    view = depth.view
    fan, first = _prepared(view, len(reaches), reaches, noise, starts, 0)
    out = np.empty((len(fan), len(view.bins)), np.uint16)
    if len(fan):
        _disparity(
            depth.table, view.bins, fan, depth.offset, *depth.limits, float(depth.nothing), noise, first, view.run,
            out.reshape(-1),
        )  # fmt: skip
    return out


def _prepared(
    view: View, frames: int, reaches: NDArray[np.float32], noise: NDArray[np.float32], starts: ArrayLike, more: int
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Inverse reaches and starts, checked; a frame reads ``more`` numbers of the noise than it has pixels."""
    check_array("reaches", reaches, np.float32, (frames, len(view.bearings)))
    check_array("noise", noise, np.float32, (None,))
    first = as_finite("starts", starts, np.int32, (frames,))
    pixels = len(view.bins)
    if frames and not (first.min() >= 0 and first.max() + pixels + more <= len(noise)):
        raise InputError(f"out of bounds, expected {pixels + more} numbers of the noise after each", field="starts")
    return np.reciprocal(np.maximum(reaches, np.float32(1e-3))), first
