"""Trajectories that are not what they seem: each is told with what it means, or refused; sound ones are silent."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_lines import Capsys, codes, refused, shown, told
from scipy.spatial.transform import Rotation

from moteslam.eval.metrics.clocks import clock_offset
from moteslam.robot.trajectories import read_trajectory
from moteslam.robot.trajectory import Trajectory

T0 = 1300000000.0
XYZ = slice(1, 4)
Table = np.ndarray  # [n, 8] t x y z qx qy qz qw
Change = Callable[[Table], Table]


def drive(period: float, noise: float = 0.0, *, length: float = 120.0) -> Table:
    """A robot that winds its way at 0.3 m/s, stands for a while and goes on."""
    t = np.arange(0.0, length, period)
    moved = 0.3 * (t - np.clip(t - 30, 0, 10))
    fine = np.linspace(0, moved[-1], 20000)
    heading = 1.1 * np.sin(0.4 * fine) + 0.17 * fine
    path = np.cumsum(np.column_stack((np.cos(heading), np.sin(heading))) * (fine[1] - fine[0]), axis=0)
    x, y, h = (np.interp(moved, fine, column) for column in (*path.T, heading))
    rng, table = np.random.default_rng(0), np.zeros((len(t), 8))
    table[:, :3] = np.column_stack((T0 + t, x + noise * rng.normal(size=len(t)), y + noise * rng.normal(size=len(t))))
    table[:, 6:] = np.column_stack((np.sin(h / 2), np.cos(h / 2)))
    return table


def write(path: Path, table: Table, stamps: str = "%.9f", header: str = "", separator: str = " ") -> str:
    lines = [separator.join((stamps % row[0], *(f"{value:.9f}" for value in row[1:]))) for row in table]
    path.write_text("\n".join(([header] if header else []) + lines) + "\n")
    return str(path)


def files_of(folder: Path, estimate: Change, reference: Change) -> tuple[str, str]:
    """A noisy, sparse estimate and a dense reference of one drive, changed."""
    tables = estimate(drive(0.2, 0.005)), reference(drive(0.02))
    return write(folder / "est.tum", tables[0]), write(folder / "ref.tum", tables[1])


def changed(change: Callable[[Table], object]) -> Change:
    def made(table: Table) -> Table:
        table = table.copy()
        found = change(table)
        return found if isinstance(found, np.ndarray) else table

    return made


def put(rows: slice, columns: slice | int, value: object) -> Change:
    return changed(lambda table: table.__setitem__((rows, columns), value))


def scaled(column: slice | int, factor: float) -> Change:
    return changed(lambda table: table.__setitem__((slice(None), column), table[:, column] * factor))


def held(count: int) -> Change:
    return changed(lambda t: t.__setitem__((slice(None), slice(1, 8)), t[np.arange(len(t)) // count * count, 1:]))


def filled(first: int, last: int) -> Change:
    """Straight from row to row."""
    rows = slice(first, last), slice(1, 3)
    return changed(lambda t: t.__setitem__(rows, np.linspace(t[first, 1:3], t[last, 1:3], last - first)))


def late(columns: slice, rows: int) -> Change:
    return changed(lambda t: t.__setitem__((slice(rows, None), columns), t[:-rows, columns].copy()))


def rounded(step: float) -> Change:
    return changed(lambda table: table.__setitem__((slice(None), 0), np.floor(table[:, 0] / step) * step))


def clocked(rate: float, offset: float = 0.0) -> Change:
    return changed(lambda t: t.__setitem__((slice(None), 0), T0 + rate * (t[:, 0] - T0) + offset))


def flipped(table: Table) -> Table:
    """For a while with the back ahead, as with markers that are exchanged."""
    there = np.abs(table[:, 0] - T0 - 60) < 5
    table = table.copy()
    table[there, 6:] = np.column_stack((table[there, 7], -table[there, 6]))
    return table


def same(table: Table) -> Table:
    return table


def twice(table: Table) -> Table:
    return np.repeat(table, 2, axis=0)


def wxyz(table: Table) -> Table:
    return table[:, [0, 1, 2, 3, 7, 4, 5, 6]]


def sideways(table: Table) -> Table:
    """In axes of a body that is turned by 90 degrees."""
    return np.column_stack((table[:, :4], (Rotation(table[:, 4:]) * Rotation.from_euler("z", np.pi / 2)).as_quat()))


def between(begin: float, end: float) -> Change:
    return changed(lambda table: table[(table[:, 0] >= T0 + begin) & (table[:, 0] < T0 + end)])


def without(begin: float, end: float) -> Change:
    return changed(lambda table: table[(table[:, 0] < T0 + begin) | (table[:, 0] >= T0 + end)])


def halfway(table: Table) -> Table:
    """With headings between two poses where they pass 180 degrees."""
    heading = 2 * np.arctan2(table[:, 6], table[:, 7])
    wrapped = np.mod(heading + np.pi, 2 * np.pi) - np.pi
    at = np.flatnonzero(np.abs(np.diff(wrapped)) > np.pi)
    assert len(at)
    table = table.copy()
    half = (wrapped[at] + wrapped[at + 1]) / 4
    table[at, 6:] = np.column_stack((np.sin(half), np.cos(half)))
    return table


def along_a_line(table: Table) -> Table:
    """The same stamps at an even speed."""
    line = np.zeros_like(table)
    line[:, 0], line[:, 1], line[:, 7] = table[:, 0], 0.3 * (table[:, 0] - T0), 1.0
    line[:, 2] = 0.005 * np.random.default_rng(1).normal(size=len(table)) * (len(table) < 1000)
    return line


def inverted(table: Table) -> Table:
    """Poses of the world in the body; a tilted body."""
    body = Rotation.from_quat(table[:, 4:])
    return np.column_stack((table[:, 0], -body.inv().apply(table[:, 1:4]), body.inv().as_quat()))


def elsewhere(table: Table) -> Table:
    """In a frame of its own, as SLAM's."""
    turn = Rotation.from_euler("z", 2.0)
    poses = turn.apply(table[:, 1:4] + (5.0, -3.0, 0.0)), (turn * Rotation(table[:, 4:])).as_quat()
    return np.column_stack((table[:, 0], *poses))


