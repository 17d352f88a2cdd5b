"""A recording that is still being made gives, scan by scan, what the whole recording gives."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from slam_rooms import circled_room

from moteslam.errors import ConfigError
from moteslam.robot.recording import Recording
from moteslam.sim.logged import Logging, logged
from moteslam.sim.scenario import load_scenario
from moteslam.sim.simulate import simulate
from moteslam.slam.inputs.complete import complete_scans
from moteslam.slam.run import SlamSession
from moteslam.slam.settings import resolve_config


def until(recording: Recording, stamp: float) -> Recording:
    """What has been recorded by a time [s]."""

    def grown(stream: object) -> object:
        indices = np.flatnonzero(stream.stamps <= stamp)  # type: ignore[attr-defined]
        arrays = {field.name: getattr(stream, field.name) for field in fields(stream)}  # type: ignore[arg-type]
        arrays = {name: value[indices] for name, value in arrays.items() if isinstance(value, np.ndarray)}
        return replace(stream, **arrays)  # type: ignore[type-var]

    names = ("lidar", "encoders", "odometry", "imu")
    return recording.replace(**{name: grown(getattr(recording, name)) for name in names if getattr(recording, name)})


@pytest.fixture(scope="module")
def corridor() -> Recording:
    return simulate(load_scenario("corridor").model_copy(update={"duration": 25.0})).recording


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["wheels", "logged", "no odometry"])
def test_the_same_poses_and_the_same_result(taichi: None, corridor: Recording, kind: str) -> None:
    if kind == "logged":
        corridor = logged(
            simulate(load_scenario("corridor").model_copy(update={"duration": 25.0})), Logging()
        ).recording.replace(encoders=None, imu=None, odometry=None)
    elif kind == "no odometry":
        corridor = corridor.replace(encoders=None, imu=None)
    config = resolve_config("default", ["particles=3"])
    whole = SlamSession(corridor, config)
    expected = [update.pose for update in whole]
    assert corridor.lidar is not None
    begun = corridor.lidar.stamps[0]
    first = until(corridor, begun + 4.0)
    session = SlamSession(first, config)
    poses, taken = [update.pose for update in session.take_in(complete_scans(first, config.sync))], []
    for after in np.arange(4.3, 26.0, 0.7):
        grown = until(corridor, begun + after)
        session.extend(grown)
        poses += [update.pose for update in session.take_in(complete_scans(grown, config.sync))]
        taken.append(len(poses))
    session.extend(corridor)
    poses += [update.pose for update in session]
    assert len(set(taken)) > 20
    np.testing.assert_array_equal(poses, expected)
    one, other = session.estimate(), whole.estimate()
    np.testing.assert_array_equal(one.trajectory_final.poses, other.trajectory_final.poses)
    np.testing.assert_array_equal(one.map.values, other.map.values)
    np.testing.assert_array_equal(one.diagnostics["n_eff"], other.diagnostics["n_eff"])


def test_scans_wait_for_the_readings_about_them(corridor: Recording) -> None:
    lidar, encoders, imu = corridor.lidar, corridor.encoders, corridor.imu
    assert lidar is not None
    assert encoders is not None
    assert imu is not None
    stamp = float(lidar.stamps[300])
    sweep = corridor.platform.lidar.time_increment * (lidar.ranges.shape[1] - 1)
    assert sweep > 0.01
    by_then = until(corridor, stamp)
    covered = encoders.stamps[encoders.stamps <= by_then.imu.stamps[-1]][-1]  # type: ignore[union-attr]
    expected = np.searchsorted(lidar.stamps + sweep, covered)
    assert complete_scans(by_then) == expected
    assert 290 < expected < 301
    assert complete_scans(until(corridor, stamp).replace(imu=until(corridor, stamp - 2.0).imu)) >= expected


def test_without_odometry_every_scan_is_complete() -> None:
    room = circled_room(scans=20)[0]
    assert room.lidar is not None
    assert complete_scans(room.replace(lidar=replace(room.lidar, odometry=None))) == 20


def test_a_recording_that_has_shrunk_is_another(taichi: None) -> None:
    room = circled_room(scans=40)[0]
    session = SlamSession(room, resolve_config("default", ["particles=1"]))
    assert len(list(session.take_in(30))) == 30
    with pytest.raises(ConfigError, match=r"20 scans, expected at least the 30 that were taken in"):
        session.extend(until(room, 1.95))
