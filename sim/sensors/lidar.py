"""A planar scanning lidar, its beams cast one after the other while the robot moves."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import ConfigError
from moteslam.robot.noise import DriveNoise, LidarNoise
from moteslam.robot.platform import LidarSpec, Platform, ScanFigures
from moteslam.robot.recording import LidarStream
from moteslam.robot.se2 import Array
from moteslam.robot.values import given_up
from moteslam.sim.robot.drive import Drive
from moteslam.sim.sensors.clock import readings
from moteslam.sim.sensors.echoes import Rays, Scene, mix_at_edges
from moteslam.sim.sensors.faults import Cart, Tilt, leaning


@dataclass(frozen=True)
class LidarErrors:
    """What is wrong with one lidar on one robot, the same over a recording."""

    bias: float = 0.0  # that all ranges are too long [m]
    scale: float = 0.0  # likewise, relative
    x: float = 0.0  # where the lidar truly is beside its mount [m]
    y: float = 0.0  # [m]
    yaw: float = 0.0  # [rad]
    roll: float = 0.0  # how it truly tilts [rad]
    pitch: float = 0.0  # [rad]

    @classmethod
    def drawn(cls, noise: LidarNoise, rng: np.random.Generator) -> Self:
        x, yaw, tilt = noise.mount_error, noise.mount_yaw_error, noise.mount_tilt_error
        spread = np.array((noise.range_bias, noise.range_scale_error, x, x, yaw, tilt, tilt))
        return cls(*(rng.standard_normal(len(spread)) * spread).tolist())


_RAYS = 512 * 1081  # Rays at a time; scans are not divided


class Lidar:
    """A lidar: beam b of a scan at time t is cast from where it truly is at t + b * time_increment.

    The first scan's and the last scan's first beam are at the ends of a ``span`` [s]. Of a scenario's ``faults`` carts
    in view and mounts aslant count; ``rng`` is of noise and clock, ``effects`` of surfaces, edges and rain.
    """

    def __init__(
        self,
        lidar: LidarSpec,
        noise: LidarNoise,
        span: tuple[float, float],
        rng: np.random.Generator,
        *,
        errors: LidarErrors = LidarErrors(),
        faults: Sequence[object] = (),
        effects: np.random.Generator,
    ) -> None:
        self._lidar, self._noise, self._errors, self._rng, self._effects = lidar, noise, errors, rng, effects
        # [n] when the scans begin, and as the host stamps them, from 0 [s]
        self.times, self.stamps = readings(lidar.scan.rate, *span, noise.clock, rng)
        self._carts = [fault for fault in faults if isinstance(fault, Cart)]
        self._aslant = [fault for fault in faults if isinstance(fault, Tilt)]
        self._mount = lidar.model_copy(
            update={"x": lidar.x + errors.x, "y": lidar.y + errors.y, "yaw": lidar.yaw + errors.yaw}
        )
        self._read = 0

    def read(
        self,
        drive: Drive,
        scene: Scene,
        until: int,
        *,
        tilt: Array | None = None,
        progress: Callable[[float], None] = lambda _: None,
    ) -> LidarStream:
        """The scans from where it was read last to before another one, with roll and pitch ``tilt`` [n, 2] of the body
        [rad].

        That is at the drive's stamps; None for a body that stays level. Ranges are ``inf`` beyond the maximum, ``nan``
        below the minimum and where a beam was lost.
        """
        lidar, scan, first = self._lidar, self._lidar.scan, self._read
        self._read = until
        ranges = np.empty((until - first, scan.beams), np.float32)
        at_a_time = max(1, _RAYS // scan.beams)
        for start in range(first, until, at_a_time):
            rows = slice(start, min(start + at_a_time, until))
            ranges[start - first : rows.stop - first] = self._scans(drive, scene, self.times[rows], tilt)
            progress(min(1.0, (start + at_a_time - first) / len(ranges)))
        figures = scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max, lidar.time_increment
        return LidarStream(self.stamps[first:until], given_up(ranges), *figures)

    def _scans(self, drive: Drive, scene: Scene, times: Array, tilt: Array | None) -> NDArray[np.float32]:
        """The ranges [m, beams] of scans that begin at some times [m] [s]."""
        lidar, scan, noise, errors = self._lidar, self._lidar.scan, self._noise, self._errors
        moments = times[:, None] + lidar.time_increment * np.arange(scan.beams)
        angles = scan.angle_min + scan.angle_increment * np.arange(scan.beams)
        poses, mount = _at(drive, moments, drive.poses), self._mount
        cos, sin = np.cos(poses[..., 2]), np.sin(poses[..., 2])
        poses[..., 0] += cos * mount.x - sin * mount.y
        poses[..., 1] += sin * mount.x + cos * mount.y
        poses[..., 2] += mount.yaw
        rays = Rays(poses[..., :2].reshape(-1, 2), (poses[..., 2] + angles).reshape(-1), moments.reshape(-1))
        exact = beam_ranges(scene, rays, scan, noise, self._effects)
        if tilt is not None or errors.roll or errors.pitch or self._aslant:
            leans = np.array((errors.roll, errors.pitch)) + (0.0 if tilt is None else _at(drive, moments, tilt))
            leans, height, grazing = leaning(leans, lidar.z, self._aslant, moments)
            bearings = np.tile(lidar.yaw + angles, len(moments))
            exact = tilted(exact, leans.reshape(-1, 2), bearings, height, grazing)
        for cart in self._carts:  # what is nearer hides the other
            seen = cart.ranges((errors.x, errors.y), np.asarray(self._mount.yaw + angles))
            met = np.where(cart.covers(moments), seen, np.inf).reshape(-1)
            exact = np.where(np.isfinite(met), np.fmin(exact, met), exact).astype(np.float32)
        if errors.scale or errors.bias:
            exact = (exact * (1 + errors.scale) + errors.bias).astype(np.float32)
        return measured(exact.reshape(-1, scan.beams), scan, noise, self._rng)


def beam_ranges(
    scene: Scene, rays: Rays, scan: ScanFigures, noise: LidarNoise, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Ranges float32 [n] [m] of beams before the sensor's noise: ``inf`` for no echo, ``nan`` for one of no use.

    A beam of some divergence is three rays, its middle and its two sides (see `mix_at_edges`). ``rng`` is drawn from
    only where something is random.
    """
    ranges = scene.echoes(rays, rng, max_range=scan.range_max)
    if noise.divergence > 0:
        half = noise.divergence / 2
        turned = [rays._replace(angles=rays.angles + off) for off in (-half, half)]
        sides = [scene.exact(each, max_range=scan.range_max) for each in turned]
        middle = ranges if scene.is_plain else scene.exact(rays, max_range=scan.range_max)
        ranges = mix_at_edges(ranges, middle, np.stack(sides), noise, rng)
    if noise.false_return > 0:  # what floats in the air (z_short of Probabilistic Robotics, table 6.1)
        met = rng.random(len(ranges), np.float32) < noise.false_return
        drop = scan.range_min + rng.exponential(noise.false_scale, len(ranges))
        ranges = np.where(met & ~(drop >= ranges), drop, ranges).astype(np.float32)
    return ranges