def tilted(table: Table) -> Table:
    """The same drive on a slope."""
    slope = Rotation.from_rotvec((0.5, 0.0, 0.0))
    body = slope * Rotation.from_quat(table[:, 4:])
    return np.column_stack((table[:, 0], slope.apply(table[:, 1:4]), body.as_quat()))


def at_another_time(table: Table) -> Table:
    """Of a robot that goes the same way, now faster and now slower."""
    since = table[:, 0] - T0
    return np.column_stack((table[:, 0] + 2 * np.sin(since / 3), table[:, 1:]))


def increments(table: Table) -> Table:
    """The motion since the pose before."""
    body, steps = Rotation.from_quat(table[:, 4:]), np.diff(table[:, 1:4], axis=0)
    turns = (body[:-1].inv() * body[1:]).as_quat()
    return np.column_stack((table[1:, 0], body[:-1].inv().apply(steps), turns))


def shaken(columns: slice, deviation: float) -> Change:
    """With noise of some columns, in the order of the stamps."""

    def shake(table: Table) -> None:
        table[:, columns] += deviation * np.random.default_rng(0).normal(size=table[:, columns].shape)
        table[:] = table[np.argsort(table[:, 0])]

    return changed(shake)


def aside(far: float) -> Change:
    def moved(table: Table) -> None:
        table[np.abs(table[:, 0] - T0 - 48.0) < 4.0, 1] += far

    return changed(moved)


def without_a_gap(table: Table) -> Table:
    """The robot drives on while nothing is estimated, and the path goes on where it ended."""
    table, (first, last) = table.copy(), np.searchsorted(table[:, 0], (T0 + 60.0, T0 + 65.0))
    table[last:, 1:3] -= table[last, 1:3] - table[first - 1, 1:3]
    return np.delete(table, np.s_[first:last], axis=0)


