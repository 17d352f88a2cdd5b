"""From streams with their own clocks to what SLAM takes in: scans, and the motion between them, settled once.

And where the robot would think it is by its odometry alone: what SLAM has to beat.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.platform import Platform
from moteslam.robot.recording import LATEST, STREAMS, LidarStream, Recording, chosen, chunks, gaps, nearest_stamp
from moteslam.robot.se2 import Array
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import Issue, expect_type, when
from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.inputs.inputs import Inputs
from moteslam.slam.inputs.odometry_path import OdometryPath, jumps, odometry_path
from moteslam.slam.inputs.scans import Scans

COARSE = 0.5
"""Where more than this share of the readings have the stamp of the one before, the clock is too coarse for them."""
JITTERS, OPPOSITE = 0.03, -0.15
"""Stamps that deviate by the first [s] from even steps are told, where a step and the next correlate by less than the
second: of stamps that are right and uneven they do not."""
FASTEST, CROWDED = 0.01, 0.1
"""Scans less than the first [s] apart, which no lidar takes, and than the second share of their mean time, come in
bundles."""
UNMAPPED, BESIDE = 1.0, 0.1
"""A robot that drives farther [m] and longer [s] before its first scan or after its last has a part without a map."""
ALIKE = 0.1  # Jumps whose sizes differ by less than this share are of one cause
FEWEST = 10  # Fewer steps or bundles say nothing of a clock
SAME = 1e-5  # Poses that differ by less are one: logs have six digits
APART = 1.0  # Scans and odometry whose times are this far apart [s] are of different recordings, or on different clocks


def synchronise(recording: Recording, config: SyncConfig | None = None, *, max_range: float = np.inf) -> Inputs:
    """Bring the streams of a recording onto the stamps of its scans: they are taken in at once.

    Odometry of any kind is optional. Endpoints beyond ``max_range`` are left out [m]. Refused are no scans, encoders
    without wheels, and odometry that does not overlap with the scans in time.
    """
    config = config or SyncConfig()
    lidar, path, platform = require_lidar(recording), odometry_path(recording, config), recording.platform
    odometry, logged = np.zeros((len(lidar), 3)), None
    if path is not None:
        if lidar.odometry is None and (text := apart(lidar.stamps, path.stamps[0], path.stamps[-1])):
            raise InputError(text, file=recording.name, field="time_stamps")
        if lidar.odometry is not None and lidar.sequence is not None:
            odometry = lidar.odometry  # by its stamp a scan may lie in a gap that it was not taken in
        else:
            odometry = at_scans(lidar.stamps, lidar.odometry, path, config)
    if lidar.sequence is not None:
        taken = np.argsort(lidar.sequence, kind="stable")
        logged, odometry, lidar = lidar.stamps[taken], odometry[taken], in_order(lidar)
    lapsing, absent = logged is None and not is_coarse(lidar.stamps), np.zeros(len(lidar), np.bool_)
    if path is not None and lapsing and lidar.odometry is None:
        absent = _without(recording, path)
    counted = recording.encoders is not None and len(recording.encoders) > 0
    inputs = Inputs(platform, config, lidar)
    inputs.logged = logged
    inputs.take(lidar, odometry, path, absent=absent, counted=counted, lapsing=lapsing)
    seconds, swept = sweep_seconds(recording, lidar), None
    if config.deskew and seconds > 0 and path is not None:
        swept = sweeps(path, lidar.stamps, seconds, config)
    inputs.scans = Scans(lidar, platform.lidar, sweeps=swept, max_range=max_range, follower=inputs.follower)
    return inputs


def require_lidar(recording: Recording) -> LidarStream:
    """The recording's lidar stream; ``InputError`` if it has none, or one without scans."""
    if recording.lidar is None or not len(recording.lidar):
        raise InputError("no lidar scans, expected at least one", file=recording.name, field="lidar")
    return recording.lidar


def in_order(lidar: LidarStream) -> LidarStream:
    """The scans in the order in which they were taken, their stamps not falling."""
    if lidar.sequence is None:
        return lidar
    order = np.argsort(lidar.sequence, kind="stable")
    return replace(
        lidar,
        stamps=np.maximum.accumulate(lidar.stamps[order]),
        ranges=chosen(lidar.ranges, order),
        odometry=None if lidar.odometry is None else lidar.odometry[order],
        sequence=None,
    )


def _without(recording: Recording, path: OdometryPath) -> NDArray[np.bool_]:
    """Which scans [n] come after the last reading of the odometry or, of wheels, before the first, by a gap.

    Before poses move, the scans say whether the robot stands.
    """
    stamps = require_lidar(recording).stamps
    late = (stamps > path.stamps[-1]) & gaps(np.append(path.stamps, stamps[-1]))[-1]
    if recording.encoders is None:
        return np.asarray(late)
    return np.asarray(late | ((stamps < path.stamps[0]) & gaps(np.append(-path.stamps[LATEST::-1], -stamps[0]))[-1]))