def tilted(
    level: NDArray[np.float32], leans: Array, bearings: Array, height: Array | float, grazing: Array | float = np.inf
) -> NDArray[np.float32]:
    """The ranges [n] of beams that do not lie level: walls are a little further, and some beams end on the floor.

    The lidar leans by roll and pitch [2] or [n, 2] [rad], so high above the floor [m], one or [n]; at 0 or below no
    floor is met, and it is measured from the angle ``grazing`` on [rad]. Bearings [n] are in the robot's frame [rad].
    """
    leans = np.broadcast_to(leans, (len(level), 2))
    down = leans[:, 1] * np.cos(bearings) + leans[:, 0] * -np.sin(bearings)
    slant = level / np.cos(down)
    with np.errstate(divide="ignore", invalid="ignore"):
        floor = np.where((down > 0) & (np.asarray(height) > 0), height / np.sin(np.maximum(down, 0.0)), np.inf)
    ends = slant > floor
    slant[ends] = np.where(down >= grazing, floor, np.inf)[ends]
    return slant.astype(np.float32)


def measured(
    exact: NDArray[np.float32], scan: ScanFigures, noise: LidarNoise, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Exact ranges [m] of any shape as the sensor reports them, float32: noise that grows with the range, dropouts,
    limits.

    ``inf`` is where nothing is within reach, ``nan`` where an echo is of no use. Two numbers a range are drawn from
    ``rng``; three with outliers.
    """
    hit = np.isfinite(exact)
    useless = np.isnan(exact)
    spread = noise.range_noise + noise.range_noise_per_metre * np.where(hit, exact, 0)
    if noise.outliers > 0:
        strays = rng.random(exact.shape, np.float32) < noise.outliers
        spread = np.where(strays, np.hypot(spread, noise.outlier_noise), spread)
    ranges = np.where(hit, exact + spread * rng.standard_normal(exact.shape, np.float32), np.inf)
    if noise.resolution > 0:
        ranges = np.round(ranges / noise.resolution) * noise.resolution
    ranges[ranges > scan.range_max] = np.inf
    ranges[(ranges < scan.range_min) | (rng.random(exact.shape, np.float32) < noise.dropout)] = np.nan
    ranges[useless] = np.nan
    return ranges.astype(np.float32)


def _at(drive: Drive, times: Array, values: Array) -> Array:
    """The values [m, k] of a drive's stamps at other times [...], linear between them; stamps are evenly spaced."""
    step = drive.stamps[1] - drive.stamps[0]
    at = np.clip((times - drive.stamps[0]) / step, 0, len(drive.stamps) - 1)
    i = np.minimum(at.astype(np.int64), len(drive.stamps) - 2)
    share = (at - i)[..., None]
    return np.asarray(values[i] * (1 - share) + values[i + 1] * share)


SETTLES = 0.1  # Time in which the body follows an acceleration, and over which it shakes alike [s]


def tilt_of(drive: Drive, noise: DriveNoise, white: Array) -> Array:
    """Roll (to the right positive) and pitch (down positive) [n, 2] at the drive's stamps [rad].

    The body leans in bends, dips when it brakes, and shakes with its speed, as standard normal numbers [n, 2] say.
    """
    from scipy.signal import lfilter

    step = float(drive.stamps[1] - drive.stamps[0])
    keep = np.exp(-step / SETTLES)
    theta, (vx, vy) = drive.poses[:, 2], drive.velocities[:, :2].T
    ax, ay = (np.gradient(component, step) for component in (vx, vy))
    forward, left = np.cos(theta) * ax + np.sin(theta) * ay, np.cos(theta) * ay - np.sin(theta) * ax
    leans = noise.sway * np.stack((left, -forward), axis=1)
    leans = lfilter([1.0 - keep], [1.0, -keep], leans, axis=0)
    white = np.sqrt(1 - keep**2) * white
    shaken = noise.shake * np.hypot(vx, vy)[:, None] * lfilter([1.0], [1.0, -keep], white, axis=0)
    return np.asarray(leans + shaken, np.float64)


MAX_REACH = 2.0  # Of a sensor's mount from the robot's centre [m]


def check_sensors(platform: Platform) -> None:
    """Refuse sensors that are not known or far from the robot, and a sweep longer than a scan's interval."""
    for sensor, mount in (("lidar", platform.lidar), ("camera", platform.camera)):
        if mount is not None and (away := float(np.hypot(mount.x, mount.y))) > MAX_REACH:
            axis = "x" if abs(mount.x) >= abs(mount.y) else "y"
            raise ConfigError(
                f"{away:g} m from the robot's centre, expected at most {MAX_REACH:g} m",
                field=f"platform.{sensor}.{axis}",
            )
    if platform.encoders is None:
        raise ConfigError("none, expected wheels with encoders", field="platform.encoders")
    scan = platform.lidar.scan
    sweep = platform.lidar.time_increment * (scan.beams - 1)
    if sweep > 1 / scan.rate:
        raise ConfigError(
            f"{platform.lidar.time_increment:g} s: {scan.beams} beams take {sweep:g} s, expected at most the "
            f"{1 / scan.rate:g} s between two scans by rate",
            field="platform.lidar.time_increment",
        )
