"""Precision and recall of loops: rounds in a square room, what is false, what binds, and what cannot be had."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from box_ranges import box_ranges
from command_lines import Capsys, printed, shown
from figures import legend_of
from loop_candidates import candidate
from matplotlib.figure import Figure

from moteslam.errors import InputError
from moteslam.eval.metrics import loops as metric
from moteslam.eval.metrics.loops import possible_loops, score_loops
from moteslam.eval.report.maps import ACCEPTED, REJECTED, draw_loops
from moteslam.eval.run_tables import read_loops, write_loops
from moteslam.robot import se2
from moteslam.robot.formats import open_recording
from moteslam.robot.formats.written import write_carmen
from moteslam.robot.platform import Platform
from moteslam.robot.raster import Raster
from moteslam.robot.recording import LidarStream, Recording
from moteslam.robot.trajectories.text import read_tum, write_tum
from moteslam.robot.trajectory import Trajectory

RADIUS = 3.0
"""Of the rounds [m]; one of them is 18.8 m."""
HALF = 5.0
"""Half the side of the room, whose middle is that of the rounds [m]."""
BEAMS = np.deg2rad(np.arange(-90.0, 91.0))


def drive(angles: np.ndarray, heading: np.ndarray | float = np.pi / 2) -> tuple[Recording, Trajectory]:
    """Scans at these angles on the round, and the truth; the heading is that on the round, plus ``heading`` [rad]."""
    poses = np.stack((RADIUS * np.cos(angles), RADIUS * np.sin(angles), se2.wrap(angles + heading)), axis=-1)
    x, y, theta = np.split(poses, 3, axis=1)
    stamps = 100.0 + 0.5 * np.arange(len(angles))
    lidar = LidarStream(
        stamps,
        box_ranges(x, y, theta + BEAMS, (-HALF, -HALF), (HALF, HALF)).astype(np.float32),
        angle_min=float(BEAMS[0]),
        angle_increment=float(BEAMS[1] - BEAMS[0]),
        range_min=0.1,
        range_max=30.0,
    )
    return Recording("rounds", Platform(), lidar=lidar), Trajectory(stamps, poses)


def rounds(count: float = 2.0) -> tuple[Recording, Trajectory]:
    """Rounds with a scan every 0.6 m."""
    return drive(np.arange(0.0, count * 2 * np.pi, 0.2))


def loop(truth: Trajectory, earlier: int, later: int, off=(0.0, 0.0, 0.0), verdict="accepted"):
    """A candidate, found this far off the true relative pose."""
    true = se2.between(truth.poses[earlier], truth.poses[later])
    stamps = (float(truth.stamps[earlier]), float(truth.stamps[later]))
    return candidate(earlier, later, stamps=stamps, found=true + np.array(off), verdict=verdict)


def test_a_loop_is_false_beyond_30_cm_or_3_degrees() -> None:
    _, truth = rounds()
    offs = ((0.0, 0.0, 0.0), (0.2, 0.2, 0.05), (0.25, 0.25, 0.0), (0.31, 0.0, 0.0), (0.0, 0.0, 0.053), (0, 0, -0.053))
    result = score_loops([loop(truth, 2, 33, off) for off in offs], truth)
    assert (result.pairs, result.false, result.precision) == (6, 4, pytest.approx(2 / 6))
    assert result.errors == pytest.approx([np.hypot(*off[:2]) for off in offs])
    assert result.rotation_errors == pytest.approx([abs(off[2]) for off in offs])
    written = result.as_dict()
    assert written["translation_m"]["max"] == pytest.approx(np.hypot(0.25, 0.25))
    assert written["rotation_deg"]["max"] == pytest.approx(np.rad2deg(0.053))


def test_only_accepted_loops_count_and_overruled_ones_are_counted_apart() -> None:
    """The latter were edges of the graph; that they are no longer accepted does not make the others right."""
    _, truth = rounds()
    far = [loop(truth, 2, 33, (9.0, 0, 0), verdict) for verdict in ("weak", "ambiguous", "outside", "contradicted")]
    overruled = [loop(truth, 2, 33, off, "overruled") for off in ((0.4, 0, 0), (0, 0, 0.06), (0.25, 0, 0))]
    result = score_loops([loop(truth, 2, 33, (0.0, 0.0, 2 * np.pi)), *far, *overruled], truth)  # an angle is wrapped
    assert (result.pairs, result.precision) == (1, 1.0)
    assert (result.false, result.overruled, result.overruled_false) == (0, 3, 2)


def test_without_an_accepted_loop_there_is_no_precision() -> None:
    recording, truth = rounds()
    result = score_loops([loop(truth, 2, 33, verdict="weak")], truth, recording)
    assert result.precision is None
    assert result.recall == 0.0
    assert [issue.code for issue in result.issues] == ["no-loop-precision"]
    assert result.as_dict()["translation_m"] is None
    beyond = candidate(1, 9, stamps=(0.0, 101.0))
    assert "truth covers no accepted loop" in str(score_loops([beyond], truth, recording).issues[0])


def test_without_possible_loops_there_is_no_recall() -> None:
    recording, truth = rounds(0.7)  # 13 m
    result = score_loops([], truth, recording)
    assert (result.recall, result.possible) == (None, 0)
    assert [issue.code for issue in result.issues] == ["no-loop-precision", "no-loop-recall"]
    assert score_loops([], truth).possible is None
    elsewhere = Trajectory(truth.stamps[:1], truth.poses[:1])
    assert "poses at 1 of 22 scans" in str(score_loops([], elsewhere, recording).issues[1])
    with pytest.raises(InputError, match="expected Trajectory"):
        score_loops([], None)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="truth: a trajectory without poses"):
        score_loops([], Trajectory(np.zeros(0), np.zeros((0, 3))))


def test_possible_loops_are_those_that_plain_numpy_finds() -> None:
    """Every scan is a key scan here, and all endpoints of the earlier scan count."""
    recording, truth = rounds(2.3)
    clouds = [
        se2.transform_points(pose, np.stack((scan * np.cos(BEAMS), scan * np.sin(BEAMS)), axis=-1).astype(np.float32))
        for pose, scan in zip(truth.poses, recording.lidar.ranges, strict=True)
    ]
    steps = np.hypot(*np.diff(truth.poses[:, :2], axis=0).T)
    path = np.concatenate(([0.0], np.cumsum(steps)))
    expected = []
    for i in range(len(truth)):
        for j in range(i):
            if path[i] - path[j] <= 15.0 or np.hypot(*(truth.poses[i] - truth.poses[j])[:2]) > 2.0:
                continue
            some = clouds[i][np.linspace(0, 180, 100).round().astype(int)]
            nearest = np.hypot(*(some[:, None] - clouds[j]).transpose(2, 0, 1)).min(axis=1)
            if np.mean(nearest < 0.2) >= 0.5:
                expected.append((j, i))
    found, *_ = possible_loops(recording, truth)
    assert sorted(map(tuple, found.tolist())) == sorted(expected)
    assert set(range(32, len(truth))) <= set(found[:, 1].tolist())  # all of the second round
    assert min(found[:, 1]) > 25


def test_from_the_other_side_half_of_the_endpoints_are_not_shared(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same round, driven back: a lidar that looks ahead sees the other half of the room."""
    there = np.arange(0.0, 2 * np.pi, 0.2)
    angles = np.concatenate((there, there[-1] - 0.2 - there))
    heading = np.where(np.arange(len(angles)) < len(there), np.pi / 2, -np.pi / 2)
    back, *_ = possible_loops(*drive(angles, heading))
    ahead, *_ = possible_loops(*rounds())
    assert len(back) < 0.1 * len(ahead)
    monkeypatch.setattr(metric, "MAX_KEY_SCANS", 21)
    few, *_ = possible_loops(*rounds())
    assert 0 < len(np.unique(few)) <= 21


