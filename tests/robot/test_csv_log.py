"""CSV logs: the guide's example, columns and units, what is refused, and round trips."""

import gzip
import re
from pathlib import Path

import numpy as np
import pytest
from converted import assert_held
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from issues import counted, messages
from refusals import refusal

from moteslam.errors import ConfigError, InputError, OutputError
from moteslam.robot.formats import format_of, open_recording
from moteslam.robot.formats.csv_log import is_csv_log, read_csv_log
from moteslam.robot.formats.written import write_csv
from moteslam.robot.platforms import UCSD
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, OdometryStream, Recording

GUIDE = Path(__file__).parents[2] / "docs" / "guide" / "own-logs.md"

LIDAR = """
[lidar]
file = "scans.csv"
stamp = "t"
ranges = "r0..r2"
angle_min = -1.0
angle_increment = 0.5
range_max = 10.0
"""
SCANS = "t,r0,r1,r2\n0,1.0,2.0,3.0\n0.5,1.5,,inf\n1,0,nan,12\n"


def write(folder: Path, description: str = LIDAR, **files: str) -> Path:
    """A description and its CSV files; gives the former."""
    for name, text in ({"scans": SCANS} | files).items():
        (folder / f"{name}.csv").write_text(text)
    path = folder / "log.toml"
    path.write_text(description)
    return path


def lidar_of(path: Path) -> LidarStream:
    return open_recording(path).lidar


def test_the_example_of_the_guide(tmp_path: Path) -> None:
    examples = re.findall(r"<!-- (\S+) -->\n```\w+\n(.*?)```", GUIDE.read_text("utf-8"), re.DOTALL)
    for name, text in examples:
        (tmp_path / name).write_text(text)
    recording = open_recording(tmp_path / "walk.toml")
    assert (recording.name, recording.platform.name) == ("walk", "mine")
    np.testing.assert_allclose(recording.lidar.stamps, [1.0, 1.1, 1.2])
    np.testing.assert_array_equal(recording.lidar.ranges[0], np.float32([1.25, 1.18, 1.13, np.nan, 1.19]))
    assert np.isinf(recording.lidar.ranges[1:, 3]).all()
    np.testing.assert_allclose(recording.lidar.angles, np.radians([-60, -30, 0, 30, 60]))
    np.testing.assert_allclose(recording.encoders.stamps, [1.0, 1.05, 1.1, 1.15, 1.2])
    np.testing.assert_array_equal(recording.encoders.counts[:2], [[0, 0, 0, 0], [69, 70, 69, 70]])
    assert recording.platform.lidar.x == 0.1
    assert recording.warnings == ()


def test_what_a_cell_means(tmp_path: Path) -> None:
    path = write(tmp_path)
    np.testing.assert_array_equal(
        lidar_of(path).ranges, np.float32([[1, 2, 3], [1.5, np.nan, np.inf], [np.nan, np.nan, np.inf]])
    )
    assert counted(open_recording(path).warnings) == [("invalid-ranges", 1)]
    assert format_of(path).name.startswith("CSV log")


@pytest.mark.parametrize(("unit", "metres"), [("m", 1), ("cm", 0.01), ("mm", 0.001), ("in", 0.0254)])
@pytest.mark.parametrize(("clock", "seconds"), [("s", 1), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)])
def test_units(tmp_path: Path, unit: str, metres: float, clock: str, seconds: float) -> None:
    lidar = lidar_of(write(tmp_path, f'{LIDAR}range_unit = "{unit}"\nstamp_unit = "{clock}"\n'))
    np.testing.assert_allclose(lidar.ranges[0], np.array([1, 2, 3]) * metres, rtol=1e-6)
    np.testing.assert_allclose(lidar.stamps, np.array([0, 0.5, 1]) * seconds)


@pytest.mark.parametrize("mark", [",", ";", "|", "\t", " "])
@pytest.mark.parametrize("header", [True, False])
def test_delimiters_and_headers(tmp_path: Path, mark: str, header: bool) -> None:
    text = "# made by hand\n\n" + SCANS.replace("1.5,,inf", "1.5,0,inf").replace(",", mark).replace("\n", "\r\n")
    columns = "" if header else 'header = false\nstamp = 1\nranges = "2..4"\n'
    description = LIDAR if header else LIDAR.replace('stamp = "t"\nranges = "r0..r2"\n', "")
    scans = text if header else "\n".join(text.splitlines()[3:])
    path = write(tmp_path, f"{description}{columns}delimiter = {mark!r}\n".replace("'", '"'), scans=scans)
    np.testing.assert_array_equal(lidar_of(path).ranges[0], np.float32([1, 2, 3]))
    assert len(lidar_of(path)) == 3


