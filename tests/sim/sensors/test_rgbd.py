"""The simulated Kinect: when it fires, what it sees, and how it is written."""

import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from sim_drives import moving
from slam_rooms import tiled_room
from ucsd_robot import CAMERA, KINECT

from moteslam.errors import OutputError
from moteslam.robot.formats import open_recording
from moteslam.robot.platform import CameraSettings
from moteslam.robot.rgbd import camera_frames
from moteslam.sim.actors.actors import Tracks
from moteslam.sim.output import write_simulation
from moteslam.sim.robot.drive import Drive
from moteslam.sim.sensors.clock import EPOCH
from moteslam.sim.sensors.echoes import Scene
from moteslam.sim.sensors.rgbd import Camera, CameraFrames
from moteslam.sim.simulate import Simulation, simulate
from moteslam.sim.world.floor import FloorSettings
from moteslam.sim.world.layout import Layout, Room
from moteslam.sim.world.pieces import Box
from moteslam.sim.world.world import World

pytestmark = pytest.mark.usefixtures("taichi")

ROOM = World.of(Layout(rooms=(Room(corner=(0, 0), size=(12, 9)),), boxes=(Box(centre=(5, 3.4), size=(0.6, 0.6)),)))
START = (3.0, 3.0, 0.3)
FLOOR = FloorSettings(seed=3)
STILL = CameraSettings(rate=30.0, nearest=0.4, farthest=8.0, grazing=0.05)  # Nothing is random but the phase


def frames_of(settings: CameraSettings = STILL, seed: int = 0, run: Drive | None = None) -> CameraFrames:
    run = run or moving(START, (0.5, 0.2, 0.4), 4.0)
    camera = Camera(CAMERA, settings, FLOOR, float(run.stamps[-1]), seed)
    return camera.read(run, Scene(ROOM, run.tracks))


def test_frames_come_at_the_rate_and_out_of_phase() -> None:
    frames = frames_of()
    for stamps in (frames.rgb.stamps, frames.disparity.stamps):
        assert np.diff(stamps) == pytest.approx(1 / 30, abs=1e-6)
        assert 0 < stamps[0] - EPOCH < 0.6
        assert 3.0 < stamps[-1] - EPOCH < 4.0
    assert abs(frames.rgb.stamps[0] - frames.disparity.stamps[0]) <= 1 / 60
    for times, poses in ((frames.rgb.times, frames.rgb.poses), (frames.disparity.times, frames.disparity.poses)):
        assert poses == pytest.approx(np.array(START) + times[:, None] * (0.5, 0.2, 0.4))


def test_frames_are_lost_as_on_the_real_robot() -> None:
    frames = frames_of(KINECT, run=moving(START, (0.0, 0.0, 0.0), 120.0))
    for stamps in (frames.rgb.stamps, frames.disparity.stamps):
        steps = np.diff(stamps)
        assert (steps > 0).all()
        assert np.median(steps) == pytest.approx(0.0332, abs=0.0005)  # measured 0.0331 to 0.0332
        assert (steps > 0.1).mean() == pytest.approx(0.15, abs=0.04)  # 0.14 to 0.16
        assert np.median(steps[steps > 0.1]) == pytest.approx(0.2, abs=0.01)
        assert len(stamps) / 120 == pytest.approx(18.5, abs=2.5)  # 18.6 to 19.6


def test_noise_is_as_large_as_its_setting() -> None:
    noise = {"disparity_noise": 2.0, "dropout": 0.1, "colour_noise": 3}
    plain, noisy = frames_of(), frames_of(STILL.model_copy(update=noise))
    index = np.array((3, 4))
    a, b = plain.draw_disparity(index).astype(int), noisy.draw_disparity(index).astype(int)
    seen = a < 2047
    assert (b[seen] == 2047).mean() == pytest.approx(0.1, abs=0.01)
    both = seen & (b < 2047)
    assert (b - a)[both].std() == pytest.approx(2.02, abs=0.1)
    assert abs((b - a)[both].mean()) < 0.05
    error = noisy.draw_rgb(index).astype(int) - plain.draw_rgb(index)
    assert error[:, 300:].std() == pytest.approx(3, abs=0.3)
    assert (b[0] != b[1]).any()