def apart(scans: Array, begin: float, end: float) -> str:
    """That odometry from a stamp to another is of another time than scans at stamps [n] [s]; empty if it is not."""
    if scans[-1] >= begin - APART and scans[0] <= end + APART:
        return ""
    off, side = abs(begin - scans[0]), "after" if begin > scans[0] else "before"
    text = f"scans from {scans[0]:.3f} to {scans[-1]:.3f} s, odometry from {begin:.3f} to {end:.3f} s, {off:.0f} s "
    return f"{text}{side} them, expected streams that overlap in time"


def at_scans(stamps: Array, logged: Array | None, path: OdometryPath, config: SyncConfig) -> Array:
    """The odometry's pose [n, 3] at scans: that logged with them [n, 3] where there is one, unless it is stale.

    That is in a gap of the odometry, between readings that are much farther apart than usual, where it is the pose of
    the reading before.
    """
    if logged is not None:
        readings = path.stamps
        gap = np.append(gaps(readings, stamps[0]), False)  # before each reading, and after the last
        following = np.searchsorted(readings, stamps, side="left")
        held = np.abs(logged - path.poses[np.maximum(following - 1, 0)]).max(axis=1) < SAME
        held &= gap[following] & ~np.isin(stamps, readings)
        return np.where(held[:, None], path.at(stamps), logged) if held.any() else logged
    if config.method == "interpolate":
        return path.at(stamps)
    return path.poses[nearest_stamp(path.stamps, stamps)]


def sweep_seconds(recording: Recording, lidar: LidarStream) -> float:
    """How long a scan takes, from the first beam to the last [s]; 0 where that is not known."""
    beams: int = lidar.ranges.shape[1]
    return (lidar.time_increment or recording.platform.lidar.time_increment) * (beams - 1)


def sweeps(path: OdometryPath, stamps: Array, seconds: float, config: SyncConfig) -> Array:
    """How the robot moves while scans at stamps [n] are taken, for so long [s], [n, 3] in its frame at the first beam.

    Zeros where the odometry jumps between the reading before the sweep and the one after, and so did not measure it.
    In a sweep that odometry does not cover, by up to another sweep, the robot moves as nearest to it.
    """
    ends = stamps + seconds
    beyond = np.maximum(ends - path.stamps[-1], 0.0) - np.maximum(path.stamps[0] - stamps, 0.0)
    beyond[np.abs(beyond) > 2 * seconds] = 0.0
    poses = path.at(np.concatenate((stamps - beyond, ends - beyond)))
    motion = se2.between(poses[: len(stamps)], poses[len(stamps) :])
    leaps = jumps(path.stamps, path.poses, config, stamps[0])
    if leaps.any():
        count = np.concatenate(([0], np.cumsum(leaps)))  # before each reading
        first = np.searchsorted(path.stamps, stamps, side="right")
        last = np.minimum(np.searchsorted(path.stamps, ends, side="left"), len(path.stamps) - 1)
        motion[count[last + 1] > count[first]] = 0.0
    return np.asarray(motion)


MANY_BEAMS, NARROW = 20, 10.0
"""As many beams of a planar lidar do not lie within so many degrees."""
OPPOSED, TURNS = -0.5, 0.3
"""Turns whose correlation is below the first are opposite: of one robot it is 1, of wheels that slip 0; turns that are
less than the second, each second's squared [rad], say nothing."""
FULL, MANY_FULL = (127, 128, 255, 32767, 32768, 65535), 10
"""The largest numbers of one and two bytes; more readings of them are no chance."""
GYRO_MARGIN = 3.0
"""Encoder readings this far outside the gyro's time count as covered [s]: a real robot's encoders run on for 1.5 s."""