@pytest.mark.parametrize(("whose", "begin"), [("estimate", 0.8), ("reference", 0.95)])
def test_a_run_that_got_lost_in_its_last_lap_is_not_on_another_clock(
    tmp_path: Path, capsys, whose: str, begin: float
) -> None:
    """Moved by a lap, the part where it is lost has no partner."""
    t = np.arange(0.0, 160.0, 0.1)
    turn = 2 * np.pi * t / 40
    truth = np.zeros((len(t), 8))
    truth[:, 0], truth[:, 1], truth[:, 2] = T0 + t, 4 * np.cos(turn) + 0.5 * np.cos(3 * turn), 3 * np.sin(turn)
    truth[:, 7] = 1.0
    run, k = truth[::2].copy(), int(begin * len(truth) / 2)
    run[:, 1:3] += 0.005 * np.random.default_rng(0).normal(size=(len(run), 2))
    run[k:, 1:3] += (3.0, 2.0)
    tables = (run, truth) if whose == "estimate" else (truth, run)
    files = [write(tmp_path / f"{name}.tum", table) for name, table in zip("ab", tables, strict=True)]
    assert "clocks-differ" not in codes(capsys, "evaluate", *files)


@pytest.mark.parametrize(
    ("estimate", "reference", "expected"),
    [
        (same, same, []),
        (lambda t: scaled(1, 0.995)(along_a_line(t)), along_a_line, []),  # nothing tells a scale from a rate
        (lambda t: scaled(1, 0.95)(along_a_line(t)), along_a_line, ["sizes-differ"]),
        (inverted, same, ["poses-inverted"]),
        (elsewhere, inverted, ["poses-inverted"]),
        (lambda t: inverted(tilted(t)), tilted, ["in-space", "poses-inverted"]),
        (twice, twice, []),
        (scaled(2, -1.0), scaled(2, -1.0), ["orientation-order"] * 2),  # mirrored alike, but for the headings
        (rounded(16), same, ["equal-stamps", "few-matched"]),
        (same, rounded(1.0), ["equal-stamps"]),
        (rounded(0.125), same, ["equal-stamps"]),
        (same, put(slice(1500, 1750), slice(1, 4), 0.0), ["poses-held"]),
        (same, lambda t: put(slice(2500, 2750), slice(1, 8), t[2500, 1:])(t), ["poses-held"]),
        (same, held(100), ["poses-held"]),
        (same, filled(2500, 2900), ["poses-held"]),
        (same, filled(1500, 3000), ["poses-held"]),  # half of all errors are of the fit
        (filled(200, 300), same, ["poses-held"]),
        (same, changed(lambda t: t.__setitem__((slice(None), 1), t[:, 1].clip(max=2.0))), ["poses-held"]),
        (same, shaken(slice(1, 3), 0.03), ["reference-noise"]),
        (shaken(slice(1, 3), 0.03), same, []),  # of an estimate it is an error
        (shaken(slice(0, 1), 0.1), same, ["stamps-jitter"]),
        (lambda t: shaken(slice(0, 1), 0.1)(t)[::20], same, []),  # so far apart an estimate drifts by as much
        (same, late(slice(4, 8), 15), ["clocks-differ"]),
        (same, lambda t: t[::300], []),  # sparse: between its poses an offset seems to fit
        (same, changed(lambda t: t.__setitem__((slice(None), 2), np.rint(2 * t[:, 2]) / 2)), ["positions-rounded"]),
        (changed(lambda t: t.__setitem__((slice(None), slice(1, 3)), t[:, 1:3].round(2))), same, []),
        (lambda t: np.hstack((t[::9, :1], t[::9, 1:3].round(1), t[::9, 3:])), same, ["positions-rounded"] * 2),
        (wxyz, same, ["orientation-order", "body-axes"]),
        (wxyz, wxyz, ["orientation-order", "orientation-order", "in-space"]),
        (sideways, same, ["body-axes"]),
        (same, scaled(XYZ, 1000.0), ["implausible-speed", "sizes-differ"]),
        (scaled(XYZ, 1000.0), scaled(XYZ, 1000.0), ["implausible-speed"] * 2),
        (same, put(slice(2501, 2502), 1, 100.0), ["implausible-speed"]),  # between stamps of the estimate
        (put(slice(100, 101), 1, 100.0), same, ["implausible-speed"]),
        (same, aside(1.0), ["implausible-speed"]),
        (same, aside(0.3), ["implausible-speed"]),
        (same, aside(0.15), ["implausible-speed"]),  # too short for a jump
        (aside(0.3), same, []),  # of an estimate it is an error
        (without_a_gap, same, []),  # likewise
        (same, flipped, ["implausible-speed"]),
        (halfway, same, ["implausible-speed"]),
        (put(slice(330, 331), slice(4, 8), np.sqrt([0.0, 0.0, 0.5, 0.5])), same, []),  # 90 degrees, not halfway
        (flipped, same, []),  # an estimate may find itself elsewhere
        (scaled(XYZ, 1e-5), scaled(XYZ, 1e-5), ["sizes-differ", "no-relative-error"]),
        (scaled(XYZ, 0.95), same, ["sizes-differ"]),
        (clocked(1.01), same, ["clocks-differ"]),
        (clocked(1.0, 18.0), same, ["clocks-differ"]),
        (same, between(40, 48), ["few-matched"]),
        (between(0, 50), same, ["few-matched"]),
        (without(60, 80), same, ["few-matched"]),
        (same, without(60, 80), ["few-matched"]),
        (without(20, 22), same, []),
        (between(5, 100), same, []),
        (between(40, 40.4), same, ["few-matched", "no-relative-error"]),
    ],
)
def test_what_evaluate_says(tmp_path: Path, capsys, estimate, reference, expected: list[str]) -> None:
    assert codes(capsys, "evaluate", *files_of(tmp_path, estimate, reference)) == expected


