"""Gaps, repeated scans, faults of the odometry: each changes the log as it says, in its interval and nowhere else."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from moteslam.errors import ConfigError
from moteslam.robot import se2
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, OdometryStream, Recording
from moteslam.sim.base_odometry import with_odometry
from moteslam.sim.logged import Logging, logged
from moteslam.sim.scenario import parse_scenario
from moteslam.sim.simulate import EPOCH, Simulation, simulate

START, DURATION = 4.0, 2.5
END = START + DURATION


def run(table: dict[str, Any], *faults: dict[str, Any], **changes: Any) -> Simulation:
    return simulate(parse_scenario({**table, **changes, "faults": list(faults)}), seed=2)


def fault(kind: str, **keys: Any) -> dict[str, Any]:
    return {"kind": kind, "start": START, "duration": DURATION, **keys}


@pytest.fixture
def plain(table: dict[str, Any], taichi: None) -> Simulation:
    return run(table)


def lidar(recording: Recording) -> LidarStream:
    assert recording.lidar is not None
    return recording.lidar


def encoders(recording: Recording) -> EncoderStream:
    assert recording.encoders is not None
    return recording.encoders


def imu(recording: Recording) -> ImuStream:
    assert recording.imu is not None
    return recording.imu


def odometry(recording: Recording) -> OdometryStream:
    assert recording.odometry is not None
    return recording.odometry


def within(stamps: np.ndarray) -> np.ndarray:
    return (stamps >= EPOCH + START) & (stamps < EPOCH + END)


def test_a_driver_that_repeats_a_scan(table: dict[str, Any], plain: Simulation) -> None:
    ours, theirs = lidar(run(table, fault("repeated_scans")).recording), lidar(plain.recording)
    assert ours.stamps.tobytes() == theirs.stamps.tobytes()
    frozen = within(ours.stamps)
    assert frozen.sum() == pytest.approx(DURATION * 40, abs=2)
    first = int(np.flatnonzero(frozen)[0])
    for scan in ours.ranges[frozen]:
        assert scan.tobytes() == theirs.ranges[first - 1].tobytes()
    assert ours.ranges[~frozen].tobytes() == theirs.ranges[~frozen].tobytes()


@pytest.mark.parametrize("counters", ["kept", "lost"])
def test_in_a_gap_nothing_is_recorded(table: dict[str, Any], plain: Simulation, counters: str) -> None:
    simulation = run(table, fault("gap", counters=counters))
    assert simulation.truth.poses.tobytes() == plain.truth.poses.tobytes()
    for stream in (lidar, encoders, imu):
        ours, theirs = stream(simulation.recording), stream(plain.recording)
        kept = ~within(theirs.stamps)
        assert 0 < kept.sum() < len(kept)
        assert ours.stamps.tobytes() == theirs.stamps[kept].tobytes()
    counts, all_counts = encoders(simulation.recording).counts, encoders(plain.recording).counts
    kept = ~within(encoders(plain.recording).stamps)
    lost = all_counts[~kept].sum(0)
    assert (lost > 100).all()
    after = int((encoders(plain.recording).stamps < EPOCH + START).sum())
    expected = all_counts[kept]
    expected[after] += lost if counters == "kept" else 0
    np.testing.assert_array_equal(counts, expected)


def test_in_a_gap_the_camera_is_silent_and_the_other_images_stay(table: dict[str, Any], plain: Simulation) -> None:
    camera = {"camera": {"rate": 5.0}}
    whole, cut = run(table, **camera).frames, run(table, fault("gap"), **camera).frames
    assert whole is not None
    assert cut is not None
    kept = ~within(whole.rgb_stamps)
    assert cut.rgb_stamps.tobytes() == whole.rgb_stamps[kept].tobytes()
    assert not within(cut.disparity_stamps).any()
    last = np.array([len(cut.rgb_stamps) - 1])
    np.testing.assert_array_equal(cut.draw_rgb(last), whole.draw_rgb(np.flatnonzero(kept)[-1:]))


def test_the_base_goes_on_through_a_gap_unless_its_counts_are_lost(table: dict[str, Any], plain: Simulation) -> None:
    whole = odometry(logged(plain, Logging()).recording)
    kept, lost = (logged(run(table, fault("gap", counters=which)), Logging()).recording for which in ("kept", "lost"))
    outside = ~within(whole.stamps)
    assert odometry(kept).poses.tobytes() == whole.poses[outside].tobytes()
    scans = lidar(kept)
    assert scans.odometry is not None
    assert not within(scans.stamps).any()
    first = int((odometry(lost).stamps < EPOCH + START).sum())
    step = se2.between(*odometry(lost).poses[first - 1 : first + 1])
    assert np.hypot(*step[:2]) < 0.05
    assert np.hypot(*se2.between(*odometry(kept).poses[first - 1 : first + 1])[:2]) > 1.0


def test_stale_counters_count_nothing_and_then_all(table: dict[str, Any], plain: Simulation) -> None:
    simulation = run(table, fault("stale_odometry"))
    ours, theirs = encoders(simulation.recording), encoders(plain.recording)
    stale = within(ours.stamps)
    after = int(np.flatnonzero(stale)[-1]) + 1
    assert not ours.counts[stale].any()
    np.testing.assert_array_equal(ours.counts[after], theirs.counts[stale].sum(0) + theirs.counts[after])
    stale[after] = True
    np.testing.assert_array_equal(ours.counts[~stale], theirs.counts[~stale])
    assert lidar(simulation.recording).ranges.tobytes() == lidar(plain.recording).ranges.tobytes()
    assert imu(simulation.recording).angular_velocity.tobytes() == imu(plain.recording).angular_velocity.tobytes()


@pytest.mark.parametrize("logging", [Logging(), Logging(every=0.2, turn=0.2)])
def test_stale_poses_are_held_and_then_right(table: dict[str, Any], plain: Simulation, logging: Logging) -> None:
    ours = logged(run(table, fault("stale_odometry")), logging).recording
    theirs = logged(plain, logging).recording
    for stamps, poses, right in (
        (odometry(ours).stamps, odometry(ours).poses, odometry(theirs).poses),
        (lidar(ours).stamps, lidar(ours).odometry, lidar(theirs).odometry),
    ):
        assert poses is not None
        assert right is not None
        stale = within(stamps)
        assert stale.sum() > 5
        assert (poses[stale] == poses[stale][0]).all()
        assert poses[~stale].tobytes() == right[~stale].tobytes()
        assert np.hypot(*(right[stale][-1] - poses[stale][-1])[:2]) > 1.0
    assert len(lidar(ours)) == len(lidar(theirs))  # scans go on


def test_odometry_that_jumps(table: dict[str, Any], plain: Simulation) -> None:
    jump = {"kind": "odometry_jump", "start": START, "x": 1.0, "y": -0.5, "theta": 0.3}
    simulation = run(table, jump)
    ours, theirs = logged(simulation, Logging()).recording, logged(plain, Logging()).recording
    at = int(np.searchsorted(odometry(ours).stamps, EPOCH + START))
    assert odometry(ours).poses[:at].tobytes() == odometry(theirs).poses[:at].tobytes()
    before = odometry(ours).poses[at - 1]
    there = se2.compose(before, (1.0, -0.5, 0.3))
    steps = se2.between(np.broadcast_to(before, (len(odometry(ours)) - at, 3)), odometry(theirs).poses[at:])
    np.testing.assert_allclose(odometry(ours).poses[at:, :2], se2.compose(there, steps)[:, :2], atol=1e-9)
    scans = lidar(ours)
    assert scans.odometry is not None
    np.testing.assert_allclose(
        scans.odometry[-1],
        se2.interpolate(odometry(ours).stamps, odometry(ours).poses, scans.stamps[-1:])[0],
        atol=1e-9,
    )
    counts = encoders(simulation.recording).counts - encoders(plain.recording).counts
    assert np.flatnonzero(counts.any(1)).tolist() == [at]
    wheels = simulation.scenario.platform.wheels
    assert wheels is not None
    right, left = counts[at, :2] * wheels.metres_per_count
    assert (right + left) / 2 == pytest.approx(1.0, abs=0.001)
    assert (right - left) / wheels.effective_track == pytest.approx(0.3, abs=0.005)


def test_odometry_that_begins_anew_at_the_origin(table: dict[str, Any], plain: Simulation) -> None:
    simulation = run(table, {"kind": "odometry_jump", "start": START, "reset": True})
    assert encoders(simulation.recording).counts.tobytes() == encoders(plain.recording).counts.tobytes()
    ours = odometry(logged(simulation, Logging()).recording)
    at = int(np.searchsorted(ours.stamps, EPOCH + START))
    assert np.hypot(*ours.poses[at - 1, :2]) > 1.0
    assert np.hypot(*ours.poses[at, :2]) < 0.05
    assert abs(ours.poses[at, 2]) < 0.05


def test_without_such_faults_the_log_is_of_the_recording(plain: Simulation) -> None:
    assert plain.base is None
    expected = with_odometry(plain.recording, gyro=True)
    assert odometry(logged(plain, Logging()).recording).poses.tobytes() == odometry(expected).poses.tobytes()


@pytest.mark.parametrize(
    ("wrong", "line"),
    [
        ({"kind": "carts"}, r"^my.toml: faults.0: .*gap.*"),
        ({"start": 1.0}, r"^my.toml: faults.0: .*kind"),
        ({"kind": "gap", "start": 1.0}, r"^my.toml: faults.0.duration: "),
        ({"kind": "gap", "start": 1.0, "duration": 0.0}, r"^my.toml: faults.0.duration: "),
        (
            {"kind": "gap", "start": 1.0, "duration": 1.0, "counter": "lost"},
            r"^my.toml: faults.0.counter: ",
        ),
        ({"kind": "odometry_jump", "start": 1.0}, r"^my.toml: faults.0: no step, expected one or more of x, y and"),
        ({"kind": "odometry_jump", "start": 1.0, "x": 1.0, "reset": True}, r"^my.toml: faults.0: both a step and a"),
    ],
)
def test_refused(table: dict[str, Any], wrong: dict[str, Any], line: str) -> None:
    with pytest.raises(ConfigError, match=line) as caught:
        parse_scenario({**table, "faults": [wrong]}, file="my.toml")
    assert "\n" not in str(caught.value)


@pytest.mark.usefixtures("taichi")
def test_a_fault_after_the_drive_is_refused(table: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=r"^faults.0.start: 500 s, expected before the end of the drive, 1\d\.\d s$"):
        run(table, {"kind": "gap", "start": 500.0, "duration": 1.0})
