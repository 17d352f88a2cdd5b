"""A recording held against itself: what its lidar and its odometry are, as pairs of scans show it."""

from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.inspection import silent_wheels
from moteslam.robot.recording import LidarStream, Recording
from moteslam.robot.se2 import Array
from moteslam.robot.values import expect_type
from moteslam.slam.calibration.hand_eye import (
    CLOCKS,
    MOST_DRIFT,
    MOUNT,
    RATE,
    SLIP,
    Fit,
    Parameter,
    Path,
    clock,
    expected_motions,
    fit,
)
from moteslam.slam.calibration.parts import Change
from moteslam.slam.calibration.readings import (
    AGREES,
    AGREES_LOGGED,
    FORMS,
    SPARSE,
    at_times,
    clock_steps,
    evened,
    expected_slip,
    falls_behind,
    heading_offset,
    in_form,
    in_step,
    increments,
    lag_of_wheels,
    out_of_step,
    without_lag,
    wrong_way,
)
from moteslam.slam.calibration.registered import GOOD, TURNING, RegisteredPairs, best_scale, choose_pairs
from moteslam.slam.calibration.unmeasured import (
    FEWEST,
    UnfitScansError,
    UnmeasuredError,
    between_jumps,
    expect_beams_in_place,
    expect_sound,
    turned_round,
    unmeasured,
)
from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.inputs.odometry_path import OdometryPath, odometry_path
from moteslam.slam.inputs.synchronise import WrongStamps, apart, bundles, in_order, is_coarse, require_lidar

PAIRS, FEW_PAIRS = 300, 150
"""Of a recording; the second is enough to see what moves a result by a tenth of a metre, in half a second."""
NEARER = 1 / 3
"""Where scans do not fit, pairs this much nearer are tried: odometry that is too short takes scans too far apart."""
FAR_OFF, TURNS_OFF = 0.1, 0.2
"""Angles, or turns by odometry over the scans', that differ by more may be one of several minima: others are tried."""
BETTER, EVIDENCE = 0.4, 60.0
"""Odometry is read in another way where that costs less than this share, and over all pairs less by this much."""
EXPLAINED = 0.6
"""Two clocks explain what scans show where the odometry costs less than this share of what it does with one; and so do
other angles than stated where scans see one side of the robot alone: these are biased by a few percent. Wheels without
a gyro, whose turns are poor, are not asked."""
STEPPED = 0.8
"""A clock steps where the odometry costs less than this share without, and over all pairs less by ``EVIDENCE``."""
UNFIT = 7.0
"""Odometry that costs more in every way does not measure the motion of the scans."""
ANGLES = 0.012
"""Angles that differ by less from the stated move no result by a tenth of a metre."""
SIGMAS = 5.0
"""What differs from what is stated by less than this many standard deviations is not certain."""
LATE, LATE_WHEELS = 0.16, 0.25
"""Clocks that differ by less are taken for one [s]: wheels without a gyro turn before the robot does, by 0.1 s."""
WHEELS_LEAD = 0.1  # Wheels turn so long before the robot does [s]: along a ring it else passes for a lidar aside
DRIFT = 1e-3  # Likewise [s/s]
SOME = 256  # So many scans show whether they are sound: those of an hour are not read for that
FEW_FIT = 0.5  # Scans are told not to fit each other where a smaller share of the pairs does


@dataclass(frozen=True, eq=False)
class Calibration:
    """What scans show of their lidar and of the odometry."""

    angle_scale: float  # of the angles, over the stated
    angle_deviation: float  # of that
    excess: tuple[float, float]  # by how much ranges are too long, and the deviation of that [m]
    longer: Change  # where that changes most clearly
    mirrored: bool  # the beams, or the odometry, go the other way round
    # which one turns the wrong way by a third witness, the gyro, or wheels beside it; empty without
    wrong: Literal["", "lidar", "odometry", "gyro"]
    form: str  # of `FORMS`, the one that odometry poses fit the scans in
    # what is to be added to its headings [rad] where they point aside of its path, and of the lidar as stated; else 0
    heading_offset: float
    fit: Fit  # the mount and the rest; its clocks are one where they do not differ clearly
    correlation: float  # of the turns of scans and odometry
    clocks: Fit | None  # a fit with the difference of the clocks; None if the odometry is logged with the scans
    shared_clock: bool  # the clocks do not differ clearly, or the scans fit no better with two
    late: Literal["", "gyro", "encoders"]  # the one of both whose stamps alone are off
    fits: bool  # the odometry measures the motion of the scans; else nothing but the angles is known
    reversed: bool | None  # mirrored beams are in the wrong order in time, too; None where scans do not show it
    sweep: float | None  # how long a sweep takes [s] where it clearly is not as stated, or none is stated
    no_surfaces: float | None  # from which range on [m] endpoints are none; negative if on a line, as of floor
    uneven: float = 0.0  # drift [s/s] of clocks that clearly are not one, of which no steady drift explains much
    step: WrongStamps | None = None  # of a clock, bundles of scans, increments; all else is of the recording without it
    gyro: bool = True  # the odometry fits with the gyro's turns, or without as little; else all is of wheels alone


