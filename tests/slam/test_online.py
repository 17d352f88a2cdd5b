"""Messages as they come give the bytes of the recording; odometry that lags or fails is never a robot that stands."""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from parts.runs import add, fed, messages
from refusals import refusal
from slam_messages import cut, first, jumping, logged, platform_of, sparse_corridor
from slam_rooms import circled_room

from moteslam.errors import ConfigError, InputError
from moteslam.robot.formats import open_recording
from moteslam.robot.recording import OdometryStream, Recording
from moteslam.sim.scenario import load_scenario
from moteslam.sim.simulate import simulate
from moteslam.slam.config import resolve_config
from moteslam.slam.estimate import Estimate
from moteslam.slam.filter.certainty import LocalisationState
from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.inputs.live import LiveInputs
from moteslam.slam.inputs.odometry_path import KEPT, MOST_KEPT, OdometryReadings, odometry_path
from moteslam.slam.inputs.synchronise import dead_reckon
from moteslam.slam.online import OnlineSlam, run_slam

pytestmark = pytest.mark.usefixtures("taichi")

PRESETS = {"paper": ["particles=20"], "default": ["particles=5"]}


@pytest.fixture(scope="module")
def corridor() -> Recording:
    return sparse_corridor()


@cache
def in_the_corridor(preset: str) -> Estimate:
    return run_slam(sparse_corridor(), resolve_config(preset, PRESETS[preset]))


def check(recording: Recording, preset: str, **late: float) -> None:
    config = resolve_config(preset, PRESETS[preset])
    slam = OnlineSlam(platform_of(recording), config, seed=3)
    updates = list(fed(slam, recording, **late))
    there, here = run_slam(recording, config, seed=3), slam.estimate()
    assert updates[-1].index == len(here.trajectory) - 1
    for name in ("trajectory", "trajectory_final", "dead_reckoning"):
        one, other = getattr(here, name), getattr(there, name)
        assert one.stamps.tobytes() == other.stamps.tobytes()
        assert one.poses.tobytes() == other.poses.tobytes(), name
    assert here.map.values.tobytes() == there.map.values.tobytes()
    assert here.particle_paths.tobytes() == there.particle_paths.tobytes()
    assert here.covariances.tobytes() == there.covariances.tobytes()
    assert [loop.accepted for loop in here.loops] == [loop.accepted for loop in there.loops]
    assert about(here) == about(there)
    told = [issue.code for issue in here.warnings]
    assert told.count("no-gyro") <= 1


def about(estimate: Estimate) -> dict[str, bytes]:
    return {name: values.tobytes() for name, values in estimate.diagnostics.items() if name != "seconds"}


def hanging(recording: Recording) -> Recording:
    """The gyro repeats its reading after three seconds up to the tenth."""
    imu = recording.imu
    velocity, since = np.array(imu.angular_velocity), imu.stamps - imu.stamps[0]
    velocity[(since > 3) & (since < 10)] = velocity[np.searchsorted(since, 3.0)]
    return recording.replace(imu=replace(imu, angular_velocity=velocity))


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize(
    ("change", "late"),
    [
        pytest.param(lambda r: r, 0.0, id="wheels"),
        pytest.param(logged, 0.05, id="logged late"),
        pytest.param(jumping, 0.3, id="jumping late", marks=pytest.mark.slow),
        pytest.param(hanging, 0.3, id="gyro hangs late", marks=pytest.mark.slow),
    ],
)
def test_messages_give_the_bytes_of_the_recording_however_late_the_odometry_is(
    corridor: Recording, change: Callable[[Recording], Recording], late: float, preset: str
):
    check(cut(change(corridor), 150), preset, encoders=late, odometry=late, imu=late)


@pytest.mark.slow
@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize(
    "log",
    ["intel/intel_key_scans.log.gz", "intel/intel_raw_part.log.gz", "key_scans/fhw.log.gz"],
)
def test_a_real_log_does_too(data_folder: Path, log: str, preset: str):
    check(cut(open_recording(data_folder / log), 90), preset)