def test_people_stand_before_the_floor() -> None:
    spot = np.array((4.2, 3.37))  # ahead
    discs = np.tile(np.array((*spot, 0.15), np.float32), (500, 1, 1))
    nothing = np.zeros((500, 0, 4), np.float32)
    person = Tracks(100.0, discs, nothing, np.zeros(0, np.int16), np.tile(spot, (500, 1, 1)))
    without = frames_of(run=moving(START, (0, 0, 0), 3.0)).draw_disparity(np.array([0]))[0]
    withal = frames_of(run=moving(START, (0, 0, 0), 3.0, person)).draw_disparity(np.array([0]))[0]
    assert (withal < without).mean() > 0.02


def test_same_seed_same_images() -> None:
    index = np.array((0, 5))
    first, again, other = (frames_of(KINECT, seed) for seed in (1, 1, 2))
    assert first.rgb.stamps.tobytes() == again.rgb.stamps.tobytes() != other.rgb.stamps.tobytes()
    for draw in ("draw_rgb", "draw_disparity"):
        a, b, c = (getattr(frames, draw)(index).tobytes() for frames in (first, again, other))
        assert a == b != c
    assert (first.draw_rgb(np.array([5]))[0] == first.draw_rgb(index)[1]).all()  # whatever it is drawn along with


@pytest.fixture(scope="module")
def run(taichi: None) -> Simulation:
    return tiled_room(rate=10.0)


def test_the_camera_leaves_the_other_sensors_alone(run: Simulation) -> None:
    without = simulate(run.scenario.model_copy(update={"camera": None}))
    assert without.recording.rgbd is without.frames is None
    assert run.recording.lidar.ranges.tobytes() == without.recording.lidar.ranges.tobytes()
    for stream in ("lidar", "encoders", "imu"):
        assert (getattr(run.recording, stream).stamps == getattr(without.recording, stream).stamps).all()


def test_what_is_written_reads_back_as_it_was_drawn(run: Simulation, tmp_path: Path) -> None:
    announced, shares = list[str](), list[float]()
    told = {"announce": announced.append, "progress": lambda _, share: shares.append(share)}
    write_simulation(tmp_path, run, map_resolution=0.1, **told)
    floor = cv2.imread(str(tmp_path / "truth_floor.png"))
    assert floor.shape == (70, 90, 3)
    assert (floor[::-1, :, ::-1] == run.true_floor(0.1).values).all()
    assert "origin: [0.0, 0.0, 0.0]" in (tmp_path / "truth_floor.yaml").read_text()
    count = len(run.frames.rgb.stamps) + len(run.frames.disparity.stamps)
    assert len(announced) == 1
    assert re.match(rf"{count} images of about \d+\.\d MB", announced[0])
    assert shares[-1] == 1.0
    assert sorted(shares) == shares
    recording = open_recording(tmp_path)
    assert recording.warnings == ()
    frames = list(camera_frames(recording.rgbd))
    assert len(frames) > 10
    at, rgb_at = (
        np.searchsorted(shots.stamps, [stamp])
        for shots, stamp in ((run.frames.disparity, frames[3].stamp), (run.frames.rgb, frames[3].rgb_stamp))
    )
    assert (run.frames.draw_disparity(at)[0] == frames[3].disparity).all()
    assert (run.frames.draw_rgb(rgb_at)[0] == frames[3].rgb).all()


def test_a_full_disk_is_refused_before_the_first_image(
    run: Simulation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(10, 9, 1000))
    with pytest.raises(OutputError, match="free, expected"):
        write_simulation(tmp_path, run)
    assert not (tmp_path / "dataRGBD").exists()
