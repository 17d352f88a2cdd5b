"""Streams of what a file says: sorted by their stamps, ranges by their meaning, without what no robot does.

Stamps that go back a little are sorted; absurd ones and those of several clocks are refused.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, NoReturn, Self

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.platform import Platform, too_wide
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, OdometryStream
from moteslam.robot.values import Issue, counted, given_up, unpadded

Array = NDArray[Any]
Stamps = NDArray[np.float64]
Mask = NDArray[np.bool_]

MAX_STAMP = 1e11  # [s]: beyond it (the year 5138) stamps are milliseconds or garbage
MAX_JUMP = 86400.0  # [s]: a longer silence within a stream, of a day, is a broken stamp
MAX_SPAN = 10 * 365.25 * 86400.0  # [s]: no recording is longer, of ten years
SET_BACK = 2.0  # [s]: readings that are less late are those of a busy logger, whose processes are up to 1 s apart
FOLLOWING, FEWEST = 10, 3
"""Readings that all stay behind after a clock was set back; near the end of the recording the second."""
OF_TWICE, MOST_TWICE = 0.4, 4000
"""Time that is passed twice is so in steps of less than this share of it, both times, and in fewer of them than this
(`SET_BACK` at 1000 Hz, twice). As many places are looked at: stamps that go back more often are of no clock."""
LEAST_BACK = 0.1  # [s]: where stamps are even but for one step, a clock that was set back by less is a busy logger's
AGAIN = 0.75  # of the time between new scans: ten that equal the one before sooner than that are given again
MAX_DROPPED = 3  # readings that cannot be are always dropped; more of them only up to a tenth of the stream

MAX_RATE = 100.0  # [rad/s]: no robot turns 16 times a second; common gyros end at 35, the largest range sold is 70
MAX_SPEED = 100.0  # [m/s]: no wheeled robot drives faster
MAX_PLACE = 1e7  # No robot is farther from where it began [m], nor has turned more in all [rad]: a quarter of the globe
SLACK = 1.0  # [m]: travel that may be beyond that, for stamps jitter: a late one leaves the next no time

CLIPPED, SAME = (0.03, 0.95), 1e-4
"""Where so many of all endpoints, and some of most scans, are the longest range, to the second [m], it is no return."""
STAYS, CODES = 0.9, 100
"""Beams that end there in a larger share of the scans see the robot's body; of codes beyond a limit there are fewer."""
SPIKE, RARE = 5, 0.002  # times as many ranges as at any other value are a spike, no return in such a share of all
SAMPLE = 64  # scans that limits are looked for in