@pytest.mark.slow
@pytest.mark.parametrize("preset", PRESETS)
def test_a_minute_of_a_drive_does_too(preset: str):
    check(simulate(load_scenario("slippery", platform="lms200").with_(duration=60.0), seed=1).recording, preset)


@pytest.mark.slow
@pytest.mark.parametrize("preset", PRESETS)
def test_wheels_that_fall_silent_are_no_robot_that_stands(corridor: Recording, preset: str):
    """In mid-drive; the scans and the gyro go on."""
    config, wheels = resolve_config(preset, PRESETS[preset]), corridor.encoders
    left = int(np.searchsorted(wheels.stamps, wheels.stamps[0] + 9.0))
    recording = corridor.replace(encoders=first(wheels, left))
    slam = OnlineSlam(platform_of(recording), config, patience=0.5)
    states = {update.index: update.state for update in fed(slam, recording)}
    found, whole = slam.estimate(), in_the_corridor(preset)
    lost = found.trajectory.stamps > corridor.lidar.stamps[0] + 9.2
    (issue,) = [issue for issue in found.warnings if issue.code == "no-odometry"]
    assert issue.count == pytest.approx(lost.sum(), abs=5)
    off = np.hypot(*(found.trajectory.poses - whole.trajectory.poses)[:, :2].T)
    assert off[found.trajectory.stamps < corridor.lidar.stamps[0] + 8.9].max() < 0.02
    if preset == "default":  # the scans alone say how it drives
        assert off.max() < 0.1
    else:  # it has no other motion than the odometry's, and says so
        assert off.max() > 1.0
        assert all(states[k] != LocalisationState.SURE for k in np.flatnonzero(off > 0.5).tolist() if k in states)


def test_the_papers_filter_without_any_odometry_is_not_sure():
    recording, _ = circled_room(scans=60)
    slam = OnlineSlam(platform_of(recording), resolve_config("paper", ["particles=5"]), patience=0.0)
    assert slam.warnings == ()
    updates = [slam.add_scan(ranges, 0.1 * k) for k, ranges in enumerate(recording.lidar.ranges)]
    assert all(update is None or update.state != LocalisationState.SURE for update in updates[10:])
    assert "no-odometry" in [issue.code for issue in slam.warnings]
    assert "no-odometry" in [issue.code for issue in slam.estimate().warnings]


def test_what_repeats_is_told_at_its_scans_though_the_first_came_before_any_odometry():
    """The driver gives the scan of 4.0 s again for a second."""
    recording, true = circled_room(scans=80, drift=0.0)
    slam = OnlineSlam(platform_of(recording), resolve_config("default", ["particles=1"]), patience=0.0)
    for k, ranges in enumerate(recording.lidar.ranges):
        if k >= 15:
            slam.add_odometry(0.1 * k, true[k])
        slam.add_scan(recording.lidar.ranges[40] if 40 < k <= 50 else ranges, 0.1 * k)
    (issue,) = [issue for issue in slam.estimate().warnings if issue.code == "scans-repeat"]
    assert issue.count == 10
    assert issue.message.startswith("from 4.10 to 5.00 s")


def test_an_imu_of_which_nothing_comes_is_told_while_driving(corridor: Recording):
    """Wheel counts wait for it, and scans with them."""
    slam = OnlineSlam(platform_of(corridor), resolve_config("paper", ["particles=2"]))
    told = dict[str, str]()
    for _ in islice(fed(slam, corridor.replace(imu=None)), 20):
        told |= {issue.code: issue.message for issue in slam.warnings}
    assert "scans, wait 0.5 s for one" in told["no-gyro"]
    assert [issue.code for issue in slam.estimate().warnings].count("no-gyro") == 1


