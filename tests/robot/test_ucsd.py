"""The UCSD layout: what is written reads back the same, and what is broken is refused in one line."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from issues import counted, messages

from moteslam.errors import ConfigError, InputError
from moteslam.robot.formats import open_recording
from moteslam.robot.formats.ucsd import read_ucsd, ucsd_sequences, write_ucsd
from moteslam.robot.platform import LidarSpec, Platform
from moteslam.robot.platforms import UCSD
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, Recording, RgbdStream

START = 1298445274.5


def make_recording(n: int = 12, beams: int = 7, seed: int = 0) -> Recording:
    rng = np.random.default_rng(seed)
    ranges = rng.uniform(0.1, 29.9, (n, beams)).astype(np.float32)
    ranges[0, 0], ranges[1, 1], ranges[2] = np.inf, np.nan, np.inf
    stamps = START + np.cumsum(rng.uniform(0.02, 0.03, n))
    stamps[5] = stamps[4]
    return Recording(
        name="made",
        platform=UCSD,
        lidar=LidarStream(stamps, ranges, -2.356, 0.7853, 0.1, 30.0, UCSD.lidar.time_increment),
        encoders=EncoderStream(stamps + 0.001, rng.integers(-50, 50, (n, 4))),
        imu=ImuStream(stamps - 0.003, rng.normal(size=(n, 3)), rng.normal(size=(n, 3))),
        rgbd=RgbdStream(stamps[::2].copy(), stamps[1::3].copy()),
    )


def written(folder: Path, **changes: Any) -> Path:
    """A folder with sequence 20, its arrays changed: ``Hokuyo_ranges=...``; None leaves the array out."""
    write_ucsd(folder, make_recording(), sequence=20)
    for name in ("Hokuyo", "Encoders", "Imu", "Kinect"):
        mine = {key.removeprefix(f"{name}_"): value for key, value in changes.items() if key.startswith(f"{name}_")}
        if mine:
            path = folder / f"{name}20.npz"
            with np.load(path) as file:
                arrays = {**file, **mine}
            np.savez(path, **{key: value for key, value in arrays.items() if value is not None})
    return folder


def test_what_ranges_mean(tmp_path: Path) -> None:
    ranges = np.full((7, 12), 5.0)
    ranges[:, 0] = [30.0, 29.999, np.inf, 0.1, 0.0999, 0.001, 0.0]
    ranges[:3, 1] = [np.nan, -1.0, -np.inf]
    recording = read_ucsd(written(tmp_path, Hokuyo_ranges=ranges))
    row = recording.lidar.ranges[0]
    np.testing.assert_array_equal(row[[0, 2]], np.inf)
    np.testing.assert_array_equal(row[[1, 3]], np.float32([29.999, 0.1]))
    assert np.isnan(row[4:]).all()
    assert np.isnan(recording.lidar.ranges[1, :3]).all()
    assert messages(recording.warnings) == ("Hokuyo20.npz: ranges: 3 ranges in 1 scan left out, NaN or negative",)


BAD = [
    ("Hokuyo_ranges", np.ones((12, 7))),
    ("Hokuyo_angle_increment", np.float64(0)),
    ("Hokuyo_range_max", np.float64(0.05)),
    ("Hokuyo_angle_increment", np.float64(7.853)),  # more than a turn
    ("Imu_angular_velocity", np.full((3, 12), 1e30)),
    ("Encoders_counts", np.full((4, 12), 30_000)),  # beyond 100 m/s
    ("Encoders_time_stamps", np.append(np.arange(11.0), np.inf)),
    ("Encoders_counts", np.full((4, 12), np.nan)),
    ("Imu_linear_acceleration", np.full((3, 12), np.nan)),
    ("Kinect_rgb_time_stamps", np.ones((2, 2))),
]


@pytest.mark.parametrize(("array", "value"), BAD)
def test_bad_arrays_are_told_with_file_and_field(tmp_path: Path, array: str, value: Any) -> None:
    name, _, field = array.partition("_")
    with pytest.raises(InputError) as caught:
        read_ucsd(written(tmp_path, **{array: value}))
    assert (Path(str(caught.value.file)).name, caught.value.field) == (f"{name}20.npz", field)
    assert "\n" not in str(caught.value)


def test_a_file_of_arrays_is_told_to_belong_to_a_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected the folder it is in"):
        open_recording(written(tmp_path) / "Hokuyo20.npz")


def test_rates_and_counts_that_no_robot_has_are_dropped_and_counted(tmp_path: Path) -> None:
    original = make_recording()
    rates, counts = original.imu.angular_velocity.T.copy(), original.encoders.counts.T.copy()
    rates[2, 3], rates[0, 7], rates[2, 8] = 1e30, -101, 99.9
    counts[1, 6] = -32_000
    recording = read_ucsd(written(tmp_path, Imu_angular_velocity=rates, Encoders_counts=counts))
    np.testing.assert_array_equal(recording.imu.angular_velocity, np.delete(rates.T, [3, 7], axis=0))
    np.testing.assert_array_equal(recording.imu.stamps, np.delete(original.imu.stamps, [3, 7]))
    np.testing.assert_array_equal(recording.encoders.counts, np.delete(counts.T, 6, axis=0))
    assert counted(recording.warnings) == [("implausible-readings", 1), ("implausible-readings", 2)]


def test_sequences_are_listed_and_chosen(tmp_path: Path) -> None:
    for sequence in (9, 20, 100):
        write_ucsd(tmp_path, make_recording(), sequence=sequence)
    (tmp_path / "Hokuyo.npz").touch()
    assert ucsd_sequences(tmp_path) == ("9", "20", "100")
    with pytest.raises(InputError, match="several sequences, expected one of 9, 20, 100"):
        open_recording(tmp_path)
    with pytest.raises(InputError, match="no sequence 7, expected one of 9, 20, 100"):
        open_recording(tmp_path, sequence=7)
    assert open_recording(tmp_path, sequence=100).name.endswith("-100")
    assert open_recording(tmp_path, sequence="9").name.endswith("-9")


def test_the_platform_comes_from_the_caller_then_the_folder_then_the_format(tmp_path: Path) -> None:
    mine = Platform(name="mine", lidar=LidarSpec(x=0.5, time_increment=1e-4))
    write_ucsd(tmp_path, make_recording().replace(platform=mine), sequence=20)
    recording = read_ucsd(tmp_path)
    assert recording.platform == mine
    assert recording.lidar.time_increment == 1e-4
    assert read_ucsd(tmp_path, platform=UCSD).platform == UCSD
    (tmp_path / "platform.toml").write_text("nmae = 'x'")
    with pytest.raises(ConfigError, match=r"platform\.toml: nmae"):
        read_ucsd(tmp_path)
    (tmp_path / "platform.toml").write_text("")
    assert read_ucsd(tmp_path).platform == UCSD
    (tmp_path / "platform.toml").write_text("[lidar]\nyaw = 0.1\n")
    expected = UCSD.model_copy(update={"lidar": UCSD.lidar.model_copy(update={"yaw": 0.1})})
    assert read_ucsd(tmp_path).platform == expected
    assert open_recording(tmp_path, platform=tmp_path / "platform.toml").platform == expected
    assert [issue.code for issue in read_ucsd(tmp_path).warnings] == ["assumed-robot"]
    (tmp_path / "platform.toml").write_text("wheels = false")
    assert read_ucsd(tmp_path).platform == UCSD.model_copy(update={"wheels": None})
    (tmp_path / "platform.toml").unlink()
    assert read_ucsd(tmp_path).platform == UCSD


def test_a_platform_file_lies_over_what_the_recording_states(tmp_path: Path) -> None:
    folder, over = tmp_path / "recording", tmp_path / "over.toml"
    folder.mkdir()
    stated = UCSD.model_copy(update={"name": "stated", "lidar": UCSD.lidar.model_copy(update={"x": 0.7})})
    write_ucsd(folder, make_recording().replace(platform=stated), sequence=20)
    over.write_text("")
    plain, empty = read_ucsd(folder), read_ucsd(folder, platform=over)
    assert empty.platform == plain.platform == stated
    assert empty.lidar.ranges.tobytes() == plain.lidar.ranges.tobytes()
    assert empty.warnings == plain.warnings == ()
    over.write_text("[wheels]\ntrack = 0.5\n[lidar]\nangle_min = -1.0\nrange_max = 2.0\n")
    changed = read_ucsd(folder, platform=over)
    assert changed.platform.lidar.x == 0.7
    assert changed.platform.wheels == UCSD.wheels.model_copy(update={"track": 0.5})
    assert changed.lidar.angle_min == -1.0
    assert changed.lidar.angle_increment == plain.lidar.angle_increment
    far = plain.lidar.ranges >= 2.0
    assert far.any()
    assert np.isinf(changed.lidar.ranges[far]).all()
    np.testing.assert_array_equal(changed.lidar.ranges[~far], plain.lidar.ranges[~far])
    # the arrays alone state nothing of wheels: those of another robot must be complete
    (folder / "platform.toml").unlink()
    with pytest.raises(ConfigError, match=r"wheels\.metres_per_count"):
        read_ucsd(folder, platform=over)
    assert [issue.code for issue in read_ucsd(folder).warnings] == ["assumed-robot"]  # 7 beams are not its lidar's
    over.write_text("[lidar]\nx = 0.2\n")
    assert [issue.code for issue in read_ucsd(folder, platform=over).warnings] == ["assumed-robot"]


@pytest.mark.parametrize("sequence", ["", "../1", "a b", "1\n"])
def test_a_sequence_that_is_no_file_name_is_refused(tmp_path: Path, sequence: str) -> None:
    with pytest.raises(ConfigError, match="sequence"):
        write_ucsd(tmp_path, make_recording(), sequence=sequence)


def test_images_are_listed_in_numeric_order_and_missing_ones_counted(tmp_path: Path) -> None:
    written(tmp_path)
    folder = tmp_path / "dataRGBD" / "Disparity20"
    folder.mkdir(parents=True)
    for index in (1, 2, 3, 4):
        (folder / f"disparity20_{index}.png").touch()
    rgbd = read_ucsd(tmp_path).rgbd
    assert rgbd.disparity_files == tuple(folder / f"disparity20_{k}.png" for k in (1, 2, 3, 4))
    assert rgbd.rgb_files == ()
    assert messages(read_ucsd(tmp_path).warnings) == ("RGB20: 6 of 6 images missing, the first rgb20_1.png",)
    (folder.parent / "RGB20").mkdir()
    (folder.parent / "RGB20" / "rgb20_1.png").touch()
    (folder / "disparity20_3.png").rename(folder / "disparity20_5.png")
    recording = read_ucsd(tmp_path)
    assert recording.rgbd.disparity_files == (*rgbd.disparity_files[:2], None, rgbd.disparity_files[3])
    assert counted(recording.warnings) == [("images-missing", 5), ("images-missing", 1), ("images-beyond-stamps", 1)]
    for path in folder.iterdir():
        path.unlink()
    recording = read_ucsd(tmp_path)
    assert recording.rgbd.disparity_files == ()
    assert messages(recording.warnings[1:]) == ("Disparity20: 4 of 4 images missing, the first disparity20_1.png",)
