"""CARMEN logs, plain or gzip. Lines, rules and bounds: ``docs/reference/formats.md``.

Source: the head that CARMEN's logger writes (carmen.sourceforge.net/logger_playback.html).
"""

import math
import re
from array import array
from collections import Counter
from contextlib import suppress
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.formats import Format, Robot, expect_no_sequence
from moteslam.robot.formats.lines import TextLines
from moteslam.robot.formats.streams import MAX_DROPPED, MAX_PLACE, MAX_STAMP, Fan, Sensors
from moteslam.robot.formats.written import CLASSIC_STEPS, OWN_PARAMETERS, fov_of, write_carmen
from moteslam.robot.platforms import CARMEN, GivenRobot, platform_of
from moteslam.robot.recording import Recording, no_return_limit
from moteslam.robot.values import Issue, counted

RAW_LASERS = tuple(f"RAWLASER{number}" for number in range(1, 6))  # Scans without a pose, by the number of the laser
TAILS = {"FLASER": (6, 7, 9), "ROBOTLASER1": (14,), **dict.fromkeys(RAW_LASERS, (3,))}
"""How many words may follow the ranges (and remissions); all lines of a log have as many."""
STAMPS = {6: (), 7: (6,), 9: (6, 8), 14: (11, 13), 3: (0, 2)}  # Which of these words are the ipc stamp and the logger's
REAR_LASERS = ("RLASER", "ROBOTLASER2")  # Scans of a laser that looks back: counted, not read
MAX_INTERLACE = 8  # Bearings of the grid in a step between beams, at most; a SICK LMS has 2 or 4
SAME_ANGLE = 1e-4  # First angles are taken for those of the grid when they are this near [rad]; logs have six digits
FULL, FEWEST = 360, 20  # Beams of a lidar that may see a full circle, at least, and scans to tell it by
FAN = ("beams", "angle_min", "step")
ROW = np.dtype(
    [(name, "f8") for name in ("number", *FAN, "stated")]
    + [(name, "f8", 3) for name in ("laser", "robot")]
    + [(name, "f8") for name in ("ipc", "logger")]
)
"""Of a scan: line, beams, first angle and step [rad], stated limit [m], poses [m, rad] and stamps [s]; 0 if unknown."""
FLAT = ROW.itemsize // 8  # Numbers in a row
Rows = NDArray[np.void]

_LINE = re.compile(rb"^(?:FLASER|ROBOTLASER1|RAWLASER[1-5]|ODOM|PARAM)\s", re.MULTILINE)
_LIMITS = ("robot_front_laser_max", "robot_frontlaser_max", "laser_front_max_range", "front_laser_max")
_ASIDE = 0.5  # What moves aside by less in all [m] may be rounded
_SAME = 0.005  # Mounts of logged poses that differ by less [m, rad] are one


def is_carmen(path: Path) -> bool:
    """Whether a file, plain or gzip, begins like a CARMEN log: with a line of a known kind in its first 256 KiB."""
    return _LINE.search(TextLines(path).head()) is not None


