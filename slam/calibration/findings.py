"""What is certain of a calibration: what it says, and the lines of a platform that mend it."""

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, replace
from itertools import product
from math import degrees, floor
from typing import Any

import numpy as np

from moteslam.robot import se2
from moteslam.robot.inspection import gyro_at_rest
from moteslam.robot.recording import ChunkedRanges, LidarStream, Ranges, Recording
from moteslam.robot.values import Issue, expect_type
from moteslam.slam.calibration.calibrate import ANGLES, LATE, SIGMAS, Calibration
from moteslam.slam.calibration.hand_eye import CLOCKS, MOUNT, Parameter
from moteslam.slam.calibration.readings import about_form
from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.inputs.synchronise import require_lidar, sweep_seconds

PLACE, YAW = 0.07, 0.06
"""Smaller differences move no result by a tenth of a metre: of the mount [m], [rad],"""
EXCESS = 0.07
"""of ranges that are all too long or too short by as much [m],"""
SCALE, LENGTHS_SIGMAS = 0.03, 4.0
"""and of ranges over the odometry's lengths: sound simulated drives show at most 0.018, of 2.5 deviations."""
TURNS = 0.15
"""Likewise of turns by scans over the odometry's."""
TURNED_SIGMAS = 4.0  # A lidar is turned in mid drive by as many deviations: sound drives and logs have 1.2
CHANGE, CHANGE_SIGMAS = 0.03, 6.0
"""Lengths over the odometry's change by less in mid drive where wheels slip a little, or with so few deviations."""
TWICE = 0.4
"""Readings of wheels may be given twice where a larger share of them has the stamp of the one before."""
CURL = 0.1
"""Odometry that turns by more over a metre than the scans draws a circle of 60 m: the worst of sound ones has 0.08
[rad/m]."""
BIASED = 0.01
"""Gyros turn by less while a robot stands, those of cheap sensors by half of it [rad/s]; one that is carried turns
unevenly."""
ENDS = 10
"""A gyro saturates whose largest rate comes more often, to the last bit."""
NEAR_SWEEP = 0.02
"""A lag of the scans is that of a sweep where it is as near [s], besides its interval: drivers take so long."""
WITHIN = 1.96
"""Standard deviations to either side of a value that it lies within, in 95 of 100 cases."""


@dataclass(frozen=True)
class Figure:
    """One estimate beside what is stated."""

    name: str  # with the unit
    value: float  # of the estimate
    deviation: float  # likewise
    stated: float  # by the recording and its platform
    certain: bool  # that it differs, by enough to matter

    @property
    def differs(self) -> bool:
        """Whether it does clearly, be it by too little to matter."""
        return abs(self.value - self.stated) > SIGMAS * self.deviation


@dataclass(frozen=True)
class Findings:
    """What is estimated of a recording, and what of it is certain."""

    figures: tuple[Figure, ...]  # all estimates
    issues: tuple[Issue, ...]  # what is certain
    moves: tuple[Issue, ...]  # those that move the result of SLAM by more than a tenth of a metre
    decided: frozenset[str]  # codes of those of which it is known which side is wrong: ``mended.calibrated`` mends them