def test_odometry_that_comes_again_counts_what_was_driven_without_it_once(corridor: Recording):
    """Two seconds of it arrive late, when the scans have not waited for them."""
    wheels = corridor.encoders
    slam = OnlineSlam(platform_of(corridor), resolve_config("default", PRESETS["default"]), patience=0.5)
    late = (wheels.stamps > wheels.stamps[0] + 9) & (wheels.stamps < wheels.stamps[0] + 11)
    list(fed(slam, corridor, encoders=np.where(late, wheels.stamps[late][-1] - wheels.stamps, 0.0)))
    found, whole = slam.estimate(), in_the_corridor("default")
    assert np.hypot(*(found.dead_reckoning.poses - whole.dead_reckoning.poses)[:, :2].T).max() < 0.02
    assert np.hypot(*(found.trajectory.poses - whole.trajectory.poses)[:, :2].T).max() < 0.05
    assert "no-odometry" in [issue.code for issue in found.warnings]


def test_odometry_that_repeats_its_last_pose_for_minutes_is_no_robot_that_stands():
    """At 100 Hz, for longer than its readings are kept."""
    recording, _ = circled_room(scans=3)
    live = LiveInputs(platform_of(recording), SyncConfig(), max_range=np.inf, patience=1.0)
    dark = np.full(recording.lidar.ranges.shape[1], np.inf, np.float32)
    for k in range(6500):
        live.arrives("odometry", k / 100)
        live.odometry_in.add_poses(np.array([k / 100]), np.array([(0.005 * min(k, 300), 0.0, 0.0)]))
        if k % 50 == 0:
            live.arrives("lidar", k / 100)
            live.add_scan(dark, k / 100, None)
            live.take_next()
    assert len(live.odometry_in.path.stamps) <= MOST_KEPT + KEPT
    assert live.measured[1:6].all()
    assert not live.measured[10:].any()


def test_the_odometry_is_integrated_once_a_scan(corridor: Recording, monkeypatch: pytest.MonkeyPatch):
    """Not at every message: the gyro alone gives several a scan."""
    calls, integrate = [], OdometryReadings.integrate
    monkeypatch.setattr(
        OdometryReadings, "integrate", lambda self, waited: (calls.append(0), integrate(self, waited=waited))
    )
    slam, recording = OnlineSlam(platform_of(corridor), resolve_config("paper", ["particles=5"])), cut(corridor, 50)
    list(fed(slam, recording))
    assert len(slam) == 50
    assert len(calls) <= 52
    assert len(recording.imu.stamps) > 4 * 50


@pytest.mark.slow
def test_what_is_kept_and_what_a_scan_costs_does_not_grow_with_the_scans():
    """A robot that stands: its scans are forgotten, and the readings beyond those that others are compared with."""
    recording, _ = circled_room(scans=3)
    slam = OnlineSlam(platform_of(recording), resolve_config("paper", ["particles=5"]))
    ranges = np.array(recording.lidar.ranges[0])
    for k in range(3000):
        slam.add_odometry(k / 10, (0.0, 0.0, 0.0))
        slam.add_scan(ranges, k / 10)
    live = slam._taken
    assert isinstance(live, LiveInputs)
    assert len(live) == 3000
    assert len(live.scans) == 1
    assert max(len(live._tail), len(live._ranges)) <= 2 * KEPT
    assert len(live.odometry_in.path.stamps) <= 2 * KEPT + MOST_KEPT


COUNTS, POSE = (0,) * 4, (0,) * 3