OPTICAL = Rotation.from_matrix(((0, 0, 1), (-1, 0, 0), (0, -1, 0)))  # z ahead, y down, in the axes of the base


def at_arm(*arm: float) -> Change:
    """The path of another point of the robot."""
    return changed(lambda t: t.__setitem__((slice(None), slice(1, 4)), t[:, 1:4] + Rotation(t[:, 4:]).apply(arm)))


def optical(table: Table) -> Table:
    """In the axes of a camera, of body and world."""
    body = OPTICAL.inv() * Rotation(table[:, 4:]) * OPTICAL
    return np.column_stack((table[:, 0], OPTICAL.inv().apply(table[:, 1:4]), body.as_quat()))


def wavy(table: Table) -> Table:
    """Up and down, tilted."""
    t, table = table[:, 0] - T0, table.copy()
    table[:, 3] = 0.3 * np.sin(0.2 * t)
    tilt = Rotation.from_rotvec(0.2 * np.column_stack((np.sin(0.5 * t), np.cos(0.3 * t), 0 * t)))
    return np.column_stack((table[:, :4], (Rotation(table[:, 4:]) * tilt).as_quat()))


def chain(*changes: Callable[[Table], Table]) -> Change:
    def made(table: Table) -> Table:
        for change in changes:
            table = change(table)
        return table

    return made


def turned(factor: float, offset: float = 0.0) -> Change:
    """Headings multiplied by a factor, and turned [degrees]."""

    def made(table: Table) -> Table:
        half = factor * np.unwrap(2 * np.arctan2(table[:, 6], table[:, 7])) / 2 + np.deg2rad(offset) / 2
        return np.column_stack((table[:, :6], np.sin(half), np.cos(half)))

    return made


positions_only = put(slice(None), slice(4, 8), 0.0)
STILL, FAR = put(slice(None), slice(1, 3), 0.0), put(slice(-1, None), 1, 9e8)
LATE_PRISM = chain(at_arm(0.2, 0.1, 0), clocked(1.0, 0.6), positions_only)
ARM, CAMERA = ["no-orientation", "lever-arm"], ["in-space", "lever-arm", "body-axes"]


