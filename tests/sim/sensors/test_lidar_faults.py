"""A cart in the lidar's view and a lidar mounted aslant: what the beams measure, when, and nothing else."""

from typing import Any

import numpy as np
import pytest
from sim_drives import room_table

from moteslam.errors import ConfigError
from moteslam.robot.noise import Noise
from moteslam.robot.recording import LidarStream
from moteslam.sim.scenario import parse_scenario
from moteslam.sim.sensors.clock import EPOCH
from moteslam.sim.sensors.faults import Cart
from moteslam.sim.simulate import Simulation, simulate

START, DURATION = 4.0, 3.0


def run(table: dict[str, Any], *faults: dict[str, Any], **changes: Any) -> Simulation:
    noise = Noise().model_dump()
    noise["lidar"]["range_noise"] = 0.01
    return simulate(parse_scenario({**table, "noise": noise, **changes, "faults": list(faults)}), seed=2)


@pytest.fixture(scope="module")
def plain(taichi: None) -> Simulation:
    return run(room_table())


def within(stream: LidarStream, *, margin: float = 0.0) -> np.ndarray:
    """Which scans are in the fault, or within a margin of it."""
    since = stream.stamps - EPOCH
    return (since >= START - margin) & (since < START + DURATION + margin)


def same_elsewhere(ours: Simulation, theirs: Simulation) -> None:
    """All but the scans of the fault, and those that are being taken as it begins and ends, are the same bytes."""
    outside = ~within(theirs.recording.lidar, margin=0.03)
    assert ours.recording.lidar.ranges[outside].tobytes() == theirs.recording.lidar.ranges[outside].tobytes()
    assert ours.truth.poses.tobytes() == theirs.truth.poses.tobytes()
    for stream in ("encoders", "imu"):
        assert getattr(ours.recording, stream).stamps.tobytes() == getattr(theirs.recording, stream).stamps.tobytes()


def test_a_cart_ahead_is_where_it_is_said_to_be(table: dict[str, Any], plain: Simulation) -> None:
    cart = {"kind": "cart", "start": START, "duration": DURATION, "distance": 0.8, "width": 0.6}
    simulation = run(table, cart)
    same_elsewhere(simulation, plain)
    stream, seen = simulation.recording.lidar, within(simulation.recording.lidar, margin=-0.03)
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


def test_a_wall_that_is_nearer_hides_the_cart(table: dict[str, Any], plain: Simulation) -> None:
    far = run(table, {"kind": "cart", "start": START, "duration": DURATION, "distance": 15.0})
    assert far.recording.lidar.ranges.tobytes() == plain.recording.lidar.ranges.tobytes()


def test_a_lidar_mounted_aslant_measures_the_floor_ahead(table: dict[str, Any], plain: Simulation) -> None:
    tilt = {"kind": "tilt", "start": START, "duration": DURATION, "pitch": 0.08, "height": 0.2}
    simulation = run(table, tilt)
    same_elsewhere(simulation, plain)
    stream, seen = simulation.recording.lidar, within(simulation.recording.lidar, margin=-0.03)
    down = 0.08 * np.cos(stream.angles)
    floor = 0.2 / np.sin(down)
    for ours, level in zip(stream.ranges[seen], plain.recording.lidar.ranges[seen], strict=True):
        meets = (down > 0.02) & (level > floor + 0.2)
        assert meets.any()
        assert np.abs(ours - floor)[meets].max() < 0.06
        walls = ~meets & (level < floor - 0.2)
        assert np.abs(ours - level)[walls].max() < 0.05
    assert (stream.ranges[seen] < plain.recording.lidar.ranges[seen] - 1.0).any()


def test_a_tilt_takes_the_height_of_the_robots_lidar_and_a_roll(table: dict[str, Any], plain: Simulation) -> None:
    stream = run(table, {"kind": "tilt", "pitch": 0.0, "roll": 0.3}).recording.lidar
    right = np.abs(stream.angles + np.pi / 2) < 0.1
    floor = 0.51435 / np.sin(0.3 * -np.sin(stream.angles[right]))
    assert np.abs(np.minimum(stream.ranges[:, right] - floor, 0.0)).max() < 0.06
    assert np.median(stream.ranges[:, right] - floor) < 0.01
    left = np.abs(stream.angles - np.pi / 2) < 0.1  # these look up
    assert stream.ranges[:, left].max() > 5.0


def test_a_floor_at_a_glance_sends_nothing_back(table: dict[str, Any], plain: Simulation) -> None:
    stream = run(table, {"kind": "tilt", "pitch": 0.08, "height": 0.2, "grazing": 0.5}).recording.lidar
    ahead = stream.ranges[:, stream.ranges.shape[1] // 2]
    assert np.isinf(ahead).mean() > 0.5
    assert ahead[np.isfinite(ahead)].max() < 0.2 / np.sin(0.08) + 0.06


def test_a_lidar_of_unknown_height_needs_one(table: dict[str, Any]) -> None:
    table["platform"] = {"base": "ucsd", "lidar": {"z": 0.0}}
    with pytest.raises(ConfigError) as caught:
        parse_scenario({**table, "faults": [{"kind": "tilt"}]})
    assert caught.value.field == "faults.0.height"
    parse_scenario({**table, "faults": [{"kind": "tilt", "height": 0.2}]})
