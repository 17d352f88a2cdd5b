"""SE(2) arithmetic in NumPy, the reference that the kernels are tested against, and rigid alignment of points.

A pose is ``(x, y, theta)`` [m, m, rad]; arrays of poses are float64, shape [..., 3], and broadcast.
Angles are wrapped to (-pi, pi]. Frames as in ROS REP 103: x forward, y left, theta counterclockwise.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Poses = Array
"""[..., 3]: x [m], y [m], theta [rad]."""
Pose = tuple[float, float, float]
"""One of them in plain numbers: for single poses arrays take five times as long."""

IDENTITY: Poses = np.zeros(3)
IDENTITY.setflags(write=False)


def wrap(angle: ArrayLike) -> NDArray[np.float64]:
    """The angle [rad] wrapped to (-pi, pi]; one that lies there already comes back bit for bit."""
    angle = np.asarray(angle, np.float64)
    if angle.size and np.abs(angle).max() < np.pi:  # most often
        return angle.copy()
    good = (angle > -np.pi) & (angle <= np.pi)
    wrapped = np.pi - np.mod(np.pi - angle, 2 * np.pi)
    wrapped = np.where(wrapped <= -np.pi, np.pi, wrapped)  # just beyond pi, the rounding of mod ends there
    return np.where(good, angle, wrapped)


def compose(a: ArrayLike, b: ArrayLike) -> Poses:
    """The pose ``b``, given in the frame of ``a``, expressed where ``a`` is: a (+) b, shape [..., 3]."""
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    if a.ndim == b.ndim == 1:
        return np.array(compose_one(as_pose(a), as_pose(b)))
    cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
    x = a[..., 0] + cos * b[..., 0] - sin * b[..., 1]
    y = a[..., 1] + sin * b[..., 0] + cos * b[..., 1]
    return stack(x, y, wrap(a[..., 2] + b[..., 2]))


def stack(x: Array, y: Array, heading: Array) -> Poses:
    """The poses of three columns, in half the time of ``np.stack`` where they are few."""
    poses = np.empty((*x.shape, 3))
    poses[..., 0], poses[..., 1], poses[..., 2] = x, y, heading
    return poses


def as_pose(pose: NDArray[np.float64]) -> Pose:
    """An array [3] in plain numbers."""
    x, y, theta = pose.tolist()
    return x, y, theta


def compose_one(a: Pose, b: Pose) -> Pose:
    """``compose`` of two single poses."""
    (x, y, theta), (forward, left, turn) = a, b
    cos, sin = math.cos(theta), math.sin(theta)
    return x + cos * forward - sin * left, y + sin * forward + cos * left, _wrap_one(theta + turn)


def inverse_one(a: Pose) -> Pose:
    """``inverse`` of a single pose."""
    x, y, theta = a
    cos, sin = math.cos(theta), math.sin(theta)
    return -cos * x - sin * y, sin * x - cos * y, _wrap_one(-theta)


def between_one(a: Pose, b: Pose) -> Pose:
    """``between`` of two single poses."""
    return compose_one(inverse_one(a), b)


def heading(quaternions: ArrayLike) -> NDArray[np.float64]:
    """The rotation about z [rad] of quaternions (x, y, z, w) of any length but 0, shape [..., 4]: yaw of ZYX angles."""
    x, y, z, w = np.moveaxis(np.asarray(quaternions, np.float64), -1, 0)
    return wrap(np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z))


def _wrap_one(angle: float) -> float:
    return angle if -math.pi < angle <= math.pi else float(wrap(angle))


def inverse(a: ArrayLike) -> Poses:
    """The pose that undoes ``a``, shape [..., 3]: composed with ``a`` it gives the identity."""
    a = np.asarray(a, np.float64)
    if a.ndim == 1:
        return np.array(inverse_one(as_pose(a)))
    cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
    return stack(-cos * a[..., 0] - sin * a[..., 1], sin * a[..., 0] - cos * a[..., 1], wrap(-a[..., 2]))


def between(a: ArrayLike, b: ArrayLike) -> Poses:
    """The pose of ``b`` in the frame of ``a``: b (-) a, shape [..., 3]."""
    return compose(inverse(a), b)


def transform_points(pose: ArrayLike, points: ArrayLike) -> NDArray[np.float64]:
    """Points [..., 2] [m], given in the frame of one pose [3], expressed where the pose is."""
    x, y, theta = np.asarray(pose, np.float64).tolist()
    a, b = np.moveaxis(np.asarray(points, np.float64), -1, 0)
    cos, sin = math.cos(theta), math.sin(theta)
    return np.stack((x + cos * a - sin * b, y + sin * a + cos * b), axis=-1)


def accumulate(increments: ArrayLike, start: ArrayLike = IDENTITY) -> Poses:
    """The path [n, 3] of increments [n, 3], each in the frame of the pose before it; the first in that of the start."""
    increments, start = np.asarray(increments, np.float64), np.asarray(start, np.float64)
    heading = start[2] + np.cumsum(increments[:, 2])
    before = np.concatenate(([start[2]], heading[:-1]))
    cos, sin = np.cos(before), np.sin(before)
    x = start[0] + np.cumsum(cos * increments[:, 0] - sin * increments[:, 1])
    y = start[1] + np.cumsum(sin * increments[:, 0] + cos * increments[:, 1])
    return stack(x, y, wrap(heading))


def interpolate(stamps: ArrayLike, poses: ArrayLike, at: ArrayLike) -> Poses:
    """The poses [m, 3] at times [m] [s], linear in x, y and the unwrapped heading, held beyond the ends.

    They lie between poses [n, 3] at stamps [n] [s] that do not decrease.
    """
    stamps, poses, at = (np.asarray(a, np.float64) for a in (stamps, poses, at))
    x, y, heading = (np.interp(at, stamps, column) for column in (*poses.T[:2], np.unwrap(poses[:, 2])))
    return stack(x, y, wrap(heading))


def umeyama(source: NDArray[np.float64], target: NDArray[np.float64]) -> Poses:
    """The pose [3] that moves points [n, 2] onto others with the least squared distance (Umeyama 1991, without scale).

    In the plane its singular value decomposition has a closed form: the angle is that of the summed dot and cross
    products of the centred points. Where the points leave it open (all in one place) there is no rotation.
    """
    centre, goal = source.mean(axis=0), target.mean(axis=0)
    a, b = source - centre, target - goal
    dot, cross = float((a * b).sum()), float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())
    # below this the sums are rounding of coordinates far from the origin, and their angle is noise
    rounding = len(a) * (np.finfo(float).eps * max(1.0, float(np.abs(source).max()))) ** 2
    angle = float(np.arctan2(cross, dot)) if np.hypot(dot, cross) > rounding else 0.0
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = goal[0] - cos * centre[0] + sin * centre[1], goal[1] - sin * centre[0] - cos * centre[1]
    return np.array([x, y, angle])