def findings(calibration: Calibration, recording: Recording) -> Findings:
    """What a calibration says of the recording that it was made of."""
    expect_type(calibration, Calibration, "calibration", "calibrate(recording) gives one, if the robot turns enough")
    lidar, mount, c = require_lidar(recording), recording.platform.lidar, calibration
    told: list[tuple[str, str]] = []  # code, text
    figures = figures_of(c, recording)
    certain = {figure.name.split(" ")[0]: figure for figure in figures if figure.certain}
    right = lidar_of(lidar, c, certain)
    if not c.correlation:
        text = "odometry: it turns at no offset of its clock as the scans do: left out"
        told.append(("odometry-unfit", text))
    elif not c.fits and c.fit.stands:
        text = "lidar: by its scans it turns as the odometry does, but does not move: it sees the floor, or the robot"
        told.append(("lidar-tilted", text))
    elif not c.fits and not c.uneven:
        text = f"odometry: it turns as the scans do (correlation {c.correlation:.2f}), but the motions do not fit: "
        text += "stamps of either are rounded or out of order, its lengths or turns are in other units, or wheels slip"
        told.append(("odometry-unfit", text))
    x, y, yaw = mount_of(c, recording, certain)
    toml = f"angle_min = {right.angle_min:.6g}, angle_increment = {right.angle_increment:.6g}, yaw = {yaw:.4f}"
    if c.fits and (wrong := about_form(c.form, c.heading_offset)) is not None:
        told.append(wrong)
    if c.mirrored and c.fits:
        told.append(("mirrored", _mirrored(c, toml)))
    if (angles := certain.get("angles")) is not None:
        text = f"lidar: angles between beams are {_percent(angles)} stated: walls come out bent, turns wrong. "
        told.append(("lidar-angles", f"{text}In platform.toml: [lidar] {toml}"))
    if (excess := certain.get("excess")) is not None:
        by, side = _interval(abs(excess.value), excess.deviation), "long" if excess.value > 0 else "short"
        text = f"lidar: all ranges are {abs(excess.value):.2f} m ({by}) too {side}, by scans from other places: "
        told.append(("range-offset", f"{text}subtract {excess.value:.3f} m from them"))
    if c.no_surfaces is not None and c.no_surfaces < 0:
        text = f"lidar: most endpoints on a line {-c.no_surfaces:.1f} m before it are no walls: from nearer it sees "
        text += "on. It is tilted, and sees the floor: walls there stand in the map, and poses may be "
        told.append(("lidar-tilted", f"{text}wrong by them. Mount it level"))
    elif c.no_surfaces is not None:
        limit = floor(100 * c.no_surfaces) / 100
        text = f"lidar: most endpoints from {limit:g} m on are no walls, but no return written as a range: from nearer "
        text += "it sees through them, and the map has walls that are not there. In platform.toml: [lidar] "
        told.append(("range-max", f"{text}range_max = {limit:g}"))
    turned, (curl, about_curl) = c.fit.turned, c.fit.curl
    moved = c.fits and turned.exceeds(YAW, TURNED_SIGMAS)
    if c.sweep is not None and c.sweep < 0:
        text = "lidar: by its scans beams are not measured in their order, but the last ones before the first: the fan "
        text += (
            "is turned round, has a part of the turn before, or a time_increment of the wrong sign: turns are smeared"
        )
        told.append(("scans-unfit", text))
    elif c.sweep is not None and not moved:  # else it is of neither part
        stated, increment = sweep_seconds(recording, lidar), c.sweep / (lidar.ranges.shape[1] - 1)
        text = f"lidar: scans fit best if a sweep takes {c.sweep:.2g} s"
        text += f" and not the {stated:.3g} s stated: turns are " if stated else ", and none is stated: turns are "
        told.append(("time-increment", f"{text}smeared; by --platform give [lidar] time_increment = {increment:.2g}"))
    if moved:
        text = f"lidar: from about {turned.time:.0f} s on it looks {abs(degrees(turned.amount)):.1f} degrees to the "
        text += f"{'left' if turned.amount > 0 else 'right'} of where it did, by the odometry: it was turned on the "
        told.append(("mount-moves", f"{text}robot, or this drives aside there. Headings are wrong by as much"))
    elif c.fits and c.fit.scatter > YAW and "lengths" not in certain:
        text = f"lidar: half of the directions in which it drives are {degrees(c.fit.scatter):.1f} degrees or more off "
        text += "those by the odometry, to either side: angles between beams vary, as with the speed of a motor, or "
        told.append(("odometry-unfit", f"{text}wheels slip aside"))
    if c.correlation and not c.uneven and abs(curl) > max(CURL, SIGMAS * about_curl):
        text = f"odometry: it turns {abs(curl):.2f} rad to the {'left' if curl > 0 else 'right'} on every metre, and "
        why = "a wheel is smaller than stated" if recording.imu is None or not c.gyro else "its gyro may have a bias"
        told.append(("odometry-turn-scale", f"{text}scans do not: {why}, and its path curls"))
    if mounts := [certain[name] for name in ("x", "y", "yaw") if name in certain]:
        backwards = abs(se2.wrap(yaw - mount.yaw)) > np.pi * 3 / 4
        parts = [
            f"{one.name.replace(' of the lidar', '')} {one.value:.3g} ({_interval(one.value, one.deviation)}), "
            f"stated {one.stated:.3g}"
            for one in mounts
        ]
        where = "backwards, unless the odometry drives so," if backwards else "elsewhere"
        text = f"lidar: mounted {where} by the odometry: {'; '.join(parts)}. "
        text += f"In platform.toml: [lidar] x = {x:.3f}, y = {y:.3f}, yaw = {yaw:.4f}"
        if (np.abs(c.fit.values[MOUNT]) < np.minimum((PLACE, PLACE, YAW), SIGMAS * c.fit.deviations[MOUNT])).all():
            text += ". The odometry is that of the lidar itself: are the poses of robot and lidar exchanged?"
        told.append(("lidar-mount", text))
    if (scale := certain.get("lengths")) is not None:
        wheels = recording.platform.wheels
        text = f"ranges measure {_percent(scale)} odometry does; which of them is right scans cannot say. "
        if recording.encoders is not None and wheels is not None:
            again, count = int((np.diff(recording.encoders.stamps) == 0).sum()), len(recording.encoders)
            if again > TWICE * count:
                text += f"{again} of {count} readings of the wheels share a stamp: are they given twice? "
            sized = c.fit.wheels(wheels, gyro=recording.imu is not None and c.gyro)
            text += f"If ranges are, in platform.toml: [wheels] metres_per_count = {sized['metres_per_count']:.6g}"
            if sized["effective_track"] != wheels.effective_track:
                text += f", effective_track = {sized['effective_track']:.4g}"
        else:
            text += f"If ranges are, multiply the odometry's x and y by {scale.value:.4f}; else divide the ranges by it"
        told.append(("range-scale", text))
    change = c.fit.change
    if c.fits and change.exceeds(CHANGE, CHANGE_SIGMAS):
        by = f"{100 * abs(np.expm1(change.amount)):.1f} % {'more' if change.amount > 0 else 'less'}"
        text = f"lidar: from about {change.time:.0f} s on lengths by ranges are {by} over the odometry's than before: "
        text += "ranges, and with them the map, are "
        told.append(("range-change", f"{text}of another scale from there on, or the wheels' counts are, or these slip"))
    if c.longer.exceeds(EXCESS, CHANGE_SIGMAS):
        side = "longer" if c.longer.amount > 0 else "shorter"
        text = f"lidar: from about {c.longer.time:.0f} s on all ranges are {abs(c.longer.amount):.2f} m {side} than "
        told.append(("range-change", f"{text}before, or more, by scans from other places: the map has walls twice"))
    if (turns := certain.get("turns")) is not None:
        as_long = scale is not None and recording.encoders is not None
        why = "it is mended with its lengths" if as_long else "its track is wrong, or its angles no radians"
        if recording.imu is not None and recording.encoders is not None and c.gyro:
            rates = np.abs(recording.imu.angular_velocity[:, 2])
            most, why = float(rates.max()), "the gyro's rates are no rad/s"
            if (rates == most).sum() > ENDS:
                why = f"the gyro measures {most:.3g} rad/s and no more, where the robot turns faster: it saturates"
        text = f"odometry: robot turns {_percent(turns)} odometry does: {why}"
        told.append(("odometry-turn-scale", text))
    if (late := certain.get("offset")) is not None:
        side = ("later", "earlier")[int((late.value > 0) != bool(c.late))]
        by = f"{abs(late.value):.2f} s ({_interval(abs(late.value), late.deviation)}) {side}"
        text = f"lidar: scans are stamped {by} than the odometry of them"
        if lidar.odometry is not None:
            text = f"odometry: what is logged with scans is of {by} than they"
        if c.late:
            stream, others = ("imu", "wheels") if c.late == "gyro" else ("encoders", "gyro")
            text = f"{stream}: stamped {by} than scans and {others}"
        if stamped_at_end(c, recording):
            text += f", by about the {sweep_seconds(recording, lidar):.2f} s of a sweep, as if stamped at its end"
        text += ": it drives and turns at other times" if c.late == "encoders" else ": every turn is smeared"
        runs, about = (float(values[Parameter.DRIFT]) for values in (c.fit.values, c.fit.deviations))
        if SIGMAS * about * np.ptp(lidar.stamps) > LATE:
            text += f". It may drift, by {-1000 * runs:+.1f} +-{1000 * SIGMAS * about:.1f} ms a second: turns are too "
            text += "few to tell, and stamps far from them not known"
        told.append(("clock-offset", text))
    if (drift := certain.get("drift")) is not None:
        text = f"lidar: its clock runs {1000 * -drift.value:+.2f} ms a second against the odometry's, 95 %: "
        text += f"{1000 * (-drift.value - WITHIN * drift.deviation):+.2f} to "
        text += f"{1000 * (-drift.value + WITHIN * drift.deviation):+.2f}"
        told.append(("clock-drift", text))
    if c.uneven and c.correlation:
        text = f"lidar: its stamps run about {1000 * -c.uneven:+.0f} ms a second against the odometry's, as no clock "
        text += "does, or not steadily: were they counted, or scans lost? Motions, and with them the map, are wrong by "
        told.append(("other-clock", f"{text}as much"))
    if c.step is not None and c.correlation:
        told.append(c.step.told)
    if not c.gyro:
        text = "imu: its turns are not those of scans and wheels, which fit without; is its z up? Left out"
        told.append(("no-gyro", text))
    if (rest := gyro_at_rest(recording)) is not None and abs(rest.mean) > max(BIASED, 2 * rest.deviation):
        text = f"imu: its gyro turns by {rest.mean:.3f} rad/s while the wheels stand: dead reckoning turns by as much"
        told.append(("gyro-bias", f"{text}, SLAM corrects it. Take it off the yaw rate"))
    decided = {"clock-step", "stamps-jitter", "clock-offset", "clock-drift", "odometry-signs", "odometry-headings"}
    decided |= {"odometry-increments", *(["mirrored"] if c.wrong else [])}
    decided |= {"no-gyro"} | (set() if c.correlation else {"odometry-unfit"})
    issues = tuple(Issue(*each) for each in told)
    mended = set() if "turns" in certain else {"odometry-turn-scale"}  # a curl, while SLAM drives
    moves = tuple(issue for issue in issues if issue.code not in mended)
    return Findings(figures, issues, moves, frozenset(decided & {issue.code for issue in issues}))