class Fan(NamedTuple):
    """Angles [rad] and limits [m] of a lidar; of scans in bags also the number of beams and the time between them."""

    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    beams: int = 0
    time_increment: float = 0.0  # [s]

    def over(self, given: dict[str, Any], beams: int, *, file: Path, field: str) -> Self:
        """The same with what a caller's ``platform.toml`` puts in place of angles and limits; refused where it goes
        round more than once or its limits do not fit together.
        """
        stated = given.get("angle_increment", self.angle_increment)
        for increment, where in ((self.angle_increment, field), (stated, "platform.lidar.angle_increment")):
            if (problem := too_wide(beams, increment)) is not None:
                raise InputError(problem, file=file, field=where)
        fan = self._replace(**{key: given[key] for key in self._fields[:4] if key in given})
        if fan.range_min >= fan.range_max:
            problem = f"{fan.range_min:g} m, expected less than the {fan.range_max:g} m that are its range_max"
            raise InputError(problem, file=file, field="platform.lidar.range_min")
        return fan

    def within(self, ranges: NDArray[np.float32], issues: list[Issue], head: str, *, given: object = None) -> Self:
        """The same with the limits that some scans [n, beams] [m] show, where many ranges are alike, at changing beams;
        told, and so is much that is beyond a limit not ``given`` and no code: it may be walls.
        """
        ends = (ranges >= np.float32(self.range_min)) & (ranges < np.float32(self.range_max)) & (ranges > 0)
        fan, count = self, max(int(ends.sum()), 1)
        (longest, spike), shortest = _code(ranges[ends]), ranges.min(initial=np.inf, where=ends)
        codes = np.abs(ranges - longest) < SAME, ranges < shortest + SAME
        for at, name in zip((ends & each for each in codes), ("max", "min"), strict=True):
            share, beams = at.sum() / count, at.mean(axis=0)
            stay = len(ranges) < SAMPLE / 2 or not at.any() or (beams[beams > 0] > STAYS).mean() > 0.5
            usual = share > CLIPPED[0] and at.any(axis=1).mean() > 0.5
            if not stay and (usual or (spike and name == "max" and share > RARE)) and share < CLIPPED[1]:
                limit, which = float(ranges[at].min()), "longest usual" if name == "max" else "shortest"
                text = f"{100 * share:.2g} % of the endpoints are {limit:g} m away, the {which} range: taken for no "
                issues.append(Issue("range-max", f"{head}: {text}return, as if range_{name} were {limit:g} m"))
                fan = fan._replace(range_max=limit) if name == "max" else fan._replace(range_min=limit + SAME)
        beyond = ranges[np.isfinite(ranges) & (ranges >= np.float32(self.range_max))]
        if not given and len(beyond) > CLIPPED[0] * count and len(np.unique(beyond)) > CODES:
            text = f"{100 * len(beyond) / (count + len(beyond)):.0f} % of ranges, up to {beyond.max():g} m, are beyond "
            text = f"{text}range_max ({self.range_max:g} m), no return: if walls, give [lidar] range_max by --platform"
            issues.append(Issue("range-max", f"{head}: {text}"))
        return fan

    @property
    def angles(self) -> NDArray[np.float64]:
        """Of the beams [beams] [rad]."""
        return self.angle_min + self.angle_increment * np.arange(self.beams, dtype=np.float64)

    def flipped(self) -> Self:
        """The fan seen from the other side: of a lidar that hangs upside down."""
        return self._replace(angle_min=-self.angle_min, angle_increment=-self.angle_increment)

    def reversed(self) -> Self:
        """The fan with its last beam first."""
        last, step = self.angle_min + (self.beams - 1) * self.angle_increment, -self.angle_increment
        return self._replace(angle_min=last, angle_increment=step, time_increment=-self.time_increment)


def clock_cuts(stamps: Stamps) -> list[int]:
    """The readings before which a clock was set back or, on and on, ahead by more than a day.

    So it is in a log of two runs, of a simulator that was reset, or of a recording that was played in a loop: those
    that follow stay behind by more than `SET_BACK`, or the time that the clock went back by is passed twice, step by
    step. A late message is neither: it fills a hole, and the stamp after it leaps to where they were.
    """
    found, start, last = list[int](), 0, len(stamps) - FEWEST
    if last <= 0:
        return found
    highest = _window(stamps, -np.inf).max(axis=1)
    lowest = _window(stamps, np.inf).min(axis=1)
    twice = _passed_twice(stamps)
    while start < last and len(found) < 1000:
        peak = np.maximum.accumulate(stamps[start:last])
        after = slice(start + 1, last + 1)
        is_back = (stamps[after] < peak - SET_BACK) & (highest[after] < peak)
        at = np.flatnonzero(is_back | twice[after] | (lowest[after] - peak > MAX_JUMP))
        if not len(at):
            break
        start += 1 + int(at[0])
        found.append(start)
    return found


