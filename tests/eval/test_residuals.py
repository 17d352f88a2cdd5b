"""Residuals of scans: walls with known noise, places that another scan did not see, and the command."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_lines import Capsys, printed, shown, told
from refusals import refusal

from moteslam import read_tum, scan_residuals
from moteslam.errors import InputError
from moteslam.eval.metrics import residuals
from moteslam.eval.scores import under_recording
from moteslam.eval.tables import number
from moteslam.robot.formats import open_recording
from moteslam.robot.formats.written import write_carmen
from moteslam.robot.platform import Platform
from moteslam.robot.recording import LidarStream, OdometryStream, Recording
from moteslam.robot.trajectories.text import write_tum
from moteslam.robot.trajectory import Trajectory

WALL = 2.0
"""The wall lies this far to the left of the robot that drives along it [m]."""
BEAMS = np.deg2rad(np.arange(60.0, 121.0, 2.0))
"""Towards the wall, some 7 cm apart on it."""


def recording_of(ranges: np.ndarray, stamps: np.ndarray | None = None, **lidar: object) -> Recording:
    """Scans [n, beams] of beams between the first and the last of ``BEAMS``."""
    stamps = np.arange(len(ranges)) * 0.1 if stamps is None else stamps
    angles = np.linspace(BEAMS[0], BEAMS[-1], ranges.shape[1])
    stream = LidarStream(
        stamps,
        ranges.astype(np.float32),
        angle_min=float(angles[0]),
        angle_increment=float(angles[1] - angles[0]),
        range_min=0.1,
        range_max=30.0,
    )
    return Recording("wall", Platform(), lidar=replace(stream, **lidar))  # type: ignore[arg-type]


def along_wall(count: int, *, step: float = 0.3, noise: float = 0.0) -> tuple[Recording, Trajectory]:
    """A drive beside the wall, and its true trajectory."""
    rng = np.random.default_rng(3)
    depth = WALL + rng.normal(0.0, noise, (count, len(BEAMS)))
    poses = np.zeros((count, 3))
    poses[:, 0] = step * np.arange(count)
    return recording_of(depth / np.sin(BEAMS)), Trajectory(np.arange(count) * 0.1, poses)


def seen(recording: Recording, ranges: np.ndarray, **lidar: object) -> Recording:
    """The same recording with other ranges."""
    stream = replace(recording.lidar, ranges=ranges.astype(np.float32), **lidar)  # type: ignore
    return recording.replace(lidar=stream)


def ranges_of(recording: Recording) -> np.ndarray:
    return np.array(recording.lidar.ranges)  # type: ignore[union-attr]


def test_without_noise_there_are_no_residuals_else_the_median_is_087_of_it() -> None:
    result = scan_residuals(*along_wall(20))
    assert result.quantile_90 < 1e-6
    assert (result.beyond_3_cm, result.no_return, result.matched) == (0.0, 0.0, 20)
    assert np.array_equal(result.stamps, np.arange(0, 20, 2) * 0.1)
    assert (len(result.medians), result.endpoints) == (10, 10 * len(BEAMS))
    noisy = scan_residuals(*along_wall(200, noise=0.005))
    assert noisy.median == pytest.approx(0.87 * 0.005, rel=0.04)
    assert noisy.quantile_90 == pytest.approx(0.87 / 0.6745 * 1.645 * 0.005, rel=0.04)
    assert scan_residuals(*along_wall(200, noise=0.02)).beyond_3_cm > 0.2


@pytest.mark.parametrize(
    ("noise", "stated", "told"),
    [(0.03, 0.0, False), (0.05, 0.0, True), (0.05, 0.05, False), (0.03, 0.01, True), (0.02, 0.001, False)],
)
def test_scans_that_fit_each_other_worse_than_their_noise_are_told(noise: float, stated: float, *, told: bool) -> None:
    recording, truth = along_wall(200, noise=noise)
    platform = recording.platform.with_(noise={"lidar": {"range_noise": stated}})
    found = residuals.unfit_scans(recording.replace(platform=platform), truth, truth)
    assert [issue.code for issue in found] == ["scans-unfit"] * told


def test_of_a_robot_that_stands_nothing_is_said_of_the_fit() -> None:
    recording, truth = along_wall(20, step=0.0, noise=0.1)
    assert residuals.unfit_scans(recording, truth, truth) == ()


@pytest.mark.parametrize(
    ("shaken", "turns", "told"),
    [(0.1, False, True), (0.005, False, False), (0.1, True, False)],  # of odometry that drifts, and where it turns
    ids=["scans that begin anywhere", "as any do", "late odometry in turns"],
)
def test_headings_that_shake_where_the_odometry_goes_straight_are_told(shaken: float, *, turns: bool, told: bool):
    recording, truth = along_wall(200)
    random, headings = np.random.default_rng(1), np.arange(200) * (0.05 if turns else 0.001)
    off = random.normal(0, shaken, 200)
    final, driven = (
        Trajectory(truth.stamps, np.column_stack((truth.poses[:, :2], each)))
        for each in (headings + off, headings + np.cumsum(random.normal(0, 0.01 * (not turns), 200)))
    )
    found = [issue.message for issue in residuals.unfit_scans(recording, final, driven)]
    assert any("shake" in message for message in found) == told


@pytest.mark.parametrize(("off", "beyond"), [(0.04, 1.0), (0.02, 0.0)])
def test_a_displaced_scan_is_as_far_off_as_it_is_displaced(off: float, beyond: float) -> None:
    recording, truth = along_wall(2)
    result = scan_residuals(recording, Trajectory(truth.stamps, truth.poses + np.array(((0, 0, 0), (0, off, 0)))))
    assert result.median == pytest.approx(off, abs=1e-6)
    assert result.beyond_3_cm == beyond


def test_lines_join_the_beams_that_an_interlaced_scan_measured_one_after_the_other() -> None:
    recording, truth = along_wall(20)
    full = ranges_of(recording)
    scan, beam = np.indices(full.shape)
    ranges = np.where((scan // 2 + beam) % 2, np.float32(np.nan), full)
    ranges[:, :4] = np.where(np.isnan(ranges[:, :4]), ranges[:, :4], np.float32(np.inf))
    result = scan_residuals(seen(recording, ranges, interlace=2), truth)
    assert result.quantile_90 < 1e-6
    assert result.no_return == pytest.approx(4 / len(BEAMS))
    assert result.endpoints == pytest.approx(10 * (len(BEAMS) - 4) / 2, abs=10)


def test_beams_without_return_are_counted_and_break_lines() -> None:
    recording, truth = along_wall(4)
    ranges = ranges_of(recording)
    ranges[:, 1::2] = np.inf
    with pytest.raises(InputError, match="no endpoint lies near the lines"):
        scan_residuals(seen(recording, ranges), truth)
    ranges = ranges_of(recording)
    ranges[:, :5], ranges[0, 10] = np.inf, np.nan
    result = scan_residuals(seen(recording, ranges), truth)
    assert result.no_return == pytest.approx(4 * 5 / (4 * len(BEAMS)))  # the reading of no use is not among them
    assert result.median < 1e-6


def test_no_line_leads_over_an_edge() -> None:
    """The other scan sees a step of 40 cm. Halfway between its two walls is a place that it did not see."""
    angles = np.linspace(BEAMS[0], BEAMS[-1], 121)
    near = angles > np.pi / 2
    step = np.where(near, WALL, WALL + 0.4) / np.sin(angles)
    points = np.stack((0.3 + step * np.cos(angles), step * np.sin(angles)), axis=1)
    middle = (points[near][0] + points[~near][-1]) / 2
    first = np.where((angles > np.deg2rad(95)) & (angles < np.deg2rad(110)), WALL, np.inf) / np.sin(angles)
    first[np.argmin(np.abs(angles - np.arctan2(*middle[::-1])))] = np.hypot(*middle)
    recording = recording_of(np.stack((first, step)))
    result = scan_residuals(recording, Trajectory(np.array((0.0, 0.1)), np.array(((0.0, 0, 0), (0.3, 0, 0)))))
    assert result.unseen == 1 / result.endpoints
    assert result.quantile_90 < 1e-6
    assert result.residuals == result.endpoints - 1


def test_beyond_the_end_of_a_surface_there_is_no_residual() -> None:
    recording, truth = along_wall(2)
    ranges = ranges_of(recording)
    ranges[1, len(BEAMS) // 2 :] = np.inf  # of the second scan, the wall from x = 0.3 m backwards
    result = scan_residuals(seen(recording, ranges), truth)
    x = WALL / np.tan(BEAMS)
    assert result.unseen == np.mean(x < 0.3 + x[len(BEAMS) // 2 - 1]) > 0.3
    assert result.quantile_90 < 1e-6


def test_off_a_convex_corner_the_corner_is_nearest() -> None:
    """A corner that points at the robot; the scan compared is laid 5 cm before it."""
    angles = np.linspace(BEAMS[0], BEAMS[-1], 121)

    def ranges(x: float) -> np.ndarray:
        right = (WALL + 0.5 * (x - 0.15)) / (np.sin(angles) - 0.5 * np.cos(angles))
        left = (WALL - 0.5 * (x - 0.15)) / (np.sin(angles) + 0.5 * np.cos(angles))
        return np.maximum(right, left)

    first = np.where(np.abs(angles - np.pi / 2) < np.deg2rad(10), ranges(0.0), np.inf)
    poses = np.array(((0.0, -0.05, 0.0), (0.3, 0.0, 0.0)))
    result = scan_residuals(recording_of(np.stack((first, ranges(0.3)))), Trajectory(np.array((0.0, 0.1)), poses))
    assert result.unseen == 0.0
    assert result.median == pytest.approx(0.05 * np.cos(np.arctan(0.5)), abs=1e-3)


def test_what_is_compared_with_what(monkeypatch: pytest.MonkeyPatch) -> None:
    dense = scan_residuals(*along_wall(100, step=0.01))  # 99 cm: four scans 25 cm apart, of which two are compared
    assert dense.stamps.tolist() == pytest.approx([0.0, 5.0])
    assert dense.matched == 100
    assert dense.residuals <= dense.endpoints * 3
    assert scan_residuals(*along_wall(2, step=1.9)).residuals > 0
    recording, truth = along_wall(2)
    far = Trajectory(truth.stamps, truth.poses + np.array(((0, 0, 0), (0, 0.6, 0))))
    for apart in (along_wall(3, step=2.05), (recording, far)):
        with pytest.raises(InputError, match="no endpoint lies near the lines of another scan"):
            scan_residuals(*apart)
    monkeypatch.setattr(residuals, "MAX_SCANS", 5)
    monkeypatch.setattr(residuals, "MAX_NEIGHBOURS", 2)
    bounded = scan_residuals(*along_wall(101))
    assert bounded.stamps.tolist() == pytest.approx([0.0, 2.4, 5.0, 7.6, 10.0], abs=0.21)
    assert bounded.stamps[-1] == 10.0
    assert bounded.residuals <= 5 * 2 * len(BEAMS)


def test_a_robot_that_turns_on_the_spot_is_compared() -> None:
    poses = np.zeros((8, 3))
    poses[:, 2] = 0.3 * np.arange(8)
    recording = recording_of(np.full((8, 61), WALL))  # in the middle of a round room
    result = scan_residuals(recording, Trajectory(np.arange(8) * 0.1, poses))
    assert result.median < WALL * (1 - np.cos(BEAMS[1] - BEAMS[0]))


def test_poses_are_taken_by_order_or_interpolated() -> None:
    recording, truth = along_wall(20)
    dense = scan_residuals(recording, truth.at(np.arange(0.0, 1.89, 0.013)))
    assert dense.matched == 19  # the last scan, 15 ms behind the last pose, has none
    assert dense.median == pytest.approx(scan_residuals(recording, truth).median, abs=1e-6)
    some = scan_residuals(recording, Trajectory(truth.stamps[::2], truth.poses[::2]))
    assert some.matched == 10
    assert some.median < 1e-6
    # two scans at every stamp, 30 cm apart and askew: each keeps its own pose
    stamps = np.repeat(np.arange(10) * 0.1, 2)
    poses = truth.poses.copy()
    poses[1::2, 1] = 0.02
    result = scan_residuals(seen(recording, ranges_of(recording), stamps=stamps), Trajectory(stamps, poses))
    assert result.quantile_90 == pytest.approx(0.02, abs=1e-6)


def test_scans_are_deskewed_where_a_sweep_takes_time() -> None:
    """The robot drives at the wall at 1 m/s, and a sweep takes 0.1 s: undone, it is straight again."""
    stamps = np.arange(4) * 0.3
    share = np.linspace(0.0, 1.0, len(BEAMS))
    ranges = (4.0 - stamps[:, None] - 0.1 * share) / np.sin(BEAMS)
    recording = recording_of(ranges, stamps, time_increment=0.1 / (len(BEAMS) - 1))
    times = np.arange(0.0, 1.2, 0.05)
    moving = recording.replace(odometry=OdometryStream(times, np.stack((0 * times, times, 0 * times), axis=1)))
    truth = Trajectory(stamps, np.stack((0 * stamps, stamps, 0 * stamps), axis=1))
    assert scan_residuals(moving, truth).quantile_90 < 1e-6
    assert scan_residuals(recording, truth).median > 0.002


@pytest.mark.parametrize(
    ("change", "field"),
    [
        (lambda r, t: (r.replace(lidar=None), t), "lidar"),
        (lambda r, t: (r, Trajectory(t.stamps + 1000, t.poses)), "trajectory"),
        (lambda r, t: (r, Trajectory(t.stamps[:1], t.poses[:1])), "trajectory"),
        (lambda r, t: (r, Trajectory(t.stamps[:0], t.poses[:0])), "trajectory"),
        (lambda r, t: (r, Trajectory(t.stamps, t.poses * (0.01, 0, 0))), "trajectory"),  # stands still
        (lambda r, t: (r, Trajectory(t.stamps, t.poses * np.nan)), "trajectory"),
        (lambda r, t: (t, r), "recording"),
    ],
)
def test_bad_input_is_refused(change, field: str) -> None:
    with refusal(InputError, field=field):
        scan_residuals(*change(*along_wall(5)))


def test_scans_without_endpoints_are_no_fault() -> None:
    recording, truth = along_wall(6)
    ranges = ranges_of(recording)
    ranges[2:4] = np.inf
    figures, errors = under_recording(truth, seen(recording, ranges))
    assert [median is None for median in errors["median_m"]] == [False, True, False]
    assert figures["endpoints"] == 2 * len(BEAMS)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A log of a drive beside a wall, its true trajectory, and a poor one; the working folder."""
    recording, truth = along_wall(30, noise=0.005)
    write_carmen(tmp_path / "wall.log", recording.replace(odometry=OdometryStream(truth.stamps, truth.poses)))
    write_tum(tmp_path / "true.tum", truth)
    poses = truth.poses + np.random.default_rng(1).normal(0.0, 0.03, truth.poses.shape) * (1, 1, 0)
    write_tum(tmp_path / "poor.tum", Trajectory(truth.stamps, poses))
    stamps = truth.stamps + np.where(np.arange(30) < 10, 0.0, 100.0)
    write_tum(tmp_path / "part.tum", Trajectory(stamps, truth.poses))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_command_scores_by_scans_and_reference(folder: Path, capsys: Capsys) -> None:
    result = scan_residuals(open_recording("wall.log"), read_tum("true.tum"))
    residuals = {**result.as_dict(), "warnings": []}
    found = shown(capsys, "evaluate", "true.tum", "--recording", "wall.log")
    assert found == {"estimate": "true.tum", "recording": "wall.log", "residuals": residuals}
    files = ("poor.tum", "true.tum", "true.tum")
    text = printed(capsys, "evaluate", *files, "--recording", "wall.log", "--save", "o.json")
    poor, true = (line.split() for line in text[text.index("scans of wall.log") :].splitlines()[2:])
    shares = [f"{100 * share:.1f}%" for share in (result.beyond_3_cm, result.unseen, result.no_return)]
    expected = ["true.tum", "15", number(1e3 * result.median), number(1e3 * result.quantile_90)]
    assert " ".join(true).replace(" %", "%").split() == [*expected, *shares]
    assert float(poor[2]) > 2 * float(true[2])
    for row in json.loads((folder / "o.json").read_text(encoding="utf-8"))["results"]:
        errors = row["residuals"]["errors"]
        assert len(errors["stamps"]) == len(errors["median_m"]) == row["residuals"]["scans"]
        assert len(row["errors"]["translation_m"]) == 30
    assert "warning: part.tum: 10 of 30 scans or poses have a partner" in told(
        capsys, "evaluate", "part.tum", "--recording", "wall.log"
    )