def warnings(
    recording: Recording, inputs: Inputs, *, path: OdometryPath | None = None, read_ranges: bool = True
) -> tuple[Issue, ...]:
    """What SLAM has to do without, or takes as something else; blind scans only where all ranges may be read.

    ``path``: by odometry, of inputs that forget it.
    """
    lidar, encoders, imu = require_lidar(recording), recording.encoders, recording.imu
    n, told, own, path = len(lidar), [], inputs.issues, path or inputs.path
    parts, limit = chunks(lidar.ranges) if read_ranges else (), np.float32(lidar.range_max)
    blind = beyond = 0
    for some in parts:
        ends = np.isfinite(some)
        blind += int((none := ~ends.any(axis=1)).sum())
        beyond += int((~(none | (ends & (some <= limit)).any(axis=1))).sum())
    text = f"{beyond} of {n} scans with all ranges beyond their limit of {lidar.range_max:g} m: are they in m?"
    told.append(("blind-scans", beyond, text))
    told.append(("blind-scans", blind, about_blind(blind, n, lidar)))
    beams = lidar.ranges.shape[1]
    wide = np.degrees((beams - 1) * abs(lidar.angle_increment))
    text = f"lidar: all {beams} beams lie within {wide:.3g} degrees: are angles in radians taken for degrees?"
    told.append(("lidar-angles", int(beams >= MANY_BEAMS and wide < NARROW), text))
    if encoders is not None and len(encoders):
        without, text = len(encoders), "no gyro: turns from the wheels alone"
        if imu is not None and len(imu) > 1:
            early, late = imu.stamps[0] - GYRO_MARGIN, imu.stamps[-1] + GYRO_MARGIN
            without = int(((encoders.stamps <= early) | (encoders.stamps >= late)).sum())
            text = f"{without} of {len(encoders)} encoder readings without a gyro: turns from the wheels alone there"
        told.append(("no-gyro", without, text))
        most = int((sizes := np.abs(encoders.counts)).max(initial=0))
        full = int((sizes == most).any(axis=1).sum()) if most in FULL else 0
        text = f"{full} of {len(encoders)} encoder readings are {most} and none is more: what does not fit into their "
        text += "bytes was cut off, and lengths and turns by the wheels are too small"
        told.append(("counters-wrap", full if full > MANY_FULL else 0, text))
    if path is not None and path.by_wheels is not None and _opposed(path.stamps, path.poses, path.by_wheels):
        text = "encoders: the wheels turn the other way than the gyro: left and right are exchanged, or its z is down. "
        told.append(("odometry-unfit", 1, text + "Turns are the gyro's, and wrong where it has none"))
    if path is None:
        text = f"no odometry: constant velocity over {n} scans; dead reckoning stands still"
        told.append(("no-odometry", n, text))
    elif lidar.odometry is None and (count := int(_without(recording, path).sum())):
        text = f"{count} of {n} scans before or after all odometry: constant velocity there, dead reckoning stands "
        told.append(("no-odometry", count, f"{text}still"))
    codes = {issue.code for issue in own}
    issues = (Issue(code, text, count) for code, count, text in told if count and code not in codes)
    return (*unknown_mount(recording.platform), *doubtful_stamps(recording, path), *issues, *own)


def _opposed(stamps: Array, *paths: Array) -> bool:
    """Whether two paths [n, 3] turn opposite ways, by their headings each second."""
    seconds = np.arange(stamps[0], stamps[-1], 1.0)
    one, other = (np.diff(np.interp(seconds, stamps, np.unwrap(path[:, 2]))) for path in paths)
    sizes = float(np.linalg.norm(one)), float(np.linalg.norm(other))
    return len(seconds) > FEWEST and min(sizes) > TURNS and float(one @ other) < OPPOSED * sizes[0] * sizes[1]


def about_blind(blind: int, scans: int, lidar: LidarStream) -> str:
    """That so many of the scans show nothing."""
    text = f"{blind} of {scans} scans without an endpoint: odometry alone there"
    limits = f"{lidar.range_min:g} and {lidar.range_max:g} m"
    return text + f": are its ranges in m, and do its limits of {limits} hold?" * (blind > scans / 2)


def unknown_mount(platform: Platform) -> tuple[Issue, ...]:
    """Whether nothing says where the lidar stands on the robot."""
    if {"x", "y", "yaw"} & platform.lidar.model_fields_set:
        return ()
    text = "lidar: where it stands on the robot is not known: taken to be at its centre, facing ahead"
    return (Issue("no-mount", text),)


def is_coarse(stamps: Array) -> bool:
    """Whether stamps [n] are of a clock too coarse for their readings."""
    return bool((np.diff(stamps) == 0).sum() > COARSE * len(stamps))


def jitter(stamps: Array) -> float:
    """The standard deviation of stamps [n] about even ones [s], by steps that make up for the one before."""
    steps = np.diff(stamps)
    steps = np.minimum(steps, 5 * np.median(steps))  # gaps are no jitter
    steps -= steps.mean()
    both, own = float(steps[1:] @ steps[:-1]), float(steps @ steps)
    return float(np.sqrt(-both / len(steps))) if both < OPPOSITE * own else 0.0


class WrongStamps(NamedTuple):
    """Stamps that are certainly wrong: the code and the text of that, and what makes a recording with right ones."""

    told: tuple[str, str]
    undone: Callable[[Recording], Recording]