def _passed_twice(stamps: Stamps) -> Mask:
    """Before which readings [n] time goes back over what it passes in small steps, or in the only uneven step."""
    peak, found = np.maximum.accumulate(stamps), np.zeros(len(stamps), np.bool_)
    at = np.flatnonzero(np.diff(stamps) < 0) + 1
    begin, end = (np.searchsorted(peak, edge, side="right") for edge in (stamps[at], peak[at - 1]))
    some = (at - begin >= FEWEST) & (end - at >= FEWEST) & (end - begin < MOST_TWICE)
    for here, first, last in np.column_stack((at, begin, end))[some][:MOST_TWICE].tolist():
        passes = stamps[max(first - 1, 0) : here], stamps[here : last + 1]
        most = OF_TWICE * (peak[here - 1] - stamps[here])
        found[here] = all(np.abs(np.diff(one)).max() < most < np.ptp(one) for one in passes)
    steps = np.diff(stamps)
    for here in at[peak[begin - 1] != stamps[at]][:MOST_TWICE].tolist():  # at the same stamp it is given twice
        first = max(here - 1 - FOLLOWING, 0)
        beside = np.delete(steps[first : here + FOLLOWING], here - 1 - first)
        usual = np.median(beside) if len(beside) else 0.0
        even = len(beside) >= FOLLOWING and np.abs(beside - usual).max() < usual / 2
        found[here] |= even and usual - steps[here - 1] > LEAST_BACK
    return found


def _window(stamps: Stamps, beyond: float) -> Stamps:
    """Each stamp with those that follow [n, FOLLOWING]."""
    return sliding_window_view(np.concatenate((stamps, np.full(FOLLOWING - 1, beyond))), FOLLOWING)