@pytest.mark.parametrize(
    ("estimate", "reference", "expected", "arm", "mend"),
    [
        (at_arm(0.3, 0, 0), same, ["lever-arm"], (-0.3, 0, 0), "--est-offset"),
        (chain(at_arm(0.3, 0, 0.2), optical), same, CAMERA, (0, 0, -0.3), "add it"),
        (chain(at_arm(0.1, 0, 0.2), optical), same, CAMERA, (0, 0, -0.1), "add it"),
        (at_arm(0.3, 0, 0), optical, CAMERA, (-0.3, 0, 0), "--est-offset"),
        (chain(wavy, at_arm(0.2, -0.1, 0.3)), wavy, ["in-space", "lever-arm"], (-0.2, 0.1, -0.3), "add it"),
        *(
            (same, chain(at_arm(-0.25, 0.1, 0), positions_only, thinned), ARM, (-0.25, 0.1, 0), "(--est-offset")
            for thinned in (changed(lambda t, n=n: t[::n]) for n in (1, 250))
        ),
        (positions_only, at_arm(0.2, 0.1, 0), ARM, (-0.2, -0.1, 0), "exchange the files"),
    ],
)
def test_another_point_of_the_robot_is_told(
    tmp_path: Path, capsys, estimate, reference, expected: list[str], arm: tuple[float, ...], mend: str
) -> None:
    """The offset on the robot is found, in the axes of the body that has orientations, and mends the error."""
    tables = estimate(drive(0.2, 0.005)), reference(drive(0.02))
    files = [write(tmp_path / f"{k}.tum", table) for k, table in enumerate(tables)]
    result = shown(capsys, "evaluate", *files)
    assert [issue["code"] for issue in result["warnings"]] == expected
    [message] = [issue["message"] for issue in result["warnings"] if issue["code"] == "lever-arm"]
    found = re.search(r"x (\S+) m, y (\S+) m(?:, z (\S+) m)? on the robot", message)
    assert [float(value or 0) for value in found.groups()] == pytest.approx(arm, abs=0.01)
    assert mend in message
    mended = int("exchange" in mend)
    files[mended] = write(tmp_path / "mended.tum", at_arm(*arm)(tables[mended]))
    after = shown(capsys, "evaluate", *files)["ate"]["translation_m"]["rmse"]
    assert after < 0.012 < 0.06 < result["ate"]["translation_m"]["rmse"]


@pytest.mark.parametrize(
    ("estimate", "reference", "expected", "words"),
    [
        (at_another_time, same, ["unlike"], ("another drive",)),
        (increments, same, ["unlike"], ("increments",)),
        (clocked(1.01), same, ["clocks-differ"], ("its clock runs 0.99 % fast",)),
        (same, clocked(0.998), ["clocks-differ"], ("its clock runs 0.20 % fast",)),
        (clocked(1.0, 0.7), same, ["clocks-differ"], ("in its file or by evaluate --time-offset -0.7",)),
        (lambda _: clocked(1.0, 0.3)(drive(0.2, 0.03)), same, ["clocks-differ"], ("--time-offset -0.3",)),
        (chain(between(45, 120), clocked(1.0, 0.3)), between(45, 120), ["lever-arm"], ("--est-offset 0.0", "or else")),
        (chain(positions_only, clocked(1.0, 0.7)), positions_only, [*ARM[:1] * 2, "clocks-differ"], ("or this is",)),
        (chain(at_arm(0.3, 0, 0), positions_only), positions_only, ARM[:1] * 2, ()),
        (same, LATE_PRISM, [*ARM[:1], "clocks-differ"], ("moved by +0.599 s, the point at x 0.200 m, y 0.100 m",)),
        (same, chain(LATE_PRISM, changed(lambda t: t[::100])), [*ARM[:1], "clocks-differ"], ("the point at x 0.20",)),
        (same, turned(0.9), ["body-axes"], ("those of the reference are as if multiplied by 0.9;",)),
        (turned(180 / np.pi), same, ["body-axes"], ("those of the estimate are as if in degrees, taken for radians;",)),
        (same, turned(1.0, 8.0), ["body-axes"], ("orientations differ by 8 degrees, directions by",)),
        (same, scaled(2, 1.05), ["sizes-differ"], ("stretched by 1.05 along 90 degrees of the reference's axes",)),
        (chain(scaled(1, 1.04), sideways), same, ["sizes-differ", "body-axes"], ("stretched by 0.96",)),
        (late(slice(1, 2), 15), same, ["unlike"], ("where headings agree: x and y of other rows",)),
        (scaled(XYZ, 100.0), same, ["sizes-differ"], ("multiply the estimate's positions by 0.01 (cm as m):",)),
        (same, scaled(XYZ, 3.28), ["sizes-differ"], ("multiply the reference's positions by 0.3048 (feet as m):",)),
        (scaled(XYZ, 0.95), same, ["sizes-differ"], ("with the estimate's positions multiplied by 1.053 the",)),
        (
            sideways,
            same,
            ["body-axes"],
            ("as a camera's (turn them to x ahead, y left, z up)", "the ATE of positions is not"),
        ),
        (wxyz, same, ["orientation-order", "body-axes"], ("as qw qx qy qz (put # t x y z qw qx qy qz first):",)),
    ],
)
def test_what_it_means_is_said(
    tmp_path: Path, capsys, estimate: Change, reference: Change, expected: list[str], words: tuple[str, ...]
) -> None:
    issues = shown(capsys, "evaluate", *files_of(tmp_path, estimate, reference))["warnings"]
    assert [issue["code"] for issue in issues] == expected
    messages = [issue["message"] for issue in issues]
    assert any(all(word in message for word in words) for message in messages)
    assert any("multiplied by" in message for message in messages) == any("multiplied by" in word for word in words)