def test_quotes_a_byte_order_mark_and_gzip(tmp_path: Path) -> None:
    path = write(tmp_path, LIDAR.replace("scans.csv", "scans.csv.gz"))
    quoted = "\n".join(",".join(f'"{cell}"' for cell in line.split(",")) for line in SCANS.splitlines())
    (tmp_path / "scans.csv.gz").write_bytes(gzip.compress(b"\xef\xbb\xbf" + quoted.encode()))
    assert len(lidar_of(path)) == 3


def test_odometry_poses_in_a_file_of_their_own_and_with_the_scans(tmp_path: Path) -> None:
    description = f"""{LIDAR}odometry = ["x", "y", 7]
length_unit = "cm"
angle_unit = "deg"
[odometry]
file = "odometry.csv"
stamp = "t"
x = "x"
y = "y"
theta = "a"
length_unit = "mm"
"""
    path = write(tmp_path, description, scans="t,r0,r1,r2,x,y,a\n3,1,1,1,100,200,90\n", odometry="t,x,y,a\n1,5,6,7\n")
    recording = open_recording(path)
    np.testing.assert_allclose(recording.lidar.odometry, [[1, 2, np.pi / 2]])
    np.testing.assert_allclose(recording.odometry.poses, [[0.005, 0.006, 7]])


ENCODERS = '[encoders]\nfile = "scans.csv"\nstamp = "t"\n'


def test_ticks_of_two_and_of_four_wheels(tmp_path: Path) -> None:
    ticks = "t,a,b,c,d\n0,5,6,7,8\n1,6,8,10,12\n"
    two = open_recording(write(tmp_path, f'{ENCODERS}left = "a"\nright = "b"\n', scans=ticks)).encoders
    four = "".join(f'{wheel} = "{name}"\n' for wheel, name in zip(WHEELS, "abcd", strict=True))
    running = open_recording(write(tmp_path, ENCODERS + four, scans=ticks)).encoders
    changes = open_recording(write(tmp_path, f"{ENCODERS}{four}running = false\n", scans=ticks)).encoders
    np.testing.assert_array_equal(two.counts, [[0, 0, 0, 0], [2, 1, 2, 1]])
    np.testing.assert_array_equal(running.counts, [[0, 0, 0, 0], [1, 2, 3, 4]])
    np.testing.assert_array_equal(changes.counts, [[5, 6, 7, 8], [6, 8, 10, 12]])


@pytest.mark.parametrize("given", [True, False])
def test_ticks_of_the_other_kind_are_refused(given: bool, tmp_path: Path) -> None:
    """Of wheels at 0.4 m/s, twenty times a second: totals are the sum of what they turn by."""
    ticks = np.clip(40 + np.random.default_rng(0).integers(-3, 4, 600), 0, None)
    ticks[:20] = ticks[-20:] = 0
    wheels = "[platform.wheels]\nmetres_per_count = 0.0005\ndiameter = 0.1\nwheel_base = 0\ntrack = 0.3\n"
    description = f'{ENCODERS}left = "a"\nright = "a"\n%s\n{wheels}effective_track = 0.3\n'

    def counts(values: np.ndarray, *, running: bool) -> np.ndarray:
        lines = "\n".join(f"{k / 20},{value}" for k, value in enumerate(values.tolist()))
        path = write(tmp_path, description % f"running = {str(running).lower()}", scans=f"t,a\n{lines}\n")
        return open_recording(path).encoders.counts[1:, 0]

    right, wrong = (np.cumsum(ticks), ticks) if given else (ticks, np.cumsum(ticks))
    np.testing.assert_array_equal(counts(right, running=given), ticks[1:])
    with refusal(ConfigError, field="encoders.running"):
        counts(wrong, running=given)


@pytest.mark.parametrize(("bits", "least"), [(16, -(2**15)), (16, 0), (32, -(2**31))])
def test_a_counter_that_is_full_begins_again(tmp_path: Path, bits: int, least: int) -> None:
    ticks = np.random.default_rng(0).integers(500, 900, 60)
    values = np.mod(np.cumsum(ticks) - 20_000, 2**bits) + least
    lines = "\n".join(f"{k / 20},{value}" for k, value in enumerate(values.tolist()))
    wheels = "metres_per_count = 0.00002\ndiameter = 0.1\nwheel_base = 0\ntrack = 0.3\neffective_track = 0.3\n"
    description = f'{ENCODERS}left = "a"\nright = "a"\n[platform.wheels]\n{wheels}'
    recording = open_recording(write(tmp_path, description, scans=f"t,a\n{lines}\n"))
    np.testing.assert_array_equal(recording.encoders.counts[1:, 0], ticks[1:])
    assert [issue.code for issue in recording.warnings] == ["counters-wrap"]


