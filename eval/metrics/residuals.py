"""Residuals of scans under a trajectory: how far endpoints are from what the scans nearby saw of the same surface."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from moteslam.errors import InputError
from moteslam.eval.metrics.association import Flags, Indices, evenly, placed_scans, travelled, tree_of
from moteslam.robot import se2
from moteslam.robot.recording import LidarStream, Recording, chunks, measured
from moteslam.robot.se2 import Array, Poses
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import Issue, Summarised, counted
from moteslam.slam.inputs.scans import Scans

PATH_REACH = 2.0
"""Scans less than this far apart along the path are compared [m]: little drift, much seen by both."""
SPACING = 0.25
"""Of the scans within each such length of path the first is used [m]; a turn by a radian counts as a metre."""
MAX_SCANS, MAX_NEIGHBOURS = 600, 8
"""At most so many scans, spread evenly over the path, are compared with at most so many others within reach each."""
REACH = 0.5
"""An endpoint has no residual against a scan whose nearest endpoint is farther away than this [m]."""
MAX_STRETCH = 4.0
"""A line joins adjacent endpoints up to this many times as far apart as their beams are at that range: a surface that
the beams meet at less than 75 degrees from its normal."""
MIN_JOINED, MAX_JOINED = 0.05, 1.0
"""Adjacent endpoints nearer than the first are joined whatever the range [m], as noise alone puts them so far apart; no
line is longer than the second [m]."""
FAR = 0.03  # The share of residuals beyond this distance [m] is reported
MEDIAN_OF_NOISE = 0.87  # The median residual, in standard deviations of the noise of both scans
UNFIT, UNFIT_NOISE, UNKNOWN_NOISE, GLANCED = 0.02, 1.6, 0.022, 40
"""Scans do not fit each other whose median residual is above the first [m] and so many times what their noise explains;
the third is that of a lidar that states none [m]: real logs have residuals of up to 0.023. So many scans show it."""
STRAIGHT, SHAKES, ALTERNATE = 0.02, np.deg2rad(1.0), -0.25
"""Where the odometry turns by less than the first from scan to scan [rad], headings of sound recordings shake by up to
0.13 degrees; a deviation above the second [rad], with steps that correlate by less than the third, is of the scans."""


@dataclass(frozen=True, eq=False, repr=False)
class ResidualResult(Summarised):
    """The residuals of a recording's scans under a trajectory.

    Attributes:
        median, quantile_90, beyond_3_cm: of the residuals [m], [m], and the share of those above 3 cm.
        unseen: share of the endpoints compared that have no residual against any other scan.
        no_return: share of all beams with a usable reading that met nothing (``inf``).
        residuals, endpoints, matched: how many there are, how many endpoints were compared, how many scans have a pose.
        stamps, medians: [n] of the scans compared [s], and their median residuals [m], NaN without any.
    """

    median: float
    quantile_90: float
    beyond_3_cm: float
    unseen: float
    no_return: float
    residuals: int
    endpoints: int
    matched: int
    stamps: Array
    medians: Array

    def as_dict(self) -> dict[str, Any]:
        """Fit for JSON: metres, and shares from 0 to 1."""
        found = {"median_m": self.median, "quantile_90_m": self.quantile_90}
        found |= {f"{name}_share": getattr(self, name) for name in ("beyond_3_cm", "unseen", "no_return")}
        counts = {"residuals": self.residuals, "endpoints": self.endpoints, "scans": len(self.stamps)}
        return {**found, **counts, "matched": self.matched}


def scan_residuals(recording: Recording, trajectory: Trajectory, *, scans: Scans | None = None) -> ResidualResult:
    """How noisy the scans of a recording are, and how well a trajectory on its clock lays them on each other.

    The scans used are the first within each ``SPACING`` of path or turn. Every second of them is compared with the
    others less than ``PATH_REACH`` of path away. A residual is the distance of an endpoint of the one scan to the lines
    of another: to the nearer of the two that end at the other scan's endpoint nearest to it, much as in point-to-line
    ICP (Censi 2008). Lines join the endpoints of adjacent beams that lie on one surface. There is no residual where the
    other scan did not see the place: its nearest endpoint is more than ``REACH`` away, or on no line, or the last of a
    surface with the foot beyond it. Noise of standard deviation s across a surface gives a median of about 0.87 s.

    Which poses are taken: ``placed_scans``. ``scans`` are the recording's as ``synchronise(recording)`` gives them.
    """
    lidar, index, poses, scans = placed_scans(recording, trajectory, scans)
    compared, residuals, endpoints, unseen = _compared(lidar, index, poses, scans, MAX_SCANS)
    everything = np.concatenate(residuals)
    no_return = sum(int(np.isinf(scans).sum()) for scans in chunks(lidar.ranges))
    beams = sum(int(measured(scans, lidar.interlace).sum()) for scans in chunks(lidar.ranges))
    median, most, beyond = np.median(everything), np.quantile(everything, 0.9), np.mean(everything > FAR)
    shares = float(median), float(most), float(beyond), unseen / endpoints, no_return / beams
    medians = np.array([np.median(some) if len(some) else np.nan for some in residuals])
    counts = len(everything), endpoints, len(index)
    return ResidualResult(*shares, *counts, lidar.stamps[index[compared]], medians)


def unfit_scans(recording: Recording, trajectory: Trajectory, odometry: Trajectory) -> tuple[Issue, ...]:
    """That scans do not fit each other under their trajectory, by far more than the noise that the robot's file states,
    or that its headings shake, as they do not by the odometry at the same stamps.

    What bends each scan in itself, or turns it, hides from their registration: an eccentric disc, a filter over time, a
    driver whose scans begin at another angle each.
    """
    issues = [*_shaking(trajectory, odometry)]
    try:
        lidar, index, poses, scans = placed_scans(recording, trajectory)
        compared, residuals, *_ = _compared(lidar, index, poses, scans, GLANCED)
    except InputError:  # nothing to compare
        return tuple(issues)
    stated, ranges = recording.platform.noise.lidar, [lidar.ranges[k : k + 1] for k in index[compared].tolist()]
    far = float(np.median((seen := np.concatenate(ranges))[np.isfinite(seen)]))
    noise = MEDIAN_OF_NOISE * (stated.range_noise + far * stated.range_noise_per_metre or UNKNOWN_NOISE)
    median = float(np.median(np.concatenate(residuals)))
    if median > max(UNFIT, UNFIT_NOISE * noise):
        text = f"scans lie {100 * median:.1f} cm (median) off those next to them, of which noise explains "
        text += f"{100 * noise:.1f}: their angles, ranges or stamps vary, or a driver filters them; path and map are "
        issues.append(Issue("scans-unfit", f"{text}off by such lengths at least", len(compared)))
    return tuple(issues)


def _shaking(trajectory: Trajectory, odometry: Trajectory) -> Iterator[Issue]:
    """That headings go to and fro from scan to scan, by the covariance of one step's error with the next one's."""
    turned = se2.wrap(np.diff(odometry.poses[:, 2]))
    off = se2.wrap(np.diff(trajectory.poses[:, 2]) - turned)
    straight = np.abs(turned) < STRAIGHT
    before, after = (steps[straight[1:] & straight[:-1]] for steps in (off[:-1], off[1:]))
    both, own = float(before @ after), float(before @ before + after @ after) / 2
    shaking = float(np.sqrt(max(-both, 0.0) / max(len(before), 1)))
    if len(before) >= GLANCED and shaking > SHAKES and both < ALTERNATE * own:
        text = f"headings shake by {np.rad2deg(shaking):.1f} degrees from scan to scan where the odometry goes straight"
        text += ": the angle at which scans begin seems to vary, and headings and relative errors are wrong by it"
        yield Issue("scans-unfit", text, len(before))


def _compared(
    lidar: LidarStream, index: Indices, poses: Poses, scans: Scans, most: int
) -> tuple[list[int], list[Array], int, int]:
    """The scans that are compared, at most so many, the residuals of each, how many endpoints, and those unseen."""
    path, turned = travelled(poses)
    used = np.unique(np.floor((path + turned) / SPACING), return_index=True)[1]
    if len(used) < 2:
        driven = f"{path[-1]:.2f} m driven and {np.rad2deg(turned[-1]):.0f} deg turned"
        expected = f"expected at least {SPACING:g} m or {np.rad2deg(SPACING):.0f} deg"
        raise InputError(f"{driven} over {counted(len(index), 'scan')}, {expected}", field="trajectory")

    @lru_cache(maxsize=64)  # those within reach of a scan and of the next
    def lines(scan: int) -> _Lines:
        return _Lines(scans, lidar, int(index[scan]), poses[scan])

    compared, residuals, endpoints, unseen = [], [], 0, 0
    for place in evenly(np.arange(0, len(used), 2), most):
        first = np.searchsorted(path[used], path[used[place]] - PATH_REACH, side="right")
        last = np.searchsorted(path[used], path[used[place]] + PATH_REACH, side="left")
        scan, others = used[place], evenly(np.concatenate((used[first:place], used[place + 1 : last])), MAX_NEIGHBOURS)
        points = lines(scan).points
        distances = [lines(other).distances(points) for other in others] or [np.full(len(points), np.inf)]
        found = np.isfinite(distances)
        endpoints += len(points)
        unseen += int(np.count_nonzero(~found.any(axis=0)))
        residuals.append(np.array(distances)[found])
        compared.append(scan)
    if not any(map(len, residuals)):
        expected = f"expected scans less than {PATH_REACH:g} m of path apart that see the same surfaces"
        problem = f"no endpoint lies near the lines of another scan, {expected}, and their own trajectory"
        raise InputError(problem, field="trajectory")
    return compared, residuals, endpoints, unseen


def surface_points(
    scans: Scans, lidar: LidarStream, index: int, pose: Poses, *, longest: float = np.inf
) -> tuple[Array, Flags]:
    """The endpoints [k, 2] of a scan taken at a pose [3], and which adjacent ones [k - 1] lie on one surface.

    Those at most ``MAX_STRETCH`` times as far apart as their beams are there, or ``MIN_JOINED``, and never farther than
    ``longest`` [m].
    """
    ranges = scans.ranges(index).astype(np.float64)
    beams = np.flatnonzero(np.isfinite(ranges))
    ranges = ranges[beams]
    points = se2.transform_points(pose, scans.points(index))
    apart = np.minimum(ranges[:-1], ranges[1:]) * abs(lidar.angle_increment) * lidar.interlace
    reach = np.clip(MAX_STRETCH * apart, MIN_JOINED, longest)
    joined = (np.diff(beams) == lidar.interlace) & (np.hypot(*np.diff(points, axis=0).T) <= reach)
    return points, np.asarray(joined)


class _Lines:
    """The endpoints of a scan, its index in the recording, taken at a pose [3], and the lines that join adjacent ones.

    Attributes:
        points: [k, 2] the endpoints in the frame of the trajectory [m].
        along: [2, k, 2] from each along its line to the next one and to the one before [m]; zeros where there is none.
        inner: [k] whether an endpoint has both lines.
    """

    def __init__(self, scans: Scans, lidar: LidarStream, index: int, pose: Poses) -> None:
        self.points, joined = surface_points(scans, lidar, index, pose, longest=MAX_JOINED)
        steps, none = np.diff(self.points, axis=0) * joined[:, None], np.zeros((1, 2))
        self.along = np.stack((np.vstack((steps, none)), np.vstack((none, -steps))))
        self.inner = np.append(joined, False) & np.append(False, joined)
        self._tree = tree_of(self.points)

    def distances(self, points: Array) -> Array:
        """The residuals [n] of points [n, 2] against these lines [m]; infinite where there is none."""
        distances = np.full(len(points), np.inf)
        found = np.asarray(self._tree.query(points, distance_upper_bound=REACH)[1])
        near = np.flatnonzero(found < len(self.points))
        nearest = found[near]
        offsets = points[near] - self.points[nearest]
        along = self.along[:, nearest]
        squares = np.maximum((along**2).sum(axis=-1), np.finfo(float).tiny)
        feet = np.clip((along * offsets).sum(axis=-1) / squares, 0.0, 1.0)  # as shares of the line
        missed = offsets - feet[..., None] * along
        beside = self.inner[nearest] | (feet > 0).any(axis=0)
        distances[near[beside]] = np.hypot(missed[..., 0], missed[..., 1]).min(axis=0)[beside]
        return distances
