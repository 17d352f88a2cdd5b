"""The UCSD layout: ``Encoders20.npz``, ``Hokuyo20.npz``, ``Imu20.npz``, ``Kinect20.npz`` in one folder.

Any of them may be missing. Arrays, units, bounds and the names of images: ``docs/reference/formats.md``.
"""

import re
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from moteslam.errors import ConfigError, InputError
from moteslam.files import make_folder, read_arrays, write_atomically
from moteslam.robot.formats import Format, Robot
from moteslam.robot.formats.streams import Fan, Sensors, sort_by_stamp
from moteslam.robot.formats.written import SCAN_POSES, coded_ranges, not_written
from moteslam.robot.platforms import UCSD, GivenRobot, write_platform
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, Recording, RgbdStream
from moteslam.robot.values import Issue, counted, expect_type

_FILE = re.compile(r"(?:Encoders|Hokuyo|Imu|Kinect)([\w-]+)\.npz", re.ASCII)

SCALARS = ("angle_min", "angle_max", "angle_increment", "range_min", "range_max")  # Of a lidar's file
MAX_COUNT = 2**31  # Counts of one reading stay below it
SAME_ANGLE = 0.01  # Angles of beams that differ by less [rad] are those of one lidar
ONLY = "1"  # The sequence of a folder that is written for one recording
RGB, DISPARITY = "RGB", "Disparity"  # The two kinds of images, as the folders name them
NO_ECHO = 0.001  # Written for an invalid reading [m], as the UTM-30LX does


def ucsd_sequences(folder: Path) -> tuple[str, ...]:
    """The sequences that a folder holds, numbers first and in order; empty for any other folder."""
    try:
        names = {match[1] for path in folder.iterdir() if (match := _FILE.fullmatch(path.name))}
    except OSError:
        return ()
    return tuple(sorted(names, key=lambda name: (not name.isdigit(), int(name) if name.isdigit() else 0, name)))


def read_ucsd(folder: str | PathLike[str], sequence: str | int | None = None, platform: Robot = None) -> Recording:
    """Read one sequence of a folder in the UCSD layout, which may be left out where there is only one.

    A ``platform.toml`` that is given lies, key by key, over the folder's own; or over the UCSD robot.
    """
    folder = Path(folder)
    known = ucsd_sequences(folder)
    if not known:
        raise InputError("holds no Encoders*.npz, Hokuyo*.npz, Imu*.npz or Kinect*.npz", file=folder)
    number = known[0] if sequence is None and len(known) == 1 else str(sequence)
    if number not in known:
        found = "several sequences" if sequence is None else f"no sequence {sequence}"
        raise InputError(f"{found}, expected one of {', '.join(known)}", file=folder, field="sequence")
    beside = folder / "platform.toml"
    own, given = GivenRobot.read(beside if beside.exists() else None), GivenRobot.read(platform)
    robot = given.over(own.over(UCSD, assumed=True), assumed=own.is_nothing)
    issues: list[Issue] = []
    if (last := given if own.is_nothing else own).leaves_out:
        text = f"{last.file}: what it leaves out of wheels and lidar is the UCSD robot's"
        issues.append(Issue("assumed-robot", text))
    sensors = Sensors(robot, given.lidar_figures, issues)
    files = {name: folder / f"{kind}{number}.npz" for name, (kind, _) in STREAMS.items()}
    streams: Any = {name: STREAMS[name][1](file, sensors) for name, file in files.items() if file.exists()}
    lidar, its = streams.get("lidar"), UCSD.lidar.scan
    angles = its.angle_min + its.angle_increment * np.arange(its.beams)
    is_its = lidar is None or (lidar.angles.shape == angles.shape and np.abs(lidar.angles - angles).max() < SAME_ANGLE)
    if own.is_nothing and given.is_nothing and not is_its:
        text = f"{folder}: no platform.toml, a lidar that is not the UCSD robot's; wheels and mount are assumed its"
        issues.append(Issue("assumed-robot", text))
    return Recording(folder.resolve().name + f"-{number}" * (len(known) > 1), robot, warnings=tuple(issues), **streams)