def calibrate(recording: Recording, *, pairs: int = PAIRS) -> Calibration | None:
    """What a recording shows of its sensors, from scans alone and from scans and odometry, by so many pairs of scans.

    None if too few scans fit each other, the robot hardly turns, or there is no odometry.
    """
    try:
        return estimate(recording, pairs)
    except UnmeasuredError:
        return None


def estimate(recording: Recording, pairs: int) -> Calibration | None:
    """The same; scans that do not fit, and drives that show nothing, raise ``UnmeasuredError``."""
    expect_type(recording, Recording, "recording", "open_recording(path) reads one")
    lidar = recording.lidar
    if lidar is None or min(lidar.ranges.shape) < FEWEST or lidar.interlace > 1 or silent_wheels(recording):
        return None
    if (wrong := increments(recording) or bundles(lidar)) is not None:
        found = estimate(wrong.undone(recording), pairs)
        return None if found is None else replace(found, step=wrong)
    if any(map(is_coarse, recording.stamps().values())):
        return None
    middle = slice(len(lidar) // 2, len(lidar) // 2 + SOME)
    recording = recording.replace(lidar=(lidar := evened(lidar, lidar.ranges[middle])))
    expect_beams_in_place(some := lidar.ranges[middle])
    if np.isnan(some).mean() > SPARSE:
        return None
    try:
        with np.errstate(all="ignore"):
            expect_sound(some)
            found = _without_step(recording, _in_some_reading(recording, in_order(lidar), pairs), pairs)
    except (InputError, np.linalg.LinAlgError):  # encoders without wheels; values that are not finite
        return None
    if found is None or found.fits or recording.imu is None or recording.encoders is None:
        return found
    alone = calibrate(recording.replace(imu=None), pairs=pairs)
    return replace(alone, gyro=False) if alone is not None and alone.fits else found


def _without_step(recording: Recording, found: Calibration | None, pairs: int) -> Calibration | None:
    """What fits the scans clearly better once the step of a clock is undone, if there is one."""
    if found is None or found.clocks is None:
        return found
    for step in clock_steps(recording, LATE):
        undone = step.undone(recording)
        try:
            again = _in_some_reading(undone, in_order(require_lidar(undone)), pairs)
        except UnmeasuredError:
            continue
        if again is None or again.clocks is None or not again.fits:
            continue
        cost, less = (min(each.fit.cost, each.clocks.cost) for each in (found, again) if each.clocks is not None)
        if less < STEPPED * cost and (cost - less) * pairs > EVIDENCE:
            return replace(again, step=step)
    return found


def _in_some_reading(recording: Recording, lidar: LidarStream, pairs: int) -> Calibration | None:
    """With the angles as stated; where scans do not fit or the angles are far off, with the scale that fits best."""
    poses = lidar.odometry
    path = odometry_path(recording, SyncConfig()) if poses is None else OdometryPath(lidar.stamps, poses)
    if path is None or apart(lidar.stamps, path.stamps[0], path.stamps[-1]):  # of another clock: SLAM refuses it
        return None
    odometry = path.at(lidar.stamps)
    of = (choose_pairs(lidar, odometry, pairs, far) for far in (1.0, NEARER))
    chosen, nearer = (between_jumps(path, lidar.stamps, *some) for some in of)
    stated, found, unfit = None, None, None
    for some in (chosen, nearer):
        scans, again = RegisteredPairs(recording, lidar, *some) if len(some[0]) >= FEWEST else None, None
        try:
            again = _calibrate(recording, lidar, path, scans) if scans is not None else None
        except UnfitScansError as error:
            unfit = unfit or error
        stated, found = stated or scans, again or found
        if found is None and unfit is None:
            unmeasured(odometry)
            return None
        if again is None or not again.correlation:  # in a square room a long turn may pass for one of a quarter less
            continue
        turned = again.fit.values[Parameter.TURNS]
        if again.fits and abs(again.angle_scale - 1) < FAR_OFF and abs(turned - 1) < TURNS_OFF:
            return again
        break
    scale = best_scale(recording, lidar, *chosen)
    scaled = replace(lidar, angle_increment=scale * lidar.angle_increment)
    scans = RegisteredPairs(recording, scaled, *chosen)
    try:
        again = None if scale == 1 else _calibrate(recording, scaled, path, scans)
    except UnfitScansError:
        again = None
    if again is not None and stated is not None and scans.fits_better(stated):
        deviation = scale * again.angle_deviation
        return replace(again, angle_scale=scale * again.angle_scale, angle_deviation=deviation)
    if found is None and unfit is not None:
        if unfit.share < FEW_FIT:
            raise unfit
        unmeasured(odometry)
    return found


def _calibrate(
    recording: Recording, lidar: LidarStream, path: OdometryPath, scans: RegisteredPairs
) -> Calibration | None:
    logged, slip = lidar.odometry is not None, expected_slip(recording.platform)
    fitted = partial(fit, slip=slip)
    scans.expect(GOOD / 2)
    if scans.pairs.motions[:, 2].std() < TURNING:
        return None
    same = in_step(path, scans.pairs)
    scans.expect_one_way(same, lambda part: "clock" if out_of_step(recording, part) else wrong_way(recording, part))
    read = _read(scans, path, logged=logged, poses=logged or recording.encoders is None)
    if read is None and falls_behind(recording, scans.pairs):
        turned_round("clock", "throughout")
    form, mirrored, correlation, (offset, drift) = read or ("stated", False, 0.0, (0.0, 0.0))
    at = at_times(in_form(path, form))
    wrong = wrong_way(recording, scans.pairs) if mirrored else ""
    is_reversed = scans.mirror(lidar, _rates(scans, at, offset, drift)) if mirrored else False
    angle_scale, deviation, excess = scans.scale_angles()
    longer = scans.change_of_offset(excess[1])
    best, added = fitted(scans.pairs, at, (offset, drift), shared=logged), 0.0
    if not mirrored and recording.encoders is None:
        aside = float(se2.wrap(best.values[Parameter.YAW] - recording.platform.lidar.yaw))
        added = heading_offset(in_form(path, form).poses, aside, form)
        at = at_times(in_form(path, form, added))
    rates = _rates(scans, at, *best.values[CLOCKS], turns=best.values[Parameter.TURNS])
    scans.refine(expected_motions(best.values, scans.first, scans.last, best.middle, at), rates)
    scans.expect(GOOD)
    clocks = fitted(scans.pairs, at, (offset, drift), shared=logged)
    wheels_alone = recording.encoders is not None and recording.imu is None and not logged
    if abs(angle_scale - 1) > ANGLES:
        witness = scans.stated()
        as_stated = fitted(witness.pairs, at, (offset, drift), shared=logged)
        better = scans.fits_better(witness)
        beside = wheels_alone or scans.sees_both_sides(recording.platform.lidar.yaw)
        borne_out = better is not False if clocks.cost <= EXPLAINED * as_stated.cost else better and beside
        if not borne_out or abs(angle_scale - 1) <= SIGMAS * deviation:
            scans, clocks, excess = witness, as_stated, (excess[0], max(excess[1], abs(excess[0])))
            deviation = max(deviation, abs(angle_scale - 1))
    one = clocks if logged else fitted(scans.pairs, at, (0.0, 0.0), shared=True)
    if logged:  # poses that are not of the scans that they are logged with come late by as much
        turned = in_form(path, form, added)
        *began, _ = clock(scans.pairs, turned.stamps, np.unwrap(turned.poses[:, 2]), shared=False)
        clocks = fitted(scans.pairs, at, (began[0], began[1]), shared=False)
    uneven, duration = float(clocks.values[Parameter.DRIFT]), float(np.ptp(lidar.stamps))
    leaps = abs(uneven) > max(MOST_DRIFT, SIGMAS * clocks.deviations[Parameter.DRIFT])
    clocks = one if leaps else clocks  # no clock drifts so
    differ = _clocks_differ(clocks, duration, wheels_alone=wheels_alone)
    shared = not (differ and clocks.cost < EXPLAINED * one.cost)
    steady = abs(uneven) * duration <= 2 * LATE_WHEELS if leaps else not (differ and shared)
    if shared and logged:
        clocks, lead = one, fitted(scans.pairs, at, (0.0, 0.0), shared=True, lead=WHEELS_LEAD)
        for values, known in ((one.values, lead.values), (one.deviations, lead.deviations)):
            values[MOUNT] = known[MOUNT]
    late: Literal["", "gyro", "encoders"] = ""
    start = clocks.values[Parameter.OFFSET] + clocks.values[Parameter.DRIFT] * (scans.first.min() - clocks.middle)
    began_as_one = abs(start) < (LATE_WHEELS if wheels_alone else LATE)
    if wheels_alone and began_as_one and not leaps:
        slip = (max(-start, 0.0), SLIP[1]) if slip == SLIP else slip  # it follows its wheels as late as it slips aside
        clocks = fitted(scans.pairs, at, (offset, drift), shared=False, slip=slip)
    best = one if shared and not (logged or wheels_alone) else clocks._replace(values=clocks.values.copy())
    if not shared and began_as_one:
        best.values[Parameter.OFFSET] -= start
    if not logged and recording.imu is not None and recording.encoders is not None:
        lag = float(clocks.values[Parameter.OFFSET]) if differ else lag_of_wheels(recording, scans.pairs)
        if differ or abs(lag) > LATE:
            alone = without_lag(recording, scans.pairs, "imu" if differ else "encoders", lag)
            if alone.cost < EXPLAINED * min(one.cost, clocks.cost):
                shared, late, best = False, "gyro" if differ else "encoders", alone
                clocks = clocks if differ else best
    uneven = 0.0 if steady or logged or late else uneven
    fits = read is not None and not uneven and min(best.cost, clocks.cost) < UNFIT and not best.stands
    rates = _rates(scans, at, *best.values[CLOCKS], turns=best.values[Parameter.TURNS])
    return Calibration(
        angle_scale=angle_scale,
        angle_deviation=deviation,
        excess=excess,
        longer=longer,
        mirrored=mirrored,
        wrong=wrong,
        form=form,
        heading_offset=added,
        fit=best,
        correlation=correlation,
        clocks=None if logged and shared else clocks,
        shared_clock=shared,
        uneven=uneven,
        late=late,
        fits=fits,
        reversed=is_reversed,
        sweep=scans.sweep_taken(recording, lidar, rates) if fits and not mirrored else None,
        no_surfaces=scans.no_surfaces_beyond(),
    )


def _clocks_differ(found: Fit, duration: float, *, wheels_alone: bool) -> bool:
    """Whether the stamps of scans and odometry clearly are of two clocks."""
    (offset, drift), (about_offset, about_drift) = found.values[CLOCKS], found.deviations[CLOCKS]
    late = abs(offset) > max(LATE_WHEELS if wheels_alone else LATE, SIGMAS * about_offset)
    drifts = abs(drift) > max(DRIFT, SIGMAS * about_drift)
    return bool(late or (drifts and abs(drift) * duration > LATE))


def _rates(scans: RegisteredPairs, at: Path, offset: float, drift: float, *, turns: float = 1) -> tuple[Array, Array]:
    """The odometry's turns, over a scale, while former scans of pairs [k] were taken, and the latter ones [rad/s]."""
    middle = scans.pairs.middle
    begins, ends = (time + offset + drift * (time - middle) for time in (scans.first, scans.last))
    former, latter = ((at(time + RATE / 2) - at(time - RATE / 2))[:, 2] / (RATE * turns) for time in (begins, ends))
    return former, latter


def _read(
    scans: RegisteredPairs, path: OdometryPath, *, logged: bool, poses: bool
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
        pairs, mirrored, signs = scans.pairs, correlation < 0, np.array((1, -1, -1))
        if mirrored:
            covariances = pairs.covariances * np.outer(signs, signs)
            pairs = pairs._replace(motions=pairs.motions * signs, covariances=covariances)
        cost = fit(pairs, at_times(read), (offset, drift), shared=logged).cost
        if cost < BETTER * least and (least - cost) * len(pairs.first) > EVIDENCE:
            best, least = (form, mirrored, correlation, (offset, drift)), cost
    if best is not None and best[1] and best[0] in ("turns", "y"):  # one wrong sign in place of two
        return ("y" if best[0] == "turns" else "turns", False, *best[2:])
    return best