def trusting(sync: SyncConfig, issues: Iterable[Issue]) -> SyncConfig:
    """How streams are synchronised: what travels along is known only where angles and odometry are as stated."""
    wrong = any(issue.code in ("lidar-angles", "odometry-unfit", "other-clock") for issue in issues)
    return sync.model_copy(update={"travelling": False}) if wrong else sync


def stamped_at_end(c: Calibration, recording: Recording) -> bool:
    """Whether scans are late by as much as a sweep takes: the driver stamps the last beam, or when it has a scan."""
    if c.clocks is None or c.shared_clock or c.late or recording.lidar is None:
        return False
    (offset, drift), (about, about_drift) = c.fit.values[CLOCKS].tolist(), c.fit.deviations[CLOCKS].tolist()
    if abs(drift) > SIGMAS * about_drift:  # at another time it is late by something else
        return False
    late, sweep = -offset, abs(sweep_seconds(recording, recording.lidar))
    return bool(sweep > 0 and abs(late - sweep) < WITHIN * about + NEAR_SWEEP)


def _mirrored(c: Calibration, toml: str) -> str:
    """Scans and odometry turn in opposite directions: which of them is wrong, and what mends it."""
    beams = "are in the other order, the last one first"
    if not c.reversed:
        beams = f"go the other way round, in platform.toml: [lidar] {toml}"
    if c.reversed is None:
        beams += " (or are in the other order, the last one first: the turns of this recording do not show which)"
    if c.wrong == "lidar":
        return f"lidar: odometry and its gyro turn the other way than the scans: the beams {beams}"
    if c.wrong == "odometry":
        return "odometry: scans and gyro turn the other way: its y and turns have the wrong sign"
    if c.wrong == "gyro":
        return "imu: scans and wheels turn the other way: its yaw rate has the wrong sign"
    text = f"scans and odometry turn in opposite directions (correlation {-abs(c.correlation):.2f}): a mirror image of "
    return f"{text}the place, if anything. Either the beams {beams}; or the odometry has y and turns of the wrong sign"