@pytest.mark.parametrize(
    ("add", "error", "field", "expected"),
    [
        (lambda slam: slam.add_scan([1.0, 2.0], 0.0), InputError, "ranges", ""),
        (lambda slam: slam.add_scan(np.ones((2, 2)), 0.0), InputError, "lidar.ranges", ""),
        (lambda slam: slam.add_scan(np.ones(360), "12"), InputError, "lidar.stamp", "a number, not text"),
        (lambda slam: [slam.add_imu(stamp, 0.0) for stamp in (1.0, 0.5)], InputError, "imu.stamp", ""),
        (lambda slam: slam.add_imu(0.0, np.inf), InputError, "imu.yaw_rate", ""),
        (lambda slam: slam.add_odometry(0.0), InputError, "odometry", ""),
        (lambda slam: slam.add_odometry(0.0, (0.0, np.nan, 0.0)), InputError, "odometry.pose", ""),
        (lambda slam: slam.add_odometry(0.0, ("a", 0.0, 0.0)), InputError, "odometry.pose", ""),
        (lambda slam: slam.add_odometry(0.0, counts=(1.5, 0, 0, 0)), InputError, "odometry.counts", ""),
        (lambda slam: slam.add_odometry(None, POSE), InputError, "odometry.stamp", "a number, not NoneType"),
        (lambda slam: slam.add_odometry(1.3e12, POSE), InputError, "odometry.stamp", r"seconds below 1e\+11"),
        (
            lambda slam: (slam.add_odometry(1, counts=COUNTS), slam.add_odometry(2, POSE)),
            *(InputError, "odometry", "counts as"),
        ),
        (
            lambda slam: (slam.add_odometry(1, POSE), slam.add_odometry(2, counts=COUNTS)),
            *(InputError, "odometry", "poses as"),
        ),
        (lambda _: wheelless().add_odometry(0.0, counts=COUNTS), InputError, "counts", ""),
        (lambda slam: slam.estimate(), ConfigError, None, ""),
    ],
)
def test_messages_that_make_no_sense_are_refused(
    corridor: Recording, add: Callable[[OnlineSlam], object], error: type, field: str | None, expected: str
):
    with refusal(error, f"expected {expected}" if expected else None, field=field) as caught:
        add(OnlineSlam(platform_of(corridor).model_copy(update={"imu": None})))
    assert "float64" not in str(caught.value)


def wheelless() -> OnlineSlam:
    return OnlineSlam(platform_of(circled_room(scans=3)[0]))


def test_ranges_that_drivers_report_where_there_is_no_endpoint_are_none():
    recording, _ = circled_room(scans=3)
    platform = platform_of(recording)
    lidar = platform.lidar.model_copy(update={"range_min": 0.1, "range_max": 8.0, "no_return": (6.5, 0.0)})
    live = LiveInputs(platform.model_copy(update={"lidar": lidar}), SyncConfig(), max_range=np.inf, patience=1.0)
    ranges = np.ones(lidar.beams)
    ranges[:6] = 0.0, 6.5, 65.5, np.inf, 8.0, np.nan  # as far as it reaches, too
    live.add_scan(ranges, 0.0, None)
    taken = live.waiting[0].ranges
    np.testing.assert_array_equal(taken[:6], (*[np.inf] * 5, np.nan))
    assert (taken[6:] == 1).all()


@pytest.fixture(scope="module")
def office() -> Recording:
    """A minute in the office at five scans a second, with odometry poses: it turns enough to be checked."""
    scenario = load_scenario("office").with_(platform="turtlebot3", duration=60.0)
    recording = simulate(scenario, seed=0).recording
    path = dead_reckon(recording)
    return recording.replace(encoders=None, odometry=OdometryStream(path.stamps, path.poses))


def wrong(
    recording: Recording, *, ranges: float = 1.0, poses: tuple[float, ...] = (1, 1, 1), rates: float = 1.0, **how: float
) -> Recording:
    """Figures multiplied, the beams in the other order, the stamps from 0 and multiplied."""
    lidar, odometry, imu = recording.lidar, recording.odometry, recording.imu
    beams = slice(None, None, -1 if "turned" in how else 1)

    def at(stamps: np.ndarray) -> np.ndarray:
        return (stamps - lidar.stamps[0] + 1) * how["stamps"] if "stamps" in how else stamps

    return recording.replace(
        lidar=replace(lidar, stamps=at(lidar.stamps), ranges=lidar.ranges[:, beams] * np.float32(ranges)),
        odometry=OdometryStream(at(odometry.stamps), odometry.poses * poses),
        imu=replace(imu, stamps=at(imu.stamps), angular_velocity=imu.angular_velocity * rates),
    )


