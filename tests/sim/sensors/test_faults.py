"""Faults of the log, of the odometry and of the lidar: each changes what it says, in its interval and nothing else."""

from typing import Any

import numpy as np
import pytest
from refusals import refusal
from sim_drives import room_table

from moteslam.errors import ConfigError
from moteslam.robot import se2
from moteslam.robot.noise import Noise
from moteslam.sim.logged import Logging, logged
from moteslam.sim.scenario import parse_scenario
from moteslam.sim.sensors.clock import EPOCH
from moteslam.sim.sensors.faults import Cart
from moteslam.sim.simulate import Simulation, simulate

pytestmark = pytest.mark.usefixtures("taichi")

START, DURATION = 4.0, 3.0


def run(table: dict[str, Any], *faults: dict[str, Any], **changes: Any) -> Simulation:
    noise = Noise().model_dump()
    noise["lidar"]["range_noise"] = 0.01
    return simulate(parse_scenario({**table, "noise": noise, **changes, "faults": list(faults)}), seed=2)


def fault(kind: str, **keys: Any) -> dict[str, Any]:
    return {"kind": kind, "start": START, "duration": DURATION, **keys}


@pytest.fixture(scope="module")
def plain(taichi: None) -> Simulation:
    return run(room_table())


def within(stamps: np.ndarray, *, margin: float = 0.0) -> np.ndarray:
    """Which stamps are in the fault, or within a margin of it."""
    since = stamps - EPOCH
    return (since >= START - margin) & (since < START + DURATION + margin)


def same_elsewhere(ours: Simulation, theirs: Simulation) -> None:
    """All but the scans of the fault, and those that are being taken as it begins and ends, are the same bytes."""
    outside = ~within(theirs.recording.lidar.stamps, margin=0.03)
    assert ours.recording.lidar.ranges[outside].tobytes() == theirs.recording.lidar.ranges[outside].tobytes()
    assert ours.truth.poses.tobytes() == theirs.truth.poses.tobytes()
    for stream in ("encoders", "imu"):
        assert getattr(ours.recording, stream).stamps.tobytes() == getattr(theirs.recording, stream).stamps.tobytes()


def test_a_driver_that_repeats_a_scan(table: dict[str, Any], plain: Simulation) -> None:
    ours, theirs = run(table, fault("repeated_scans")).recording.lidar, plain.recording.lidar
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
    for stream in ("lidar", "encoders", "imu"):
        ours, theirs = getattr(simulation.recording, stream), getattr(plain.recording, stream)
        kept = ~within(theirs.stamps)
        assert 0 < kept.sum() < len(kept)
        assert ours.stamps.tobytes() == theirs.stamps[kept].tobytes()
    whole = plain.recording.encoders
    kept = ~within(whole.stamps)
    lost = whole.counts[~kept].sum(0)
    assert (lost > 100).all()
    expected = whole.counts[kept]
    expected[(whole.stamps < EPOCH + START).sum()] += lost if counters == "kept" else 0
    np.testing.assert_array_equal(simulation.recording.encoders.counts, expected)


def test_stale_counters_count_nothing_and_then_all(table: dict[str, Any], plain: Simulation) -> None:
    recording = run(table, fault("stale_odometry")).recording
    ours, theirs = recording.encoders, plain.recording.encoders
    stale = within(ours.stamps)
    after = int(np.flatnonzero(stale)[-1]) + 1
    assert not ours.counts[stale].any()
    np.testing.assert_array_equal(ours.counts[after], theirs.counts[stale].sum(0) + theirs.counts[after])
    stale[after] = True
    np.testing.assert_array_equal(ours.counts[~stale], theirs.counts[~stale])
    assert recording.lidar.ranges.tobytes() == plain.recording.lidar.ranges.tobytes()
    assert recording.imu.angular_velocity.tobytes() == plain.recording.imu.angular_velocity.tobytes()


@pytest.mark.parametrize("logging", [Logging(), Logging(every=0.2, turn=0.2)])
def test_stale_poses_are_held_and_then_right(table: dict[str, Any], plain: Simulation, logging: Logging) -> None:
    ours, theirs = logged(run(table, fault("stale_odometry")), logging).recording, logged(plain, logging).recording
    for stamps, poses, right in (
        (ours.odometry.stamps, ours.odometry.poses, theirs.odometry.poses),
        (ours.lidar.stamps, ours.lidar.odometry, theirs.lidar.odometry),
    ):
        stale = within(stamps)
        assert stale.sum() > 5
        assert (poses[stale] == poses[stale][0]).all()
        assert poses[~stale].tobytes() == right[~stale].tobytes()
        assert np.hypot(*(right[stale][-1] - poses[stale][-1])[:2]) > 1.0
    assert len(ours.lidar) == len(theirs.lidar)  # scans go on