def _lidar(path: Path, sensors: Sensors) -> LidarStream:
    arrays = read_arrays(path, {**dict.fromkeys(SCALARS, ()), "time_stamps": ("n",), "ranges": ("beams", "n")})
    figures = {name: float(arrays[name].item()) for name in SCALARS}
    angle_min, angle_max, increment, range_min, range_max = figures.values()
    for name, is_wrong, expected in (
        *((name, not np.isfinite(value), "a finite number") for name, value in figures.items()),
        ("angle_increment", increment == 0, "an angle between beams [rad]"),
        ("range_min", range_min < 0, "0 m or more"),
        ("range_max", range_max <= range_min, f"more than range_min, {range_min} m"),
    ):
        if is_wrong:
            raise InputError(f"{figures[name]:g}, expected {expected}", file=path, field=name)
    beams = len(arrays["ranges"])
    last = angle_min + (beams - 1) * increment
    if abs(last - angle_max) > abs(increment):
        text = f"{path.name}: angle_max: {angle_max:.4f} rad, but {beams} beams end at {last:.4f}; the beams are used"
        sensors.issues.append(Issue("angle-max", text))
    with np.errstate(over="ignore"):  # beyond float32 is infinite: no return
        ranges = np.ascontiguousarray(arrays["ranges"].T, np.float32)
    return sensors.lidar(path, "ranges", arrays["time_stamps"], ranges, Fan(angle_min, increment, range_min, range_max))


def _encoders(path: Path, sensors: Sensors) -> EncoderStream:
    arrays = read_arrays(path, {"time_stamps": ("n",), "counts": (4, "n")})
    counts, stamps = arrays["counts"], arrays["time_stamps"]
    if not (np.abs(counts.astype(np.float64)) < MAX_COUNT).all() or (counts != np.round(counts)).any():
        problem = "beyond 2^31 or not whole numbers, expected encoder counts since the last reading"
        raise InputError(problem, file=path, field="counts")
    return sensors.encoders(path, ("time_stamps", "counts"), stamps, counts.T)


def _imu(path: Path, sensors: Sensors) -> ImuStream:
    names = ("angular_velocity", "linear_acceleration")
    arrays = read_arrays(path, {"time_stamps": ("n",), **dict.fromkeys(names, (3, "n"))})
    for name in names:
        if not np.isfinite(arrays[name]).all():
            raise InputError("NaN or infinite values, expected finite readings", file=path, field=name)
    angular, linear = (arrays[name].T for name in names)
    return sensors.imu(path, ("time_stamps", "angular_velocity"), arrays["time_stamps"], angular, linear)


def _rgbd(path: Path, sensors: Sensors) -> RgbdStream:
    number, issues = path.stem.removeprefix("Kinect"), sensors.issues
    arrays = read_arrays(path, {"disparity_time_stamps": ("d",), "rgb_time_stamps": ("c",)})
    streams = []
    for field, kind in (("rgb_time_stamps", RGB), ("disparity_time_stamps", DISPARITY)):
        images = _images(path.parent, kind, number, len(arrays[field]), issues)
        stamps, order = sort_by_stamp(path, field, arrays[field], issues)
        streams.append((stamps, tuple(images[i] for i in order) if images else ()))
    (rgb, rgb_files), (disparity, disparity_files) = streams
    return RgbdStream(rgb, disparity, rgb_files, disparity_files)


STREAMS: dict[str, tuple[str, Callable[[Path, Sensors], Any]]] = {
    **{"lidar": ("Hokuyo", _lidar), "encoders": ("Encoders", _encoders), "imu": ("Imu", _imu)},
    "rgbd": ("Kinect", _rgbd),
}
"""What their files begin with, and what reads them."""


def image_path(folder: Path, kind: str, sequence: str, index: int) -> Path:
    """Where an image of a kind lies, by its index from 0."""
    return folder / "dataRGBD" / f"{kind}{sequence}" / f"{kind.lower()}{sequence.lower()}_{index + 1}.png"