def sort_by_stamp(file: Path, field: str, stamps: Array, issues: list[Issue]) -> tuple[Stamps, NDArray[np.intp]]:
    """The stamps [k] that rise, of stamps [n] [s], and the readings [k] in this order; what was done is told.

    Readings that share a stamp stay in the order they came in. Those with the stamp 0 among others of Unix time, of a
    driver that was up before its clock, are left out.
    """
    stamps = stamps.astype(np.float64)

    def refuse(problem: str) -> NoReturn:
        raise InputError(problem, file=file, field=field)

    bad = ~(np.abs(stamps) <= MAX_STAMP)
    if bad.any():
        first = int(np.argmax(bad))
        units = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}
        hint = [f": are they {unit}?" for scale, unit in units.items() if 1e8 < stamps[first] / scale < 1e10]
        refuse(f"stamp {stamps[first]:.6g} at reading {first}, expected finite seconds below 1e11{''.join(hint)}")
    kept = np.arange(len(stamps))
    unset = (stamps == 0) & (np.min(stamps[stamps != 0], initial=np.inf) > MAX_JUMP) & stamps.any()
    if 0 < (count := int(unset.sum())) <= max(MAX_DROPPED, len(stamps) // 10):
        text = f"{file.name}: {field}: {counted(count, 'reading')} with the stamp 0 left out, before the clock was set"
        issues.append(Issue("unset-stamps", text, count))
        kept = np.flatnonzero(~unset)
    used = stamps[kept]
    if cuts := [at for at in clock_cuts(used) if used[at] < used[at - 1]]:
        back = f"{used[: cuts[0]].max() - used[cuts[0]]:.6g} s at reading {kept[cuts[0]]}"
        cause = "it was set, or is full and begins again, or these are several recordings: cut the file there"
        refuse(f"the clock goes back by {back} and goes on from there, expected one that rises: {cause}")
    order = kept[np.argsort(used, kind="stable")]
    rising = stamps[order]
    steps = np.diff(rising)
    if steps.max(initial=0.0) > MAX_JUMP:
        at = int(np.argmax(steps))
        refuse(f"jump of {steps[at]:.6g} s after {float(rising[at])!r}, expected steps of less than a day")
    if steps.sum() > MAX_SPAN:
        refuse(f"span {steps.sum():.6g} s, expected less than 10 years")
    if count := int((np.diff(used) < 0).sum()):
        text = f"{file.name}: {field}: {count} stamps go back; the readings were sorted by stamp"
        issues.append(Issue("stamps-go-back", text, count))
    issues += unpadded(f"{file.name}: {field}", used)
    return rising, order


def given_again(path: Path, field: str, stamps: Stamps, marks: Array, issues: list[Issue]) -> Mask:
    """Which scans [n] were published again under a later stamp: sooner than the lidar measures, or, each by about the
    same time, after others; told. Marks [n] are equal of scans that are.

    A lidar that stands may measure the same again, a period later, and some at rest after others, at any time.
    """
    _, first, which, times = np.unique(marks, return_index=True, return_inverse=True, return_counts=True)
    same, index = np.diff(which, prepend=-1) == 0, np.arange(len(marks))
    begin = np.maximum.accumulate(np.where(same, 0, index))
    after = (first[which] < begin) & (times[which] <= FEWEST)
    late = stamps - stamps[np.where(after, first[which], begin)]
    if after.sum() < FOLLOWING or np.ptp(np.percentile(late[after], (10, 90))) > np.median(late[after]) / 2:
        after[:] = False
    new = np.flatnonzero(~same & ~after)
    period = np.percentile(np.diff(stamps[new]), 10) if len(new) > 1 else 0.0
    again = after | (same & (late < AGAIN * period))
    count = int(again.sum())
    if count < FOLLOWING:
        return np.zeros(len(stamps), np.bool_)
    text = f"{count} scans given again {np.median(late[again]):.3f} s later, when the lidar cannot have measured them: "
    issues.append(Issue("doubles", f"{path.name}: {field}: {text}dropped, since nothing was measured then", count))
    return np.asarray(again)


def sampled(scans: int) -> NDArray[np.intp]:
    """Some of as many scans, all over them."""
    return np.unique(np.linspace(0, scans - 1, min(SAMPLE, scans)).astype(np.intp))


def clean_ranges(ranges: NDArray[np.float32], fan: Fan, issues: list[Issue], head: str) -> NDArray[np.float32]:
    """Ranges [n, beams] [m] as endpoints, no return and invalid.

    At or beyond ``range_max``, and ``+inf``: no return, ``inf``. Below ``range_min`` (lidars put error codes there) and
    0: invalid, ``nan``. Negative, ``-inf`` and NaN: invalid, and counted in an issue, for no sensor reports them.
    """
    clean = ranges.copy()
    garbage = ~(ranges >= 0)
    clean[ranges >= np.float32(fan.range_max)] = np.inf
    clean[~(ranges > 0) | (ranges < np.float32(fan.range_min))] = np.nan
    if count := int(garbage.sum()):
        found = f"{counted(count, 'range')} in {counted(int(garbage.any(axis=1).sum()), 'scan')}"
        issues.append(Issue("invalid-ranges", f"{head}: {found} left out, NaN or negative", count))
    return clean


def _code(ranges: NDArray[np.float32]) -> tuple[float, bool]:
    """The longest of some ranges or, where one is a spike and fewer are beyond it, that [m]; and whether it is."""
    values, counts = np.unique(np.append(0, np.rint(ranges / SAME)), return_counts=True)
    code, beside = int(counts.argmax()), np.sort(counts)[-2:][0]
    is_spike = counts[code] > max(SPIKE * beside, counts[code + 1 :].sum())
    return float(values[code] * SAME) if is_spike else float(ranges.max(initial=0.0)), bool(is_spike)


@dataclass(frozen=True)
class Sensors:
    """Makes the streams of a robot of what its files say: stamps [n] [s] and values, in the order of the file.

    ``given`` is what a caller's ``platform.toml`` puts in place of a lidar's angles and limits.
    """

    robot: Platform
    given: dict[str, Any]
    issues: list[Issue]

    def lidar(
        self,
        file: Path,
        field: str,
        stamps: Array,
        ranges: NDArray[np.float32],
        fan: Fan,
        odometry: Array | None = None,
        interlace: int = 1,
    ) -> LidarStream:
        """Ranges [n, beams] [m] as reported, poses [n, 3] logged with the scans; ``interlace`` as in `LidarStream`."""
        fan, head = fan.over(self.given, ranges.shape[1], file=file, field="angle_increment"), f"{file.name}: {field}"
        stamps, order = sort_by_stamp(file, field, stamps, self.issues)
        marks = np.array([hash(ranges[scan].tobytes()) for scan in order], np.int64)
        new = ~given_again(file, field, stamps, marks, self.issues)
        stamps, order = stamps[new], order[new]
        sequence = None if odometry is None else _sequence(file, field, odometry, order, self.issues)
        fan = fan.within(ranges[sampled(len(ranges))], self.issues, head, given=self.given.get("range_max"))
        clean = clean_ranges(ranges[order], fan, self.issues, head)
        poses = None if odometry is None else odometry[order]
        step = self.robot.lidar.time_increment / interlace
        return LidarStream(stamps, given_up(clean), *fan[:4], step, poses, sequence, interlace)

    def odometry(self, file: Path, field: str, stamps: Array, poses: Array) -> OdometryStream | None:
        """The poses [n, 3] of a base, if there are any."""
        stamps, order = sort_by_stamp(file, field, stamps, self.issues)
        return OdometryStream(stamps, poses[order]) if len(stamps) else None

    def encoders(self, file: Path, fields: tuple[str, str], stamps: Array, counts: Array) -> EncoderStream:
        """Counts [n, 4] since the last reading, without those of more than 100 m/s."""
        stamps, order = sort_by_stamp(file, fields[0], stamps, self.issues)
        counts = counts[order]
        if self.robot.wheels is not None:
            travel = np.abs(counts.astype(np.float64)).max(axis=1) * self.robot.wheels.metres_per_count
            plausible = travel <= SLACK + MAX_SPEED * np.diff(stamps, prepend=stamps[:1])
            stamps, counts = self._keep(file, fields[1], plausible, "beyond 100 m/s", stamps, counts)
        return EncoderStream(stamps, counts.astype(np.int64))

    def imu(self, file: Path, fields: tuple[str, str], stamps: Array, angular: Array, linear: Array) -> ImuStream:
        """Turn rates [n, 3] [rad/s], without those beyond 100 rad/s, and accelerations [n, 3] [g]."""
        stamps, order = sort_by_stamp(file, fields[0], stamps, self.issues)
        angular, linear = angular[order], linear[order]
        plausible = np.asarray((np.abs(angular) <= MAX_RATE).all(axis=1))
        stamps, angular, linear = self._keep(file, fields[1], plausible, "beyond 100 rad/s", stamps, angular, linear)
        return ImuStream(stamps, angular.astype(np.float64), linear.astype(np.float64))

    def _keep(self, file: Path, field: str, plausible: Mask, what: str, *values: Array) -> tuple[Array, ...]:
        """The plausible readings [k, ...] of values [n, ...]; a few others are dropped and counted."""
        dropped = int((~plausible).sum())
        if dropped and (dropped == len(plausible) or dropped > max(MAX_DROPPED, len(plausible) // 10)):
            problem = f"{dropped} of {len(plausible)} readings {what}, expected those of a robot"
            raise InputError(problem, file=file, field=field)
        if dropped:
            text = f"{file.name}: {field}: {dropped} readings {what} dropped"
            self.issues.append(Issue("implausible-readings", text, dropped))
        return tuple(value[plausible] for value in values)


def _sequence(
    path: Path, field: str, odometry: Array, order: NDArray[np.int64], issues: list[Issue]
) -> NDArray[np.int64] | None:
    """The order [n] in which scans sorted by stamp were taken, where it is the file's and not that of their stamps.

    A clock that is set back or a message that waits gives a scan the stamp of another moment. In the right order
    the robot's path by the poses logged with the scans, ``odometry`` [n, 3] in the file's order, is the shorter one.
    """
    paths = (odometry[:, :2], odometry[order, :2])
    written, by_stamp = (float(np.hypot(*np.diff(path, axis=0).T).sum()) for path in paths)
    if written >= by_stamp:
        return None
    text = f"by the odometry logged with them ({written:.0f} m in the file's order, {by_stamp:.0f} m in that of their "
    text += "stamps) the scans were taken in the file's order: SLAM takes them so"
    issues.append(Issue("stamps-out-of-order", f"{path.name}: {field}: {text}"))
    return order