def test_odometry_that_jumps(table: dict[str, Any], plain: Simulation) -> None:
    simulation = run(table, {"kind": "odometry_jump", "start": START, "x": 1.0, "y": -0.5, "theta": 0.3})
    recording = logged(simulation, Logging()).recording
    ours, theirs = recording.odometry, logged(plain, Logging()).recording.odometry
    at = int(np.searchsorted(ours.stamps, EPOCH + START))
    assert ours.poses[:at].tobytes() == theirs.poses[:at].tobytes()
    there = se2.compose(ours.poses[at - 1], (1.0, -0.5, 0.3))
    steps = se2.between(np.broadcast_to(ours.poses[at - 1], (len(ours) - at, 3)), theirs.poses[at:])
    np.testing.assert_allclose(ours.poses[at:, :2], se2.compose(there, steps)[:, :2], atol=1e-9)
    last = se2.interpolate(ours.stamps, ours.poses, recording.lidar.stamps[-1:])[0]
    np.testing.assert_allclose(recording.lidar.odometry[-1], last, atol=1e-9)
    counts = simulation.recording.encoders.counts - plain.recording.encoders.counts
    assert np.flatnonzero(counts.any(1)).tolist() == [at]
    wheels = simulation.scenario.platform.wheels
    right, left = counts[at, :2] * wheels.metres_per_count
    assert (right + left) / 2 == pytest.approx(1.0, abs=0.001)
    assert (right - left) / wheels.effective_track == pytest.approx(0.3, abs=0.005)


def test_odometry_that_begins_anew_at_the_origin(table: dict[str, Any], plain: Simulation) -> None:
    simulation = run(table, {"kind": "odometry_jump", "start": START, "reset": True})
    assert simulation.recording.encoders.counts.tobytes() == plain.recording.encoders.counts.tobytes()
    ours = logged(simulation, Logging()).recording.odometry
    at = int(np.searchsorted(ours.stamps, EPOCH + START))
    assert np.hypot(*ours.poses[at - 1, :2]) > 1.0
    assert np.abs(ours.poses[at]).max() < 0.05


@pytest.mark.parametrize(
    ("wrong", "field"),
    [
        ({"start": 1.0}, "faults.0"),
        ({"kind": "gap", "start": 1.0}, "faults.0.duration"),
        ({"kind": "odometry_jump", "start": 1.0, "x": 1.0, "reset": True}, "faults.0"),
        ({"kind": "cart", "leg": 0.3}, "faults.0"),
        ({"kind": "tilt", "pitch": 0.0}, "faults.0"),
        ({"kind": "carried", "start": 4.0, "to": [1.0, 1.0, 0.0], "along": 1.0}, "faults.0"),
        ({"kind": "carried", "start": 4.0, "to": [9.95, 1.0, 0.0]}, "faults.0.to"),
    ],
)
def test_refused(table: dict[str, Any], wrong: dict[str, Any], field: str) -> None:
    with refusal(ConfigError, file="my.toml", field=field):
        parse_scenario({**table, "faults": [wrong]}, file="my.toml")


def test_a_fault_after_the_drive_is_refused(table: dict[str, Any]) -> None:
    for late in (fault("gap", start=500.0), fault("stuck_wheels", start=13.0)):
        with refusal(ConfigError, field="faults.0.start"):
            run(table, late)
    with refusal(ConfigError, field="outages.0.start"):
        run(table, outages=[{"sensor": "lidar", "start": 500.0, "duration": 5.0}])


def test_a_cart_ahead_is_where_it_is_said_to_be(table: dict[str, Any], plain: Simulation) -> None:
    simulation = run(table, fault("cart", distance=0.8, width=0.6))
    same_elsewhere(simulation, plain)
    stream, seen = simulation.recording.lidar, within(simulation.recording.lidar.stamps, margin=-0.03)
    front = np.abs(stream.angles) < np.arctan(0.3 / 0.8) - 0.01
    off = stream.ranges[seen][:, front] - 0.8 / np.cos(stream.angles[front])
    assert abs(off.mean()) < 0.001
    assert off.std() == pytest.approx(0.01, rel=0.1)  # the noise of any wall
    behind = np.abs(stream.angles) > 0.5
    assert stream.ranges[:, behind].tobytes() == plain.recording.lidar.ranges[:, behind].tobytes()