def bundles(lidar: LidarStream) -> WrongStamps | None:
    """Of scans without odometry of their own that are stamped as they arrive, so many at a time.

    Undone they are spread over the time since those before.
    """
    stamps, steps = lidar.stamps, np.diff(lidar.stamps)
    if len(steps) < FEWEST or np.median(steps) > FASTEST or lidar.odometry is not None or is_coarse(stamps):
        return None
    usual = float(np.minimum(steps, np.percentile(steps, 98)).mean())  # without pauses
    ends = np.flatnonzero(np.append(steps > CROWDED * usual, True))
    if (steps < CROWDED * usual).mean() < COARSE or len(ends) < FEWEST:
        return None
    sizes = np.diff(ends, prepend=-1)
    each = np.diff(stamps[ends], prepend=-np.inf) / sizes
    each = np.minimum(each, np.median(each))
    back = np.repeat(ends, sizes) - np.arange(len(stamps))
    spread = np.repeat(stamps[ends], sizes) - back * np.repeat(each, sizes)
    text = f"lidar: scans are stamped as they arrive, in bundles of about {int(np.median(sizes))}, not as they are "
    told = "stamps-jitter", f"{text}taken: what is driven meanwhile is missing from motions"
    return WrongStamps(told, lambda whole: whole.replace(lidar=replace(require_lidar(whole), stamps=spread)))


def doubtful_stamps(recording: Recording, path: OdometryPath | None) -> list[Issue]:
    """Clocks that are too coarse for their readings, and ways that are driven without scans, by a path."""
    issues, lidar = list[Issue](), require_lidar(recording)
    scans, logged = lidar.stamps, lidar.odometry is not None  # the motion then does not depend on stamps
    if (found := bundles(lidar)) is not None:
        issues.append(Issue(*found.told))
    for name, stamps in recording.stamps().items():
        if name in STREAMS[:4] and is_coarse(stamps):
            equal = int((np.diff(stamps) == 0).sum())
            text = f"{name}: {equal} of {len(stamps)} readings share the stamp of the one before: their clock "
            whole = "counts whole seconds" if np.ptp(stamps) else f"stands at {stamps[0]:g} s, as without stamps"
            text += whole if (stamps == np.rint(stamps)).all() else "is too coarse"
            issues.append(Issue("equal-stamps", f"{text}, so that speeds and turns by it are wrong", equal))
        elif name in STREAMS[:4] and len(stamps) > 200 and not logged and (noise := jitter(stamps)) > JITTERS:
            text = f"{name}: stamps jitter by {noise:.2f} s: what is driven meanwhile is missing from motions, "
            issues.append(Issue("stamps-jitter", f"{text}and from the poses at these stamps"))
    if path is None:
        return issues
    stamps, driven = path.stamps[1:], np.hypot(*np.diff(path.poses[:, :2], axis=0).T)
    for code, seconds, outside, where in (
        ("begins-late", scans[0] - path.stamps[0], stamps < scans[0], "before the first"),
        ("ends-early", path.stamps[-1] - scans[-1], stamps > scans[-1], "after the last"),
    ):
        if (way := float(driven[outside].sum())) > UNMAPPED and seconds > BESIDE:
            text = f"lidar: {seconds:.1f} s and {way:.1f} m are driven {where} scan: path and map have nothing of them"
            issues.append(Issue(code, text))
    return issues


def about_jumps(stamps: Array, odometry: Array, jumped: NDArray[np.bool_]) -> tuple[Issue, ...]:
    """Where the odometry [n, 3] jumps [n] among scans at stamps [n] [s], and a filter does without it."""
    at = np.flatnonzero(jumped).tolist()
    if not at:
        return ()
    spans = [(float(stamps[scan - 1]), float(stamps[scan])) for scan in at]
    text = f"odometry jumps at {len(at)} of {len(stamps)} scans: constant velocity there; {when(spans)}"
    sizes = np.abs(np.diff(odometry[:, :2], axis=0))[np.array(at) - 1].max(axis=1)
    if len(at) > 1 and np.ptp(sizes) < ALIKE * sizes.min():
        text += f". Each is by {np.median(sizes):.4g} m along x or y, as of a counter that is full and begins again"
    return (Issue("odometry-jumps", text, len(at)),)


def dead_reckon(recording: Recording, config: SyncConfig | None = None) -> Trajectory:
    """The trajectory of dead reckoning, starting at the identity (figures 5 and 6 of the paper).

    At every scan, or at every odometry reading where there are no scans. Refused is a recording without any odometry,
    or whose streams do not overlap in time.
    """
    expect_type(recording, Recording, "recording", "open_recording(path) reads one")
    config = config or SyncConfig()
    if (path := odometry_path(recording, config)) is None:
        raise InputError("neither encoders nor odometry, expected one of them", file=recording.name)
    if recording.lidar is not None and len(recording.lidar):
        inputs = synchronise(recording, config)
        return Trajectory(inputs.stamps, se2.between(inputs.odometry[0], inputs.odometry))
    return Trajectory(path.stamps, se2.between(path.poses[0], path.poses))