WHEELS = ("front_right", "front_left", "rear_right", "rear_left")


def test_inertial_readings(tmp_path: Path) -> None:
    imu = '[imu]\nfile = "scans.csv"\nstamp = "t"\nyaw_rate = "r0"\n'
    bare = open_recording(write(tmp_path, imu, scans="t,r0,r1,r2\n0,90,9.80665,0\n")).imu
    np.testing.assert_array_equal(bare.angular_velocity, [[0, 0, 90]])
    np.testing.assert_array_equal(bare.linear_acceleration_g, [[0, 0, 1]])
    more = 'rate_unit = "deg/s"\npitch_rate = "r2"\nacceleration = ["r1", "r2", "r1"]\nacceleration_unit = "m/s^2"\n'
    full = open_recording(write(tmp_path, imu + more, scans="t,r0,r1,r2\n0,90,9.80665,0\n")).imu
    np.testing.assert_allclose(full.angular_velocity, [[0, 0, np.pi / 2]])
    np.testing.assert_allclose(full.linear_acceleration_g, [[1, 0, 1]])


def test_the_robot_lies_beside_the_log_within_it_or_is_the_callers(tmp_path: Path) -> None:
    (tmp_path / "robot.toml").write_text('name = "beside"\n[lidar]\nx = 0.3\nangle_min = -2.0\nrange_max = 2.5\n')
    bare = "\n".join(line for line in LIDAR.splitlines() if not line.startswith(("angle_min", "range_max")))
    beside = open_recording(write(tmp_path, f'platform = "robot.toml"\n{bare}'))
    assert (beside.platform.name, beside.platform.lidar.x) == ("beside", 0.3)
    assert (beside.lidar.angle_min, beside.lidar.range_max) == (-2.0, 2.5)
    within = read_csv_log(write(tmp_path, f'{LIDAR}[platform]\nbase = "ucsd"\n'), platform=tmp_path / "robot.toml")
    assert within.platform.wheels == UCSD.wheels
    assert within.platform.lidar.x == 0.3


REFUSED = [
    (LIDAR + "range_mx = 1\n", "lidar.range_mx"),
    (LIDAR.replace('stamp = "t"', ""), "lidar.stamp"),
    (LIDAR + 'range_unit = "ft"\n', "lidar.range_unit"),
    (LIDAR.replace('"t"', "0"), "lidar.stamp"),
    (LIDAR.replace('"t"', '"time"'), "lidar.stamp"),
    (LIDAR.replace('"t"', "9"), "lidar.stamp"),
    (LIDAR.replace("r0..r2", "r0"), "lidar.ranges"),
    (LIDAR.replace("r0..r2", "r2..r0"), "lidar.ranges"),
    (LIDAR.replace("r0..r2", "r0..r9"), "lidar.ranges"),
    (LIDAR.replace("r0..r2", "t..r2"), "lidar.ranges"),
    (LIDAR + "header = false\n", "lidar.stamp"),
    (LIDAR.replace("angle_increment = 0.5", ""), "lidar.angle_increment"),
    (LIDAR.replace("angle_increment = 0.5", "angle_increment = 0.0"), "lidar.angle_increment"),
    (LIDAR.replace("angle_min = -1.0", "angle_min = -90"), "lidar.angle_min"),
    (LIDAR + "range_min = 11.0\n", "lidar.range_min"),
    (LIDAR.replace("scans.csv", "../x.csv"), "lidar.file"),
    (LIDAR.replace("scans.csv", "link.csv"), "lidar.file"),
    (LIDAR.replace("scans.csv", "nothing.csv"), "lidar.file"),
    ('platform = "nothing.toml"\n' + LIDAR, "platform"),
    (LIDAR.replace("scans.csv", "a\\u0000b"), "lidar.file"),
    ('platform = "/etc/x.toml"\n' + LIDAR, "platform"),
    ("platform = 3\n" + LIDAR, "platform"),
    (LIDAR + "[platform]\nwheel = 1\n", "platform.wheel"),
    (LIDAR + "[platform.lidar]\nx = 100\n", "platform.lidar.x"),
    (ENCODERS + "".join(f'{wheel} = "r0"\n' for wheel in WHEELS[:3]), "encoders"),
    (ENCODERS + 'left = "r0"\nright = "wheel"\n', "encoders.right"),
]


@pytest.mark.parametrize(("description", "field"), REFUSED)
def test_a_description_that_is_wrong_is_refused_in_one_line(tmp_path: Path, description: str, field: str) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "link.csv").symlink_to(tmp_path / "secret.csv")
    path = write(tmp_path / "logs", description, scans="t,r0,r1,r2,u,u\n0,1.0,2.0,3.0,0,0\n")
    with refusal(ConfigError, file=path, field=field) as caught:
        open_recording(path)
    assert "pattern" not in caught.value.problem