def figures_of(c: Calibration, recording: Recording) -> tuple[Figure, ...]:
    """All estimates beside what the recording and its platform state."""
    lidar, mount = require_lidar(recording), recording.platform.lidar
    x, y, yaw, lengths, turns_over_scans, *_ = c.fit.values.tolist()
    about_x, about_y, about_yaw, about_lengths, about_turns, *_ = c.fit.deviations.tolist()
    ratio, about_ratio = 1 / turns_over_scans, about_turns / turns_over_scans**2
    clocks = c.clocks or c.fit
    angles_differ = abs(c.angle_scale - 1) > max(ANGLES, SIGMAS * c.angle_deviation)
    span = abs(lidar.angle_increment) * (lidar.ranges.shape[1] - 1)
    least = [PLACE, PLACE, YAW + (abs(c.angle_scale - 1) * span if angles_differ else 0.0)]
    far = np.full(3, c.fits and not c.fit.turned.exceeds(YAW, TURNED_SIGMAS))  # else it is of neither part
    scaled = c.fits and c.sweep is None and abs(lengths - 1) > max(SCALE, LENGTHS_SIGMAS * about_lengths)
    change = c.fit.change
    scaled &= not (change.exceeds(CHANGE, CHANGE_SIGMAS) and abs(change.amount) > abs(np.log(lengths)) / 2)  # likewise
    for each, scale in product((c.fit, clocks), (1.0, lengths) if scaled else (1.0,)):  # with one clock, and with two
        apart = each.values[MOUNT] / (scale, scale, 1.0) - mount.pose  # by ranges, and by the odometry's lengths
        apart[Parameter.YAW] = se2.wrap(apart[Parameter.YAW])
        far &= np.abs(apart) > np.maximum(least, SIGMAS * each.deviations[MOUNT])
    turns = c.fits and abs(ratio - 1) > TURNS and abs(turns_over_scans - 1) > SIGMAS * about_turns
    too_long = abs(c.excess[0]) > max(EXCESS, SIGMAS * c.excess[1])
    too_long &= not (angles_differ or c.longer.exceeds(EXCESS, CHANGE_SIGMAS))  # one biases the other
    too_long &= not c.fit.stands  # floor that keeps its range
    rows = [
        ("angles between beams, over the stated", c.angle_scale, c.angle_deviation, 1.0, angles_differ),
        ("x of the lidar [m]", x, about_x, mount.x, far[0]),
        ("y of the lidar [m]", y, about_y, mount.y, far[1]),
        ("yaw of the lidar [deg]", degrees(yaw), degrees(about_yaw), degrees(mount.yaw), far[2]),
        ("excess of the ranges [m]", *c.excess, 0.0, too_long),
        ("lengths by ranges, over odometry", lengths, about_lengths, 1.0, scaled),
        ("turns by scans, over odometry", ratio, about_ratio, 1.0, turns),
    ]
    if c.clocks is not None and c.fits:
        differ = c.fits and not c.shared_clock
        (offset, drift), (about_offset, about_drift) = clocks.values[CLOCKS], clocks.deviations[CLOCKS]
        drifts = differ and abs(drift) > SIGMAS * about_drift
        rows += [
            ("offset of the odometry's clock [s]", offset, about_offset, 0.0, differ and not drifts),
            ("drift of the odometry's clock [s/s]", drift, about_drift, 0.0, drifts),
        ]
    return tuple(
        Figure(name, float(value), float(deviation), float(stated), bool(certain))
        for name, value, deviation, stated, certain in rows
    )