@pytest.mark.parametrize("change", [same, lambda t: t - [0.0, *t[0, 1:4], 0.0, 0.0, 0.0, 0.0], lambda t: t[::7]])
def test_a_reference_that_is_the_estimate_is_told(tmp_path: Path, capsys, change) -> None:
    truth = drive(0.02)
    files = write(tmp_path / "est.tum", change(truth)), write(tmp_path / "ref.tum", truth)
    assert codes(capsys, "evaluate", *files) == ["same-path"]


def test_of_laps_that_fit_alike_on_clocks_without_a_common_time_the_nearest_is_taken() -> None:
    t, noise = np.arange(0.0, 160.0, 0.2), 0.08 * np.random.default_rng(0).normal(size=(800, 2))
    laps = np.column_stack((4 * np.cos(np.pi * t / 20), 3 * np.sin(np.pi * t / 20), np.zeros(800)))
    laps[:, :2] += 0.2 * np.column_stack((np.cos(np.pi * t / 5), np.zeros(800)))
    found = clock_offset(Trajectory(t, laps + np.column_stack((noise, t * 0))), Trajectory(T0 + t, laps))
    assert float(re.findall(r"moved by (\S+) s", found[1])[0]) == pytest.approx(T0, abs=0.1)


def test_stamps_in_few_digits_are_named_where_nothing_matches(tmp_path: Path, capsys) -> None:
    """The file whose stamps were rounded, not the other one."""
    files = write(tmp_path / "est.tum", drive(0.2, 0.005)[1:]), write(tmp_path / "ref.tum", drive(0.02), "%e")
    said = refused(capsys, "evaluate", *files)
    assert f"; {files[1]}: " in said
    assert "of 6000 poses have the stamp of the one before" in said
    assert "of 6000 poses have the stamp of the one before" in told(capsys, "convert", files[1], tmp_path / "out.tum")


@pytest.mark.parametrize(
    ("header", "factor", "expected"),
    [
        ("t,x,y,yaw", 1.0, []),
        ("t,x,y,yaw [deg]", 180 / np.pi, []),
        ("t,x,y,yaw [deg]", 1.0, ["orientation-order"]),
    ],
)
def test_headings_that_do_not_follow_the_path(tmp_path: Path, header: str, factor: float, expected: list[str]) -> None:
    table = drive(0.2)
    headings = factor * 2 * np.arctan2(table[:, 6], table[:, 7])
    path = write(tmp_path / "t.csv", np.column_stack((table[:, :3], headings)), header=header, separator=",")
    assert [issue.code for issue in read_trajectory(path).warnings] == expected


def test_legs_that_err_by_a_turn_or_noise_of_headings_are_no_stretch_and_no_other_unit(tmp_path: Path, capsys) -> None:
    corner = drive(0.02)
    corner[:, 1:3] = np.column_stack((np.minimum(corner[:, 0] - T0, 60), np.maximum(corner[:, 0] - T0 - 60, 0))) / 5
    bent = corner[::9].copy()
    bent[:, 1:3] += 0.04 * bent[:, 2:3] * (1.0, 0.0) + 0.003 * np.random.default_rng(0).normal(size=(len(bent), 2))
    assert "sizes-differ" not in codes(
        capsys, "evaluate", *(write(tmp_path / "a", bent), write(tmp_path / "b", corner))
    )
    table = drive(0.2, 0.005)
    noisy = np.column_stack(
        (table[:, :6], table[:, 6:] + 0.015 * np.random.default_rng(0).normal(size=(len(table), 2)))
    )
    for rough in (noisy, drive(0.2, 0.1)):
        assert not codes(capsys, "evaluate", *(write(tmp_path / "a", rough), write(tmp_path / "b", drive(0.02))))