@pytest.mark.parametrize("leg", [0.0, 0.05])
def test_a_cart_to_the_side_by_its_corners(leg: float) -> None:
    cart = Cart(distance=1.0, bearing=np.pi / 2, width=0.6, depth=0.4, leg=leg)
    ranges = cart.ranges((0.0, 0.0), np.pi / 2 + np.array([0.0, 0.28, -0.28, 0.4, np.pi]))
    ahead = np.inf if leg else 1.0
    np.testing.assert_allclose(ranges, [ahead, 1 / np.cos(0.28), 1 / np.cos(0.28), np.inf, np.inf])
    beside = cart.ranges((0.1, 0.0), np.array([np.pi / 2]))  # the lidar is 0.1 m ahead of where it is said to be
    np.testing.assert_allclose(beside, [ahead])
    assert cart.ranges((0.31, 0.0), np.array([np.pi / 2]))[0] == np.inf


def test_a_lidar_mounted_aslant_measures_the_floor_ahead(table: dict[str, Any], plain: Simulation) -> None:
    simulation = run(table, fault("tilt", pitch=0.08, height=0.2))
    same_elsewhere(simulation, plain)
    stream, seen = simulation.recording.lidar, within(simulation.recording.lidar.stamps, margin=-0.03)
    down = 0.08 * np.cos(stream.angles)
    floor = 0.2 / np.sin(down)
    for ours, level in zip(stream.ranges[seen], plain.recording.lidar.ranges[seen], strict=True):
        meets = (down > 0.02) & (level > floor + 0.2)
        assert meets.any()
        assert np.abs(ours - floor)[meets].max() < 0.06
        walls = ~meets & (level < floor - 0.2)
        assert np.abs(ours - level)[walls].max() < 0.05
    assert (stream.ranges[seen] < plain.recording.lidar.ranges[seen] - 1.0).any()


def test_a_tilt_takes_the_height_of_the_robots_lidar_and_a_roll(table: dict[str, Any]) -> None:
    stream = run(table, {"kind": "tilt", "pitch": 0.0, "roll": 0.3}).recording.lidar
    right = np.abs(stream.angles + np.pi / 2) < 0.1
    floor = 0.51435 / np.sin(0.3 * -np.sin(stream.angles[right]))
    assert np.abs(np.minimum(stream.ranges[:, right] - floor, 0.0)).max() < 0.06
    assert np.median(stream.ranges[:, right] - floor) < 0.01
    left = np.abs(stream.angles - np.pi / 2) < 0.1  # these look up
    assert stream.ranges[:, left].max() > 5.0


def test_a_floor_at_a_glance_sends_nothing_back(table: dict[str, Any]) -> None:
    stream = run(table, {"kind": "tilt", "pitch": 0.08, "height": 0.2, "grazing": 0.5}).recording.lidar
    ahead = stream.ranges[:, stream.ranges.shape[1] // 2]
    assert np.isinf(ahead).mean() > 0.5
    assert ahead[np.isfinite(ahead)].max() < 0.2 / np.sin(0.08) + 0.06


def test_in_a_gap_the_camera_is_silent_and_the_other_images_stay(table: dict[str, Any]) -> None:
    camera = {"camera": {"rate": 5.0}}
    whole, cut = run(table, **camera).frames, run(table, fault("gap"), **camera).frames
    kept = ~within(whole.rgb.stamps)
    assert cut.rgb.stamps.tobytes() == whole.rgb.stamps[kept].tobytes()
    assert not within(cut.disparity.stamps).any()
    last = np.array([len(cut.rgb.stamps) - 1])
    np.testing.assert_array_equal(cut.draw_rgb(last), whole.draw_rgb(np.flatnonzero(kept)[-1:]))


def test_a_lidar_of_unknown_height_needs_one(table: dict[str, Any]) -> None:
    table["platform"] = {"base": "ucsd", "lidar": {"z": 0.0}}
    with refusal(ConfigError, field="faults.0.height"):
        parse_scenario({**table, "faults": [{"kind": "tilt"}]})
    parse_scenario({**table, "faults": [{"kind": "tilt", "height": 0.2}]})