def lidar_of(lidar: LidarStream, c: Calibration, certain: Collection[str]) -> LidarStream:
    """With the angles and ranges that are certain."""
    if c.mirrored and c.reversed:
        lidar = replace(lidar, ranges=changed_ranges(lidar, lambda ranges: np.ascontiguousarray(ranges[:, ::-1])))
    if "excess" in certain:
        excess = np.float32(c.excess[0])
        lidar = replace(lidar, ranges=changed_ranges(lidar, lambda ranges: ranges - excess))
    sign = -1.0 if c.mirrored and not c.reversed else 1.0
    scale = c.angle_scale if "angles" in certain else 1.0
    return replace(lidar, angle_min=sign * lidar.angle_min, angle_increment=sign * scale * lidar.angle_increment)


def mount_of(
    c: Calibration, recording: Recording, certain: Collection[str], scale: float = 1.0
) -> tuple[float, float, float]:
    """x, y [m] and yaw [rad] of the lidar, as stated but for what is certain; of ranges that measure ``scale`` m."""
    mount, values = recording.platform.lidar, c.fit.values
    x = float(values[Parameter.X]) / scale if "x" in certain else mount.x
    y = float(values[Parameter.Y]) / scale if "y" in certain else mount.y
    turned = c.fits and ("yaw" in certain or "angles" in certain or c.mirrored)
    return x, y, float(values[Parameter.YAW]) if turned else mount.yaw


def changed_ranges(lidar: LidarStream, change: Callable[[Any], Any]) -> Ranges:
    """The ranges, changed; those of a file when they are asked for."""
    ranges = lidar.ranges
    if isinstance(ranges, np.ndarray):
        return np.asarray(change(ranges))
    return ChunkedRanges(lambda first, last: change(ranges[first:last]), *ranges.shape)


def _interval(value: float, deviation: float) -> str:
    low, high = (value + side * WITHIN * deviation for side in (-1, 1))
    return f"95 %: {low:.3g} to {high:.3g}"


def _percent(figure: Figure) -> str:
    low, high = (100 * (figure.value - 1 + side * WITHIN * figure.deviation) for side in (-1, 1))
    if not 0.5 < figure.value < 2:
        return f"{figure.value:.4g} times what"
    side = "more" if figure.value > 1 else "less"
    low, high = sorted((abs(low), abs(high)))
    return f"{100 * abs(figure.value - 1):.1f} % (95 %: {low:.1f} to {high:.1f} %) {side} than"