def test_headings_in_degrees_are_not_taken_for_another_order(tmp_path: Path) -> None:
    """By another order a body on a straight way would turn over about an axis across it."""
    table = along_a_line(drive(0.2))
    half = np.rad2deg(0.05 * np.sin(table[:, 0] / 5)) / 2
    table[:, 6:] = np.column_stack((np.sin(half), np.cos(half)))
    assert not read_trajectory(write(tmp_path / "t.tum", table)).warnings


@pytest.mark.parametrize("order", [[0, 1, 2, 3, 7, 4, 5, 6], [0, 1, 2, 3, 4, 5, 6, 7]])
def test_euroc_without_names_says_which_order_follows_the_path(tmp_path: Path, order: list[int]) -> None:
    table = np.column_stack((drive(0.2)[:, order], np.zeros((600, 9))))
    path = write(tmp_path / "data.csv", table, separator=",")
    text = Path(path).read_text().splitlines()
    Path(path).write_text("\n".join(line.replace(".", "", 1) for line in text) + "\n")  # nanoseconds
    messages = [issue.message for issue in read_trajectory(path).warnings]
    assert "taken for qw qx qy qz" in messages[0]
    assert [("path as qx qy qz qw" in message) for message in messages[1:]] == ([] if order[4] == 7 else [True])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "time,x,y,yaw\n2011-03-13T07:06:40.1,0,0,0\n",
            "t.csv:2: t: '2011-03-13T07:06:40.1', expected a finite number",
        ),
        ("time,x,y,yaw\n20260101120000,0,0,0\n20260101120001,1,0,0\n", "t.csv:2: stamp taken for ms after 2286"),
        ("t,x,y,yaw\n0,0,5,0,25,0,1\n", "t.csv:2: 7 columns, expected 4"),
        ("1,5 0,1 0,2 0,0 0,0 0,0 0,0 1,0\n", "decimal commas need semicolons"),
        ("t [s] x y yaw std bias\n0 1 2 0 0 0\n", "t.csv:2: 6 columns, expected 7"),
    ],
)
def test_what_is_no_table_is_refused_by_its_column(tmp_path: Path, capsys, text: str, said: str) -> None:
    (tmp_path / "t.csv").write_text(text)
    assert said in refused(capsys, "convert", tmp_path / "t.csv", tmp_path / "out.tum")
    assert not (tmp_path / "out.tum").exists()


def test_another_building_is_no_other_scale(tmp_path: Path, capsys: Capsys) -> None:
    """Of a path with little in common the error falls by any scale that makes it small."""
    here = drive(0.2)
    there, since = here.copy(), here[:, 0] - T0
    aside = 0.6 * here[:, 1:3].std(axis=0).max() * np.column_stack((np.sin(since / 7), np.cos(since / 5)))
    there[:, 1:3] = 4 * (here[:, 1:3] + aside)
    assert codes(capsys, "evaluate", write(tmp_path / "a.tum", there), write(tmp_path / "b.tum", here)) == ["unlike"]


def test_the_file_that_is_tilted_is_named(tmp_path: Path, capsys) -> None:
    files = files_of(tmp_path, same, tilted)
    for given, named in ((files, files[1]), (files[::-1], files[1])):
        assert f"{named}: moves in a plane" in told(capsys, "evaluate", *given)


@pytest.mark.parametrize(("estimate", "reference"), [(STILL, STILL), (same, STILL), (STILL, same), (FAR, same)])
def test_a_robot_that_stands_or_is_far_away_is_scored(tmp_path: Path, capsys: Capsys, estimate, reference) -> None:
    shown(capsys, "evaluate", *files_of(tmp_path, estimate, reference))
