"""A recording held against itself: what its lidar and its odometry are, as pairs of scans show it."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.recording import LidarStream, Recording
from moteslam.robot.values import expect_type
from moteslam.slam.calibration.hand_eye import CLOCKS, Fit, Pairs, Parameter, Path, clock, covariances, fit
from moteslam.slam.calibration.scan_pairs import Beams, refine, register
from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.inputs.odometry_path import OdometryPath, odometry_path
from moteslam.slam.inputs.synchronise import in_order, sweep_seconds

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

PAIRS = 300
"""Of a recording."""
MOTION, SHORTEST, LONGEST = (0.5, 0.4), 0.3, 2.0
"""A pair is about this far apart [m], or turned [rad], and apart from at least to at most this long [s]."""
FEWEST, GOOD = 40, 0.75
"""Fewer pairs, or a smaller share of them that are registered, say nothing."""
BEAMS = 360
"""Of a scan, about."""
TURNS = (0.0, -0.3, 0.3)
"""Turns that the registration of a pair begins with, one after the other [rad]."""
ROUNDS = 8
"""Of the scale of the angles, at most."""
OFFSET = 0.1
"""Prior standard deviation of a common offset of the ranges [m]; it would pass for a scale of the angles."""
ANGLE_FLOOR = 0.0015
"""The standard deviation of that scale is no smaller."""
AGREES, AGREES_LOGGED = 0.6, 0.35
"""Turns of scans and odometry that correlate less are not of the same motion: with clocks to be found, and without."""
BETTER, EVIDENCE = 0.4, 60.0
"""Odometry is read in another way where that costs less than this share, and over all pairs less by this much."""
UNFIT = 7.0
"""Odometry that costs more in every way does not measure the motion of the scans."""
SKEWED = 0.002
"""A share of endpoints that fits better, while the robot turns, with the beams in the other order in time: then that is
the right order. In a short sweep it makes no difference."""
TURNING = 0.05
"""Scans whose turns deviate by less show nothing of odometry [rad]."""
WITNESS = 5.0
"""With the stated angles the odometry must cost this much more over all pairs, unless it is wheels alone, whose turns
are poor: scans of one side of the robot are biased by a few percent."""
SIGMAS = 5.0
"""What differs from what is stated by less than this many standard deviations is not certain."""
LATE, LATE_WHEELS = 0.16, 0.25
"""Clocks that differ by less are taken for one [s]: wheels without a gyro turn before the robot does, by 0.1 s."""
DRIFT = 1e-3
"""Likewise [s/s]."""
MOVES = 0.05
"""The direction of a path is taken over this distance [m]."""
FORMS = ("stated", "turns", "y", "path")
"""How odometry poses are read: as stated, with their headings or their y negated, headings along the path."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """What scans show of their lidar and of the odometry.

    Attributes:
        angle_scale: angles between beams, over the stated; ``angle_deviation`` its standard deviation.
        mirrored: the beams, or the odometry, go the other way round.
        form: of `FORMS`, the one that odometry poses fit the scans in.
        fit: the mount and the rest; its clocks are one where they do not differ clearly.
        correlation: of the turns of scans and odometry.
        clocks: a fit with the difference of the clocks; None if the odometry is logged with the scans.
        shared_clock: the clocks do not differ clearly.
        reversed: mirrored beams are in the wrong order in time, too: an array that is to be read from its end.
        fits: the odometry measures the motion of the scans; else nothing but the angles is known.
    """

    angle_scale: float
    angle_deviation: float
    mirrored: bool
    form: str
    fit: Fit
    correlation: float
    clocks: Fit | None
    shared_clock: bool
    fits: bool
    reversed: bool


def calibrate(recording: Recording, *, pairs: int = PAIRS) -> Calibration | None:
    """Estimate what a recording shows of its sensors, from scans alone and from scans and odometry.

    Args:
        recording: any.
        pairs: of scans that are registered: the more, the longer it takes, and the smaller the deviations.

    Returns:
        None if too few scans can be registered, the robot hardly turns, or there is no odometry.
    """
    expect_type(recording, Recording, "recording", "open_recording(path) reads one")
    lidar = recording.lidar
    if lidar is None or len(lidar) < FEWEST or lidar.ranges.shape[1] < FEWEST or lidar.interlace > 1:
        return None
    try:
        with np.errstate(all="ignore"):
            return _calibrate(recording, in_order(lidar), pairs)
    except (InputError, np.linalg.LinAlgError):  # encoders without wheels; values that are not finite
        return None


def _calibrate(recording: Recording, lidar: LidarStream, pairs: int) -> Calibration | None:
    poses, logged = lidar.odometry, lidar.odometry is not None
    path = odometry_path(recording, SyncConfig()) if poses is None else OdometryPath(lidar.stamps, poses)
    if path is None:
        return None
    before, after = _pairs(lidar, path.at(lidar.stamps), pairs)
    if len(before) < FEWEST:
        return None
    scans = _RegisteredPairs(recording, lidar, before, after)
    if not scans.enough(GOOD / 2) or scans.pairs.motions[:, 2].std() < TURNING:
        return None
    read = _read(scans, path, logged=logged, poses=logged or recording.encoders is None)
    form, mirrored, correlation, (offset, drift) = read or ("stated", False, 0.0, (0.0, 0.0))
    at = _at(in_form(path, form))
    is_reversed = scans.mirror(lidar) if mirrored else False
    angle_scale, deviation = scans.scale_angles()
    best = fit(scans.pairs, at, (offset, drift), shared=logged)
    scans.refine(best.expected(scans.first, scans.last, at))
    if not scans.enough(GOOD):
        return None
    clocks = fit(scans.pairs, at, (offset, drift), shared=logged)
    wheels_alone = recording.encoders is not None and recording.imu is None and not logged
    if abs(angle_scale - 1) > SIGMAS * deviation and not wheels_alone:
        witness = scans.stated()
        as_stated = fit(witness.pairs, at, (offset, drift), shared=logged)
        if (as_stated.cost - clocks.cost) * len(scans.pairs.first) < WITNESS:
            scans, clocks, deviation = witness, as_stated, abs(angle_scale - 1)
    shared = logged or not clocks_differ(clocks, float(np.ptp(lidar.stamps)), wheels_alone=wheels_alone)
    start = clocks.values[Parameter.OFFSET] + clocks.values[Parameter.DRIFT] * (scans.first.min() - clocks.middle)
    began_as_one = abs(start) < (LATE_WHEELS if wheels_alone else LATE)
    if wheels_alone and began_as_one:  # the body follows its wheels late, and in turns aside, by about the same time
        clocks = fit(scans.pairs, at, (offset, drift), shared=False, slip=max(-start, 0.0))
    best = clocks._replace(values=clocks.values.copy())
    if shared and not logged and not wheels_alone:
        best = fit(scans.pairs, at, (0.0, 0.0), shared=True)
    if not shared and began_as_one:
        best.values[Parameter.OFFSET] -= start
    fits = read is not None and min(best.cost, clocks.cost) < UNFIT
    clocks_or_none = None if logged else clocks
    return Calibration(
        angle_scale, deviation, mirrored, form, best, correlation, clocks_or_none, shared, fits, is_reversed
    )


def clocks_differ(found: Fit, duration: float, *, wheels_alone: bool) -> bool:
    """Whether the stamps of scans and odometry clearly are of two clocks."""
    (offset, drift), (about_offset, about_drift) = found.values[CLOCKS], found.deviations[CLOCKS]
    late = abs(offset) > max(LATE_WHEELS if wheels_alone else LATE, SIGMAS * about_offset)
    apart = abs(drift) * duration > LATE and abs(drift) > max(DRIFT, SIGMAS * about_drift)
    return bool(late or apart)


def in_form(path: OdometryPath, form: str) -> OdometryPath:
    """A path read in one of the `FORMS`."""
    x, y, heading = path.poses.T
    if form == "turns":
        heading = -heading
    elif form == "y":
        y = -y
    elif form == "path":
        heading = _along(path.poses)
    return OdometryPath(path.stamps, np.stack((x, y, heading), axis=1))


def _at(path: OdometryPath) -> Path:
    """The poses at times, as ``path.at`` gives them, made for many calls."""
    columns = path.poses[:, 0], path.poses[:, 1], np.unwrap(path.poses[:, 2])
    return lambda times: np.stack([np.interp(times, path.stamps, column) for column in columns], axis=-1)


def _along(poses: Array) -> Array:
    """The direction of a path at its poses [n], unwrapped [rad]."""
    way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))))
    _, first = np.unique(np.floor(way / MOVES), return_index=True)
    if len(first) < 3:
        return np.zeros(len(poses))
    step = np.diff(poses[first, :2], axis=0)
    middle = (first[1:] + first[:-1]) / 2
    return np.interp(np.arange(len(poses)), middle, np.unwrap(np.arctan2(step[:, 1], step[:, 0])))


def _read(
    scans: _RegisteredPairs, path: OdometryPath, *, logged: bool, poses: bool
) -> tuple[str, bool, float, tuple[float, float]] | None:
    """In which form the odometry fits the scans, whether one of them is mirrored, the correlation, and the clocks."""
    best: tuple[str, bool, float, tuple[float, float]] | None = None
    least = np.inf
    for form in FORMS if poses else FORMS[:1]:
        read = in_form(path, form)
        headings = np.unwrap(read.poses[:, 2])
        offset, drift, correlation = clock(scans.pairs, read.stamps, headings, shared=logged)
        if abs(correlation) < (AGREES_LOGGED if logged else AGREES):
            continue
        pairs, mirrored = scans.pairs, correlation < 0
        if mirrored:
            pairs = pairs._replace(
                motions=pairs.motions * (1, -1, -1),
                covariances=pairs.covariances * np.outer((1, -1, -1), (1, -1, -1)),
            )
        cost = fit(pairs, _at(read), (offset, drift), shared=logged).cost
        if cost < BETTER * least and (least - cost) * len(pairs.first) > EVIDENCE:
            best, least = (form, mirrored, correlation, (offset, drift)), cost
    if best is not None and best[1] and best[0] in ("turns", "y"):  # one wrong sign in place of two
        best = ("y" if best[0] == "turns" else "turns", False, *best[2:])
    return best


class _RegisteredPairs:
    """Pairs of scans of a recording, registered.

    Attributes:
        first, last: [k] times of the scans, in the middle of their sweeps [s].
    """

    def __init__(self, recording: Recording, lidar: LidarStream, before: Indices, after: Indices) -> None:
        total, sweep = lidar.ranges.shape[1], sweep_seconds(recording, lidar)
        self.first, self.last = lidar.stamps[before] + sweep / 2, lidar.stamps[after] + sweep / 2
        self._seconds = self.last - self.first
        beams = np.arange(0, total, max(1, round(total / BEAMS)))
        self._beams = Beams(lidar.angles[beams], beams / max(total - 1, 1), sweep)
        scans = np.unique(np.concatenate((before, after)))
        ranges = np.asarray(lidar.ranges[scans], np.float64)[:, beams]
        ranges[~np.isfinite(ranges)] = np.nan
        self._ranges = ranges[np.searchsorted(scans, before)], ranges[np.searchsorted(scans, after)]
        self._found = register(*self._ranges, self._beams, self._seconds, TURNS)

    def enough(self, share: float) -> bool:
        """Whether enough pairs are registered, and this share of all."""
        return bool(self._found.good.sum() >= FEWEST and self._found.good.mean() >= share)

    @property
    def pairs(self) -> Pairs:
        """Those that are."""
        good = self._found.good
        about = covariances(self._found.information[good], self._found.deviation[good])
        return Pairs(self.first[good], self.last[good], self._found.motions[good], about)

    def stated(self) -> _RegisteredPairs:
        """The same with the angles as they were before ``scale_angles``."""
        assert self._found is not None
        other = copy(self)
        other._beams = self._stated
        other.refine(self._found.motions, anew=True)
        return other

    def refine(self, motions: Array, *, anew: bool = False) -> None:
        """Register from motions [k, 3] that are expected, and keep what fits better, unless it is done anew."""
        self._found = refine(*self._ranges, self._beams, self._seconds, motions, None if anew else self._found)

    def mirror(self, lidar: LidarStream) -> bool:
        """Take the beams the other way round; whether they are measured in the other order, too."""
        beams, motions = self._beams, self._found.motions * (1, -1, -1)
        turned = beams._replace(angles=-beams.angles)
        backwards = beams._replace(angles=lidar.angles[0] + lidar.angles[-1] - beams.angles, shares=1 - beams.shares)
        found = [(each, refine(*self._ranges, each, self._seconds, motions)) for each in (turned, backwards)]
        turning = np.abs(motions[:, 2]) > TURNING
        shares = [float(each.fit[turning].mean()) for _, each in found] if turning.any() else [0.0, 0.0]
        is_reversed = beams.sweep > 0 and shares[1] > shares[0] + SKEWED
        self._beams, self._found = found[int(is_reversed)]
        return is_reversed

    def scale_angles(self) -> tuple[float, float]:
        """The scale of the angles between beams at which the scans fit each other best, and its deviation.

        Gauss-Newton of what all pairs have in common, this scale and an offset of the ranges; a scale that differs
        between the sectors of the fan adds to the deviation, and the pairs are registered again after each step.
        """
        self._stated = self._beams
        scale, offset, deviation, stated = 1.0, 0.0, 1.0, self._beams.angles
        for _ in range(ROUNDS):
            good = self._found.good
            weight = 1 / np.maximum(self._found.deviation[good], 0.003) ** 2
            gradient = self._found.gradients[good] * weight[:, None]
            about = np.einsum("kvw,k->vw", self._found.about_warps[good], weight)
            about[0, 0] += 1 / OFFSET**2
            slope = gradient.sum(axis=0)
            slope[0] += offset / OFFSET**2
            both = np.zeros((len(about), 2))
            both[0, 0], both[1:, 1] = 1.0, 1.0
            inverse = np.linalg.inv(both.T @ about @ both + 1e-6 * np.eye(2))
            shift, step = np.clip(-inverse @ (slope @ both), -0.1, 0.1)
            parts = np.array([part.sum(axis=0) for part in np.array_split(gradient @ both, 25)])
            sectors = -np.linalg.solve(about + 1e-6 * np.eye(len(about)), slope)[1:]
            spread = np.sqrt((inverse @ (parts.T @ parts) @ inverse)[1, 1])
            deviation = float(np.linalg.norm((spread, sectors.std() / np.sqrt(len(sectors)), ANGLE_FLOOR)))
            scale, offset = scale * (1 + step), offset + shift
            if abs(step) < 0.002 and abs(shift) < 0.003:
                break
            self._beams = self._beams._replace(angles=stated[0] + scale * (stated - stated[0]))
            self._ranges = self._ranges[0] + shift, self._ranges[1] + shift
            self.refine(self._found.motions, anew=True)
        return float(scale), deviation


def _pairs(lidar: LidarStream, odometry: Array, count: int) -> tuple[Indices, Indices]:
    """Pairs of scans all over a recording: a third of them evenly by scans, by the way, and by turns of the odometry.

    Those by odometry begin a scan after the step that they are chosen by, or before: its noise is in none of them.
    """
    stamps, n = lidar.stamps, len(lidar)
    motion, seconds = np.abs(se2.between(odometry[:-1], odometry[1:])), np.diff(stamps)
    size = np.hypot(motion[:, 0], motion[:, 1]) / MOTION[0] + motion[:, 2] / MOTION[1]
    moving = size > 0.1 * np.percentile(size, 90)
    span, usual = LONGEST, 1.0
    if moving.any():
        usual = float(np.median(size[moving]))
        rate = float(np.median(size[moving] / np.maximum(seconds[moving], 1e-3)))
        span = min(max(1 / rate, SHORTEST), LONGEST)
    evenly = (np.arange(count // 3) + 0.5) / (count // 3)
    beside = np.where(np.arange(count // 3) % 2, 1, -1)
    begins = [evenly * (n - 1)]
    for step in (np.minimum(size, 5 * usual), np.minimum(motion[:, 2], np.pi / 4)):
        way = np.concatenate(([0.0], np.cumsum(step)))
        begins.append(np.interp(evenly * way[-1], way, np.arange(n)) + beside)
    first = np.unique(np.clip(np.concatenate(begins), 0, n - 1).astype(np.intp))
    last = np.maximum(np.searchsorted(stamps, stamps[first] + span), first + 1)
    first, last = first[last < n], last[last < n]
    apart = stamps[last] - stamps[first]
    use = (apart > 0) & (apart < 3 * max(span, float(np.median(seconds))))
    return first[use], last[use]