CHEAP = ["particles=2"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "code"),
    [
        ({}, None),
        ({"ranges": 100.0}, "blind-scans"),
        ({"poses": (1, 1, 57.3)}, "odometry-headings"),
        ({"turned": True}, "mirrored"),
        ({"stamps": 1e3}, "implausible-speed"),
    ],
    ids=lambda value: str(value) if isinstance(value, dict) else "",
)
def test_at_the_end_messages_are_told_what_a_recording_is(office: Recording, fault: dict[str, Any], code: str | None):
    recording = wrong(office, **fault)
    slam = OnlineSlam(platform_of(office), resolve_config("paper", CHEAP), name="base")
    list(fed(slam, recording))
    # to find out is not for a running robot, but what scans show is
    assert (code in [issue.code for issue in slam.warnings]) == (code == "blind-scans")
    found = {issue.code: issue for issue in slam.estimate().warnings}
    assert found == {issue.code: issue for issue in slam.warnings}
    assert code in found if code else not found.keys() - {"lidar-mount", "no-mount"}, found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "stream"),
    [
        ({"ranges": 1000.0}, "lidar: the median of its ranges is"),
        ({"poses": (1e3, 1e3, 1)}, "odometry: moves at"),
        ({"rates": 180 / np.pi}, "imu: turns at"),
    ],
    ids=["mm", "mm-poses", "deg-s"],
)
def test_units_in_which_nothing_is_left_end_a_run_at_once_as_they_do_a_recordings(
    office: Recording, fault: dict[str, Any], stream: str
):
    recording = wrong(office, **fault)
    slam = OnlineSlam(platform_of(office), resolve_config("paper", CHEAP), name="base")
    with refusal(InputError, f"^base: {stream}", file="base") as caught:
        list(fed(slam, recording))
    assert len(slam) < (10 if "ranges" in fault else len(office.lidar))
    (told,) = [issue.message for issue in slam.warnings if issue.message in str(caught.value)]
    for message in (lambda: slam.add_scan(office.lidar.ranges[0], 1e9), lambda: slam.add_imu(1e9, 0.0)):
        with pytest.raises(InputError, match=stream):  # nothing is made of those that follow either
            message()
    assert slam.finish() is None
    assert [issue.message for issue in slam.estimate().warnings].count(told) == 1
    with pytest.raises(InputError, match=stream):
        run_slam(recording, resolve_config("paper", CHEAP))


@pytest.mark.slow
@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("nothing", [0.0, np.inf])
def test_scans_that_see_nothing_are_told_at_once_and_nobody_is_sure_for_long(
    corridor: Recording, nothing: float, preset: str
):
    recording = cut(corridor, 150)
    blind = replace(recording.lidar, ranges=np.full_like(recording.lidar.ranges, nothing))
    config = resolve_config(preset, [*PRESETS[preset], "backend.method=none"])
    slam, states = OnlineSlam(platform_of(recording), config), []
    for update in fed(slam, recording.replace(lidar=blind)):
        (told,) = [issue for issue in slam.warnings if issue.code == "blind-scans"]
        assert told.count == len(slam)
        states.append(update.state)
    assert states[-1] != LocalisationState.SURE
    assert told in slam.estimate().warnings


@pytest.mark.parametrize("order", ["os", "sso", "ooosss"])
@pytest.mark.parametrize("late", [1.3e9, -1.3e9])
def test_scans_and_odometry_by_clocks_far_apart_are_refused_again_and_again(order: str, late: float):
    recording, _ = circled_room(scans=3)
    slam = OnlineSlam(platform_of(recording), resolve_config("paper", CHEAP))
    refused = []
    for k in range(100):
        try:
            if order[k % len(order)] == "s":
                slam.add_scan(recording.lidar.ranges[0], 1.3e9 + late + k / 10)
            else:
                slam.add_odometry(1.3e9 + k / 10, (k / 50, 0.0, 0.0))
        except InputError as error:
            refused.append(error)
    assert len(refused) > 30
    assert all("expected one clock" in str(error) for error in refused)
    assert {error.field for error in refused} <= {"lidar.stamp", "odometry.stamp"}