def _images(folder: Path, kind: str, sequence: str, count: int, issues: list[Issue]) -> tuple[Path | None, ...]:
    """The image of each of ``count`` stamps, None where it is missing; empty where there are none at all."""
    place = image_path(folder, kind, sequence, 0).parent
    if not place.parent.is_dir():
        return ()  # no fault: they are a download of their own
    pattern = re.compile(rf"{re.escape(place.name.lower())}_(\d{{1,9}})\.png")
    try:
        names = sorted(path.name for path in place.iterdir()) if place.is_dir() else []
    except OSError as error:
        raise InputError(f"{error.strerror}, expected a folder of images", file=place) from error
    found = {int(match[1]): place / name for name in names if (match := pattern.fullmatch(name))}
    files = tuple(found.get(index) for index in range(1, count + 1))
    if missing := files.count(None):
        first = image_path(folder, kind, sequence, files.index(None)).name
        text = f"{place.name}: {missing} of {counted(count, 'image')} missing, the first {first}"
        issues.append(Issue("images-missing", text, missing))
    if beyond := len(found.keys() - range(1, count + 1)):
        text = f"{place.name}: {counted(beyond, 'image')} beyond the {counted(count, 'stamp')} left out"
        issues.append(Issue("images-beyond-stamps", text, beyond))
    return files if missing < count else ()


def write_ucsd(folder: str | PathLike[str], recording: Recording, *, sequence: str | int) -> None:
    """Write the streams of a recording in the UCSD layout, and its platform as ``platform.toml``.

    No return is written as ``range_max + 1`` and an invalid range as 0.001 m (as NaN where that is not
    below ``range_min``), so that ``read_ucsd`` gives the same back, bit for bit. Streams without readings, odometry
    poses and images are left out. The folder exists; ``sequence`` is the number (or word) in the file names.
    """
    expect_type(recording, Recording, "recording", "open_recording(path) reads one")
    folder, number = Path(folder), str(sequence)
    if not _FILE.fullmatch(f"Imu{number}.npz"):
        raise ConfigError(f"{number!r}, expected letters, digits, - and _", field="sequence")
    write_platform(folder / "platform.toml", recording.platform)

    def write(name: str, **arrays: Any) -> None:
        write_atomically(folder / f"{name}{number}.npz", lambda file: np.savez(file, **arrays))

    if (lidar := recording.lidar) is not None and len(lidar):
        far, invalid = lidar.range_max, NO_ECHO if lidar.range_min > NO_ECHO else np.nan
        coded = coded_ranges(lidar, recording.platform, no_return=far + 1, invalid=invalid)
        limits = (lidar.angle_min, lidar.angles[-1], lidar.angle_increment, lidar.range_min, far)
        figures = dict(zip(SCALARS, map(np.float64, limits), strict=True))
        write("Hokuyo", **figures, ranges=coded.T, time_stamps=lidar.stamps)
    if (encoders := recording.encoders) is not None and len(encoders):
        counts, narrow = encoders.counts, encoders.counts.astype(np.int16)  # as the recordings have them
        if np.abs(counts.astype(np.float64)).max() >= MAX_COUNT:
            raise InputError("beyond 2^31, expected counts since the last reading", field="counts")
        written = narrow if (narrow == counts).all() else counts.astype(np.int32)  # sums over a long way
        write("Encoders", counts=written.T, time_stamps=encoders.stamps)
    if (imu := recording.imu) is not None and len(imu):
        rates, along = imu.angular_velocity.T, imu.linear_acceleration_g.T
        write("Imu", angular_velocity=rates, linear_acceleration=along, time_stamps=imu.stamps)
    if (rgbd := recording.rgbd) is not None and len(rgbd.rgb_stamps) and len(rgbd.disparity_stamps):
        write("Kinect", disparity_time_stamps=rgbd.disparity_stamps, rgb_time_stamps=rgbd.rgb_stamps)


def _write_only(folder: Path, recording: Recording) -> tuple[Issue, ...]:
    make_folder(folder)
    write_ucsd(folder, recording, sequence=ONLY)
    rgbd = recording.rgbd
    has_images = rgbd is not None and (rgbd.rgb_files or rgbd.disparity_files or rgbd.images is not None)
    issues = not_written(recording, "a UCSD folder", "odometry", SCAN_POSES)
    return issues + (not_written(recording, "its file of stamps", "rgbd") if has_images else ())


FORMAT = Format(
    "UCSD folder (Encoders*.npz, Hokuyo*.npz, Imu*.npz, Kinect*.npz)",
    is_folder=True,
    recognise=lambda path: bool(ucsd_sequences(path)),
    read=read_ucsd,
    write=_write_only,
)