def test_a_loop_binds_the_scans_of_some_metres() -> None:
    """Scans are 0.6 m apart: a loop binds its own and four before and after it."""
    recording, truth = rounds()
    scores = score_loops([loop(truth, 10, 41)], truth, recording)
    assert scores.bound == 9
    assert scores.possible == len(np.unique(possible_loops(recording, truth)[0][:, 1]))
    assert scores.recall == 9 / scores.possible
    assert score_loops([loop(truth, 10, 41), loop(truth, 12, 43)], truth, recording).bound == 11
    elsewhere = loop(truth, 25, 41)  # right, but not where scan 41 and those around it were before
    for bad in (loop(truth, 10, 41, (0.4, 0.0, 0.0)), loop(truth, 10, 41, verdict="ambiguous"), elsewhere):
        assert score_loops([bad], truth, recording).bound == 0
    every = score_loops([loop(truth, k, k + 31) for k in range(0, 32, 3)], truth, recording)
    assert (every.precision, every.recall) == (1.0, 1.0)


def test_dense_recordings_and_truths_are_measured_at_the_same_key_scans() -> None:
    """Ten times the scans: the share of those bound by the same loops is about the same."""
    sparse, truth = rounds()
    dense, dense_truth = drive(np.arange(0.0, 4 * np.pi, 0.02))
    found = [loop(truth, 10, 41), loop(truth, 20, 51)]
    again = [loop(dense_truth, 100, 410), loop(dense_truth, 200, 510)]
    one, other = score_loops(found, truth, sparse), score_loops(again, dense_truth, dense)
    assert other.possible <= 2 * one.possible  # a turn of a radian is a metre, too
    assert other.recall == pytest.approx(one.recall, abs=0.1)
    stamps = np.linspace(truth.stamps[0], truth.stamps[-1], 2000)
    assert score_loops(found, truth.at(stamps), sparse).recall == pytest.approx(one.recall, abs=0.05)