def read_carmen(path: str | PathLike[str], sequence: str | int | None = None, platform: Robot = None) -> Recording:
    """Read a CARMEN log; its stamps are the ``ipc_timestamp``, the logger's where every ipc stamp is 0."""
    expect_no_sequence(path, sequence)
    path, given = Path(path), GivenRobot.read(platform)
    log = _Lines(TextLines(path))
    used = len(log.odometry) // 5 + sum(len(rows) for _, rows in log.scans.values()) // FLAT
    issues = log.lines.issues(used, "no FLASER, ROBOTLASER1 or ODOM line, expected a CARMEN log")
    laser = _chosen(path, log, issues)
    rows = np.zeros(0, ROW) if laser is None else laser.rows[laser.begins >= 0]
    odometry = np.array(log.odometry, np.float64).reshape(-1, 5)
    if laser and log.tails[laser.line] == 6:
        rows["ipc"] = np.arange(len(rows))
        issues.append(Issue("no-stamps", f"{path.name}: FLASER lines without stamps; one second a scan is assumed"))
        if len(odometry):
            text = f"{path.name}: {counted(len(odometry), 'ODOM line')} left aside, on another clock than the scans"
            issues.append(Issue("other-clock", text, len(odometry)))
        odometry = odometry[:0]
    is_ipc = bool(rows["ipc"].any() or odometry[:, 3].any())
    has_poses = laser is not None and laser.line not in RAW_LASERS
    clock, moved = "ipc" if is_ipc else "logger", odometry[:, 3 if is_ipc else 4]
    if laser and has_poses and _exchanged(rows, odometry, moved, clock):
        rows["laser"], rows["robot"] = rows["robot"].copy(), rows["laser"].copy()
        by = "ODOM lines" if len(odometry) > 1 else "way in which wheels roll"
        text = f"{path.name}: poses of robot and laser exchanged in {laser.line} lines, by the {by}: put right"
        issues.append(Issue("exchanged-poses", text, len(rows)))
    size = {key: log.params[f"robot_{key}"] for key in ("length", "width") if log.params.get(f"robot_{key}", 0) > 0}
    mount = _mount(log.params, rows if has_poses else rows[:0])
    if is_backwards := mount.get("time_increment", 0.0) < 0:  # of a lidar that turns clockwise
        mount["time_increment"] *= -1
    robot = given.over(platform_of({"name": CARMEN.name, **size, "lidar": mount}, file=path))
    sensors = Sensors(robot, given.lidar_figures, issues)
    lidar = None
    if laser is not None:
        ranges = _on_grid(laser, np.frombuffer(log.scans[laser.line][0], np.float32))
        if not (limit := given.lidar_figures.get("range_max")):
            params = (log.params[key] for key in _LIMITS if log.params.get(key, 0) > 0)
            stated = next(params, float(rows["stated"][0]) or None)
            limit = no_return_limit(ranges if laser.interlace == 1 else ranges[ranges > 0], stated)
        fan = Fan(laser.angle_min, laser.step, 0.0, float(limit), ranges.shape[1])
        if is_backwards:
            fan, ranges = fan.reversed(), ranges[:, ::-1]
        poses = rows["robot"] if has_poses else None
        lidar = sensors.lidar(path, laser.line, rows[clock], ranges, fan, poses, laser.interlace)
        beams = ranges.shape[1]
        circle = beams >= FULL and _closes(ranges)
        usual = beams in CLASSIC_STEPS and not circle
        if laser.line == "FLASER" and not usual and "angle_increment" not in given.lidar_figures:
            text = f"{path.name}: FLASER lines state no angles: {beams} beams are assumed to span 180 degrees. Of "
            text += "another lidar the map is wrong: give [lidar] angle_min and angle_increment by --platform"
            if circle:
                step = 2 * math.pi / (beams // 2 * 2)
                text += f", as the first and last beam agree those of a full circle, -3.14159 and {step:.7f}"
            issues.append(Issue("assumed-angles", text, len(lidar)))
    name = re.sub(r"(\.log|\.clf)?(\.gz)?$", "", path.name) or path.name
    moves = sensors.odometry(path, "ODOM", moved, odometry[:, :3])
    return Recording(name, robot, lidar, odometry=moves, warnings=tuple(issues))


class _Lines:
    """What the lines of a log say; comments and other kinds of line are passed over, broken ones counted."""

    def __init__(self, lines: TextLines) -> None:
        self.lines = lines
        self.scans: dict[str, tuple[array[float], array[float]]] = {}  # by kind of line: ranges [m] and `ROW`s, flat
        self.odometry = array("d")  # [n * 5]: x y theta [m, rad], ipc and logger stamp [s]
        self.params: dict[str, float] = {}  # as stated last
        self.rear: Counter[str] = Counter()  # by kind of line
        self.tails: dict[str, int] = {}  # words after the ranges of the first whole line of a kind, and so of all
        parsers: dict[str, Any] = {"ODOM": self._odom, "PARAM": self._param, **dict.fromkeys(TAILS, self._scan)}
        parsers |= dict.fromkeys(REAR_LASERS, lambda words, _: self.rear.update([words[0].decode()]))
        known = {kind.encode(): parse for kind, parse in parsers.items()}
        starts = {kind[:1] for kind in known} | {b" ", b"\t"}
        for number, line in lines:
            if line[:1] == b"\0":  # what a file system leaves of a log after a crash
                lines.drop(number, "begins with NUL bytes, expected text")
            elif line[:1] in starts:  # most lines of other kinds are passed over without being split
                words = line.split()
                if words and (parse := known.get(words[0])):
                    try:
                        parse(words, number)
                    except (ValueError, OverflowError) as error:
                        lines.drop(number, str(error))

    def _scan(self, words: list[bytes], number: int) -> None:
        line = words[0].decode()
        is_raw = line in RAW_LASERS
        begin = 2 if line == "FLASER" else 9
        after = end = begin + _count_at(words, begin - 1, "ranges")
        angle_min, step, stated = *fov_of(end - begin), 0.0
        if line != "FLASER":
            after += 1 + _count_at(words, end, "remissions", least=0)
            angle_min, _, step, stated = _numbers(words[2:6])
        tail = words[after:]
        count = self.tails.get(line) or (len(tail) if len(tail) in TAILS[line] else TAILS[line][-1])
        _expect_words(words, after + count, f"{end - begin} ranges")
        if step == 0:
            raise ValueError("angular resolution 0, expected more rad, or less of a lidar that turns clockwise")
        stamps = [tail[k] for k in STAMPS[count]]
        row = [number, end - begin, angle_min, step, max(stated, 0.0)]
        row += [*[0.0] * 6 * is_raw, *_placed([] if is_raw else tail[:6], stamps)]
        ranges = array("f", _numbers(words[begin:end], finite=False))
        self.tails[line] = count
        all_ranges, rows = self.scans.setdefault(line, (array("f"), array("d")))
        all_ranges.extend(ranges)
        rows.extend(row)

    def _odom(self, words: list[bytes], number: int) -> None:
        _expect_words(words, 10, "odometry")
        self.odometry.extend(_placed(words[1:4], [words[7], words[9]]))

    def _param(self, words: list[bytes], number: int) -> None:
        if len(words) > 2:
            with suppress(ValueError):  # most parameters of a robot are words
                self.params[words[1].decode("ascii", "replace")] = _numbers(words[2:3])[0]


def _expect_words(words: list[bytes], count: int, what: str) -> None:
    if len(words) != count:
        raise ValueError(f"{len(words)} words, expected {count} for {what}")


def _count_at(words: list[bytes], at: int, what: str, *, least: int = 1) -> int:
    """The number of things that a line declares in the word at an index."""
    word = words[at][:20] if len(words) > at else b""
    if not word.isdigit() or int(word) < least:
        raise ValueError(f"{word.decode('ascii', 'replace')!r}, expected the number of {what} at word {at + 1}")
    return int(word)


def _placed(poses: list[bytes], stamps: list[bytes]) -> list[float]:
    """Poses x y theta [m, rad], three words each, and the ipc and the logger stamp [s], else 0."""
    values, (ipc, logger) = _numbers(poses), _numbers([*stamps, b"0", b"0"][:2])
    if any(abs(value) > MAX_PLACE for value in values):
        raise ValueError(f"pose beyond {MAX_PLACE:.0f} m or rad, expected a robot's")
    if abs(ipc or logger) > MAX_STAMP:  # the first that is not 0 is what counts
        raise ValueError(f"stamp {ipc or logger:.6g}, expected seconds below 1e11")
    return [*values, ipc, logger]


def _numbers(words: list[bytes], *, finite: bool = True) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError:
        raise ValueError("a word that is not a number, expected numbers") from None
    if finite and not all(map(math.isfinite, values)):
        raise ValueError("NaN or infinite pose or stamp, expected finite numbers")
    return values


class _Laser(NamedTuple):
    """The scans of one kind of line, on a grid of bearings."""

    line: str
    rows: Rows  # [n] of `ROW`
    begins: NDArray[np.intp]  # [n] the first beam on the grid; -1 for scans of another lidar
    angle_min: float  # of the grid, as its step [rad]
    step: float
    interlace: int  # of that many neighbouring beams a scan measures one

    @property
    def scans(self) -> int:
        """How many are on the grid."""
        return int((self.begins >= 0).sum())


def _kinds(rows: Rows) -> tuple[Rows, NDArray[np.intp], NDArray[np.intp]]:
    """The first scans [k] of each number of beams, first angle and step, how many are alike, and of which kind [n]."""
    figures = np.column_stack([rows[name] for name in FAN])
    _, first, kinds, counts = np.unique(figures, axis=0, return_index=True, return_inverse=True, return_counts=True)
    order = np.argsort(first)
    return rows[first[order]], counts[order], np.argsort(order)[kinds.ravel()]


def _laser(line: str, rows: Rows) -> _Laser:
    """The scans of a kind of line: of the usual kind or, of an interlaced lidar, of several on one grid of bearings.

    A SICK LMS that measures every degree can begin each scan at another quarter or half of one, so that several scans
    together are four or two times as dense. Its log has that many kinds of scan in turns, which begin at different
    bearings of one grid, less than a step apart, and are otherwise alike: step, limit, and number of beams, give or
    take the one at the end.
    """
    heads, counts, kinds = _kinds(rows)
    usual = int(np.argmax(counts))
    beams, angle_min, step = heads[list(FAN)][usual].item()
    most_others = max(MAX_DROPPED, counts[usual] // 10)
    alike = (heads["stated"] == heads["stated"][usual]) & (np.abs(heads["beams"] - beams) <= 1)
    alike &= np.abs(heads["angle_min"] - angle_min) < abs(step) - SAME_ANGLE
    alike &= np.abs(heads["step"] - step) * beams < SAME_ANGLE
    if counts[alike].sum() - counts[usual] > most_others:
        for interlace in range(2, MAX_INTERLACE + 1):
            off = (heads["angle_min"] - angle_min) * interlace / step
            begins = np.rint(off).astype(np.intp)
            fits = alike & (np.abs(off - begins) * abs(step) / interlace < SAME_ANGLE)
            begins -= begins[fits].min()
            if counts[alike & ~fits].sum() <= most_others and begins[fits].max() < interlace:
                first = float(heads["angle_min"][fits & (begins == 0)].min())
                return _Laser(line, rows, np.where(fits, begins, -1)[kinds], first, step / interlace, interlace)
    return _Laser(line, rows, np.where(kinds == usual, 0, -1), angle_min, step, 1)


def _on_grid(laser: _Laser, flat: NDArray[np.float32]) -> NDArray[np.float32]:
    """The ranges [m, beams] of the scans on the grid; 0, an invalid range, at the beams that a scan lacks."""
    beams = laser.rows["beams"].astype(np.intp)
    stops = laser.begins + laser.interlace * (beams - 1) + 1
    used = laser.begins >= 0
    ranges = np.zeros((laser.scans, stops[used].max()), np.float32)
    places = np.column_stack((laser.begins, stops, np.cumsum(beams) - beams, np.cumsum(beams)))[used]
    for scan, (begin, stop, first, last) in zip(ranges, places.tolist(), strict=True):
        scan[begin : stop : laser.interlace] = flat[first:last]
    return ranges


def _chosen(path: Path, log: _Lines, issues: list[Issue]) -> _Laser | None:
    """The kind of line with most scans (of equals, the one that states its angles); others are left aside.

    Raw scans are read if no scan has a pose: logs that have both hold the same ranges in them.
    """
    for line, count in log.rear.items():
        text = f"{path.name}: {counted(count, f'{line} scan')} of a rear laser left aside"
        issues.append(Issue("other-scans", text, count))
    lines = [line for line in log.scans if line not in RAW_LASERS] or log.scans
    lasers = [_laser(line, np.frombuffer(log.scans[line][1], ROW)) for line in lines]
    best = max(lasers, key=lambda one: (one.scans, one.line == "ROBOTLASER1"), default=None)
    for laser in lasers:
        others = laser.rows[laser.begins < 0] if laser is best else laser.rows
        for head, count in zip(*_kinds(others)[:2], strict=True):
            scans = counted(int(count), f"{laser.line} scan")
            if laser is best and count > max(MAX_DROPPED, laser.scans // 10):
                usual = _words(laser.rows[laser.begins >= 0][0])
                problem = f"{scans} of {_words(head)}, expected {usual} as in the other {laser.scans}"
                raise InputError(problem, file=path, line=int(head["number"]))
            beams = counted(int(head["beams"]), "beam")
            text = f"{path.name}: {scans} of {beams} left aside, the first is line {int(head['number'])}"
            issues.append(Issue("other-scans", text, int(count)))
    return best


def _words(head: np.void) -> str:
    return f"{counted(int(head['beams']), 'beam')} every {head['step']:.4f} rad from {head['angle_min']:.4f} rad"


def _closes(ranges: NDArray[np.float32]) -> bool:
    """Whether the first and the last beam of scans [m, beams] see the same: a circle, not the two sides of a robot."""
    ends = ranges[:, [0, 1, -1]].astype(float)
    first, beside, last = ends[np.isfinite(ends).all(axis=1) & (ends > 0).all(axis=1)].T
    if len(first) < FEWEST:
        return False
    varies, apart, differ = (np.median(np.abs(first - other)) for other in (np.median(first), beside, last))
    return bool(differ < varies / 6 and differ < 6 * apart)


def _exchanged(rows: Rows, odometry: NDArray[np.float64], stamps: NDArray[np.float64], clock: str) -> bool:
    """Whether the robot is by ODOM lines [m, 5] [m] where the laser is logged, and not where it is logged itself.

    Without such lines, whether the laser alone moves the way that it faces, as the middle between two wheels does.
    """
    if len(odometry) < 2:
        steps = (se2.between(rows[who][:-1], rows[who][1:]).T for who in ("robot", "laser"))
        robot, laser = (float(np.abs(y * np.cos(turn / 2) - x * np.sin(turn / 2)).sum()) for x, y, turn in steps)
        return robot > _ASIDE + 4 * laser
    order = np.argsort(stamps, kind="stable")
    at = se2.interpolate(stamps[order], odometry[order, :3], rows[clock])[:, :2]
    robot, laser = (float(np.median(np.abs(at - rows[who][:, :2]).max(axis=1))) for who in ("robot", "laser"))
    return robot > _SAME + 4 * laser


def _mount(params: dict[str, float], rows: Rows) -> dict[str, float]:
    """The lidar's pose on the robot: from parameters; else from logged poses, where 99 % of them agree; else 0."""
    for prefix in ("robot_frontlaser", "frontlaser", "robot_front_laser", "front_laser"):
        if f"{prefix}_offset" in params:
            sideways, turned = (params.get(f"{prefix}_{key}_offset", 0.0) for key in ("side", "angular"))
            more = {field: params[name] for field, name in OWN_PARAMETERS.items() if name in params}
            return {"x": params[f"{prefix}_offset"], "y": sideways, "yaw": turned, **more}
    if not len(rows):
        return {}
    mounts = se2.between(rows["robot"], rows["laser"])
    middle = np.median(mounts, axis=0)
    apart = np.abs(np.column_stack((mounts[:, :2] - middle[:2], se2.wrap(mounts[:, 2] - middle[2]))))
    if np.quantile(apart.max(axis=1), 0.99) >= _SAME:
        return {}
    x, y, yaw = np.round(middle, 6).tolist()  # logs have six digits
    return {"x": x, "y": y, "yaw": yaw}


FORMAT = Format(
    "CARMEN log (FLASER, ROBOTLASER1, RAWLASER1, ODOM lines; plain or gzip)",
    is_folder=False,
    recognise=is_carmen,
    read=read_carmen,
    write=write_carmen,
    endings=(".log", ".log.gz", ".clf", ".clf.gz"),
)