@pytest.mark.parametrize("ahead", [1.0, 900.0])
def test_a_scan_of_a_wrong_stamp_does_not_end_a_run(corridor: Recording, ahead: float):
    """That of one scan in mid drive is ahead; it is left out, and the next ones go on."""
    config, lidar = resolve_config("default", PRESETS["default"]), corridor.lidar
    slam = OnlineSlam(platform_of(corridor), config, seed=3)
    for _, _, stream, index in messages(corridor, {}):
        if (stream, index) == ("lidar", len(lidar) // 2):
            slam.add_scan(lidar.ranges[index], lidar.stamps[index] + ahead)
        else:
            add(slam, corridor, stream, index)
    slam.finish()
    found, whole = slam.estimate(), run_slam(corridor, config, seed=3)
    assert len(found.trajectory) == len(lidar) - 1
    assert np.hypot(*(found.trajectory_final.poses[-1, :2] - whole.trajectory_final.poses[-1, :2])) < 0.01
    (told,) = [issue.message for issue in found.warnings if issue.code == "other-clock"]
    assert "is left out" in told


@pytest.mark.parametrize(("late", "told"), [(0.0, False), (1000.0, True), (-1000.0, True)])
def test_scans_and_odometry_at_no_time_together_are_told(late: float, told: bool):
    recording, _ = circled_room(scans=3)
    slam = OnlineSlam(platform_of(recording), resolve_config("paper", CHEAP))
    for k in range(150):
        slam.add_odometry(2000.0 + k / 10, (k / 50, 0.0, 0.0))
        slam.add_scan(recording.lidar.ranges[0], 2000.0 + late + k / 10)
    assert any("overlap in time" in issue.message for issue in slam.warnings) == told


@pytest.mark.parametrize(
    ("stamps", "places", "too_fast"),
    [
        (np.arange(20) / 10, np.maximum(np.arange(20) - 5, 0) * 50.0, True),
        (np.arange(20) / 10, np.where(np.arange(20) < 9, 0.0, 300.0), False),  # a jump
        (np.arange(20) / 10, np.where(np.arange(20) == 9, 300.0, 0.0), False),  # and back
        (np.repeat(np.arange(4) / 2, 20) + np.tile(np.arange(20) / 1000, 4), np.arange(80) * 0.025, False),  # bursts
    ],
    ids=["mm", "a jump", "a jump and back", "bursts"],
)
@pytest.mark.parametrize("with_scans", [False, True])
def test_odometry_faster_than_any_robot_is_refused_within_a_second(
    stamps: np.ndarray, places: np.ndarray, too_fast: bool, with_scans: bool
):
    recording, _ = circled_room(scans=3)
    slam, taken = OnlineSlam(platform_of(recording), resolve_config("paper", CHEAP)), []
    refused = pytest.raises(InputError, match="odometry: moves at 500 m/s") if too_fast else nullcontext()
    with refused:
        for stamp, x in zip(stamps.tolist(), places.tolist(), strict=True):
            if with_scans:
                slam.add_scan(recording.lidar.ranges[0], stamp, (x, 0.0, 0.0))
            else:
                slam.add_odometry(stamp, (x, 0.0, 0.0))
            taken.append(stamp)
    assert len(taken) in ((15, 16) if too_fast else (len(stamps),))


def test_an_update_shows_its_state(corridor: Recording):
    slam = OnlineSlam(platform_of(corridor), resolve_config("paper", CHEAP))
    assert "state=SURE" in repr(next(fed(slam, corridor)))


def test_the_latest_message_has_every_update_of_its_own(corridor: Recording):
    path = odometry_path(corridor, SyncConfig())
    rarely = OdometryStream(path.stamps[::25], path.poses[::25])
    recording = cut(corridor.replace(encoders=None, imu=None, odometry=rarely), 60)
    slam = OnlineSlam(platform_of(recording), resolve_config("paper", CHEAP))
    calls = [[update.index for update in slam.latest] for _ in fed(slam, recording)]
    assert max(map(len, calls)) > 1
    assert [index for call in calls for index in call] == list(range(len(slam)))