@pytest.mark.parametrize(("seen", "last"), [(0, None), (40, 39)])
def test_scans_without_endpoints_have_no_possible_loop(seen: int, last: int | None) -> None:
    recording, truth = rounds()
    ranges = np.array(recording.lidar.ranges)  # type: ignore[union-attr]
    ranges[seen:] = np.inf
    blind = recording.replace(lidar=replace(recording.lidar, ranges=ranges))  # type: ignore[type-var]
    assert max(possible_loops(blind, truth)[0][:, 1], default=None) == last


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A log of two rounds, its truth, and a ledger of one right loop and one false one."""
    recording, truth = rounds()
    write_carmen(tmp_path / "rounds.log", recording.replace(lidar=replace(recording.lidar, odometry=truth.poses)))
    write_tum(tmp_path / "truth.tum", truth)
    write_loops(tmp_path / "loops.csv", [loop(truth, 10, 41), loop(truth, 12, 43, (1.0, 0, 0))])
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_command_scores_a_ledger(folder: Path, capsys: Capsys) -> None:
    arguments = ["evaluate", "truth.tum", "truth.tum", "--loops", "loops.csv", "--recording", "rounds.log"]
    result = score_loops(read_loops("loops.csv"), read_tum("truth.tum"), open_recording("rounds.log"))
    out = printed(capsys, *arguments)
    assert re.search(r"precision of loops +0\.500 \(accepted 2, overruled 0, overruled false 0\)", out)
    assert re.search(rf"recall of loops +{result.recall:.3f} \(possible {result.possible}, bound 9\)", out)
    found = shown(capsys, *arguments, "--save", "out.json")["metrics"]["truth.tum"]
    assert found["loops_false"]["value"] == 1
    assert found["loops_recall"]["possible"] == result.possible
    assert json.loads((folder / "out.json").read_text())["metrics"]["truth.tum"] == found
    assert "no recall of the loops: there is no recording" in printed(capsys, *arguments[:-2])


LOOPS = (
    candidate(0, 6),
    candidate(1, 7),
    candidate(2, 8, verdict="ambiguous"),
    candidate(2, 9, verdict="weak"),
    candidate(3, 9, verdict="weak"),
)
PATH = Trajectory(np.arange(10.0), np.stack((np.arange(10.0), np.arange(10.0) % 3, np.zeros(10)), axis=-1))
MAP = Raster(np.ones((30, 40), np.float32), 0.25, (0.0, -1.0, 0.0))


def ends(figure: Figure, colour: str) -> np.ndarray:
    """Both ends [n, 2, 2] of every line of a colour."""
    line = next(line for line in figure.axes[0].lines if line.get_color() == colour)
    points = np.asarray(line.get_xydata()).reshape(-1, 3, 2)
    assert np.isnan(points[:, 2]).all()
    return points[:, :2]


def test_loops_join_the_final_poses_of_their_scans(tmp_path: Path, drawn: list[Figure]) -> None:
    draw_loops(tmp_path / "loops.png", MAP, LOOPS, trajectory=PATH, title="$x_")
    figure = drawn[0]
    assert ends(figure, ACCEPTED).tolist() == [[[0, 0], [6, 0]], [[1, 1], [7, 1]]]
    assert ends(figure, REJECTED).tolist() == [[[2, 2], [8, 2]]]
    assert figure.axes[0].get_aspect() == 1.0
    assert (figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()) == ("x [m]", "y [m]")
    drawn_as = ["accepted: 2", "rejected: 0 overruled, 0 contradicted, 1 ambiguous", "not drawn: 2 weak"]
    assert legend_of(figure) == ["SLAM (final)", "start", "end", *drawn_as]