def test_a_description_without_a_stream_is_none(tmp_path: Path) -> None:
    path = write(tmp_path, 'name = "x"\n')
    assert not is_csv_log(path)
    with pytest.raises(ConfigError, match=r"no stream, expected a table \[lidar\], \[odometry\]"):
        read_csv_log(path)


@pytest.mark.parametrize("line", ["2,1,1", "2,1,x,1", ",1,1,1", "nan,1,1,1", "2,1,1,1,5", "2,1,1,1,5,"])
def test_a_broken_line_is_dropped_counted_and_named(tmp_path: Path, line: str) -> None:
    path = write(tmp_path, scans=f"{SCANS.replace('nan', '7')}{line}\n2,4,5,6\n")
    np.testing.assert_array_equal(lidar_of(path).ranges[3], np.float32([4, 5, 6]))
    (message,) = messages(open_recording(path).warnings)
    assert message.startswith("scans.csv: 1 broken line dropped, the first is line 5: ")
    with pytest.raises(InputError, match=r"scans\.csv:2: "):
        open_recording(write(tmp_path, scans=f"t,r0,r1,r2\n{line}\n"))


@pytest.mark.parametrize("scans", ["# nothing\n", "t,r0,r1,r2\n", "t,r0,r1,r2\n1e300,1,1,1\n"])
def test_files_without_readings_are_refused(tmp_path: Path, scans: str) -> None:
    path = write(tmp_path, LIDAR.replace('stamp = "t"', "stamp = 1"), scans=scans)
    with pytest.raises(InputError, match=r"scans\.csv: .*expected"):
        open_recording(path)


@pytest.mark.parametrize("ticks", ["1.5", "1e17"])
def test_ticks_are_whole(tmp_path: Path, ticks: str) -> None:
    path = write(tmp_path, f'{ENCODERS}left = "r0"\nright = "r1"\n', scans=f"t,r0,r1\n0,{ticks},1\n")
    with pytest.raises(InputError, match=r"scans\.csv: encoders: "):
        open_recording(path)


@pytest.mark.parametrize("text", ["[lidar]\nx = 1\n", "FLASER 3\n", "a = ", "[lidar]\nfile\n", "lidar = 3\n", "\0"])
def test_other_files_are_not_taken_for_it(tmp_path: Path, text: str) -> None:
    assert not is_csv_log(write(tmp_path, text).rename(tmp_path / "log.txt"))


STAMPS = st.integers(1, 12).flatmap(
    lambda n: arrays(np.float64, n, elements=st.floats(0, 1e4, allow_subnormal=False)).map(
        lambda steps: np.sort(1.7e9 + steps)
    )
)
FLOATS = st.floats(-1e6, 1e6, allow_subnormal=False)  # which a process loses once Taichi runs in it


@settings(max_examples=25)
@given(stamps=STAMPS, data=st.data())
def test_what_is_written_reads_back_bit_for_bit(
    tmp_path_factory: pytest.TempPathFactory, stamps: np.ndarray, data: st.DataObject
) -> None:
    n = len(stamps)
    ranges = st.floats(np.float32(0.125), np.float32(29.75), width=32) | st.sampled_from([np.nan, np.inf])
    recording = Recording(
        name="drawn",
        platform=UCSD,
        lidar=LidarStream(
            stamps,
            data.draw(arrays(np.float32, (n, 5), elements=ranges)),
            -1.1,
            0.3,
            0.1,
            30.0,
            UCSD.lidar.time_increment,
            data.draw(st.none() | arrays(np.float64, (n, 3), elements=FLOATS)),
        ),
        encoders=EncoderStream(stamps, data.draw(arrays(np.int64, (n, 4), elements=st.integers(-400, 400)))),
        odometry=OdometryStream(stamps, data.draw(arrays(np.float64, (n, 3), elements=FLOATS))),
        imu=ImuStream(
            stamps,
            data.draw(arrays(np.float64, (n, 3), elements=st.floats(-100, 100, allow_subnormal=False))),
            data.draw(arrays(np.float64, (n, 3), elements=FLOATS)),
        ),
    )
    path = tmp_path_factory.mktemp("csv") / "x.toml"
    assert write_csv(path, recording) == ()
    back = open_recording(path)
    assert (back.name, back.platform) == ("drawn", UCSD)
    assert_held("csv", recording, back)
    assert back.warnings == ()


def test_nothing_and_other_names_are_not_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no stream with readings"):
        write_csv(tmp_path / "x.toml", Recording("x", UCSD))
    with pytest.raises(OutputError, match=r"x\.csv: expected a name that ends in \.toml"):
        write_csv(tmp_path / "x.csv", Recording("x", UCSD))
