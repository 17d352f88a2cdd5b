"""All that reads files from elsewhere, each with a file that it can read."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from moteslam.robot.platforms import UCSD
from moteslam.robot.raster import Raster
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, OdometryStream, Recording
from moteslam.robot.trajectory import Trajectory


@dataclass(frozen=True)
class Reader:
    """A reader and what it reads.

    Attributes:
        name: of the format.
        files: by their paths within a folder.
        main: the path to read, ``.`` for the folder itself.
        read: reads a path, and looks at all that is in it.
    """

    name: str
    files: dict[str, bytes]
    main: str
    read: Callable[[Path], Any]

    @contextmanager
    def written(self, folder: Path, changed: dict[str, bytes]) -> Iterator[Path]:
        """The files in a folder while the block runs, some of them changed; the path to read."""
        files = {**self.files, **changed}
        for name, content in files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
        try:
            yield folder / self.main
        finally:
            for name in files:
                (folder / name).unlink(missing_ok=True)


@cache
def readers() -> tuple[Reader, ...]:
    """One of each, in a fixed order."""
    return (*_recordings(), *_trajectories(), *_maps(), *_tables())


def recorded(scans: int = 12, beams: int = 19) -> Recording:
    """A short recording with every stream but a camera."""
    rng = np.random.default_rng(7)
    stamps = 1_300_000_000.0 + np.arange(scans) / 10
    ranges = rng.uniform(0.5, 9.0, (scans, beams)).astype(np.float32)
    ranges[rng.random(ranges.shape) < 0.1] = np.inf
    poses = np.column_stack((np.arange(scans) / 20, np.zeros(scans), np.arange(scans) / 100))
    return Recording(
        "short",
        UCSD,
        lidar=LidarStream(stamps, ranges, -1.5, 3.0 / (beams - 1), 0.1, 30.0, odometry=poses),
        encoders=EncoderStream(stamps, rng.integers(-5, 20, (scans, 4))),
        odometry=OdometryStream(stamps, poses),
        imu=ImuStream(stamps, rng.normal(0, 0.1, (scans, 3)), np.tile((0.0, 0.0, 1.0), (scans, 1))),
    )


def _contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def _recordings() -> Iterator[Reader]:
    """Every format of recordings that can be written."""
    from moteslam.robot.formats import FORMATS

    for name, known in FORMATS.items():
        if known.write is None:
            continue
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch) / "r"
            folder.mkdir()
            main = "." if known.is_folder else f"log{known.endings[0]}"
            known.write(folder / main, recorded())
            yield Reader(name, _contents(folder), main, _inspected)


def _inspected(path: Path) -> Any:
    from moteslam.robot.formats import open_recording
    from moteslam.robot.inspection import inspect_recording

    return inspect_recording(open_recording(path), deep=True)


def _trajectories() -> Iterator[Reader]:
    from moteslam.eval.evaluation import against_trajectory
    from moteslam.eval.metrics.relations import read_relations
    from moteslam.robot.trajectories import TRAJECTORY_FORMATS, read_trajectory
    from moteslam.robot.trajectories.rows import read_positions

    stamps = np.arange(9) / 2
    path = Trajectory(stamps, np.column_stack((stamps, np.sin(stamps), 0.1 * stamps)))
    for name, known in TRAJECTORY_FORMATS.items():
        with tempfile.TemporaryDirectory() as scratch:
            main = f"path{known.endings[0]}"
            known.write(Path(scratch) / main, path)
            yield Reader(name, _contents(Path(scratch)), main, read_trajectory)
    turns = np.column_stack((np.sin(stamps), np.zeros((9, 2)), np.cos(stamps)))
    rows = np.column_stack((stamps, stamps, np.sin(stamps), 0.1 * stamps, turns)).tolist()
    lines = "".join(f"{k},{','.join(map(repr, row))},0.5\n" for k, row in enumerate(rows))
    table = f"#num,t,x,y,z,qx,qy,qz,qw,cov_x\n{lines}".encode()
    yield Reader("csv table", {"t.csv": table}, "t.csv", lambda file: against_trajectory(read_trajectory(file), path))
    yield Reader(
        "bag topics", {"p.bag": _bag_of_poses()}, "p.bag",
        lambda file: [read_trajectory(f"{file}:{name}") for name in ("/pose", "tf:map:base")],
    )  # fmt: skip
    places = "".join(f"P {100 * k} {k} {2 * k}.5\n" for k in range(9))
    yield Reader("positions", {"p.txt": places.encode()}, "p.txt", read_positions)
    lines = "".join(f"{k}.5 {k + 1}.5 0.5 0.1 0 0 0 0.2\n" for k in range(8))
    yield Reader("relations", {"a.relations": lines.encode()}, "a.relations", read_relations)


def _bag_of_poses() -> bytes:
    """A bag of ROS 1 with poses and transforms."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    kinds = {
        name.rpartition("/")[2]: kind for name, kind in store.types.items() if name.startswith(("geo", "tf2", "bu"))
    }
    header = store.types["std_msgs/msg/Header"]
    with tempfile.TemporaryDirectory() as scratch:
        with Writer(Path(scratch) / "p.bag") as writer:
            topics = {"/pose": "geometry_msgs/msg/PoseStamped", "/tf": "tf2_msgs/msg/TFMessage"}
            known = {name: writer.add_connection(name, kind, typestore=store) for name, kind in topics.items()}
            for k in range(9):
                head, turn = header(k, kinds["Time"](k + 1, 0), "map"), kinds["Quaternion"](0.0, 0.0, 0.6, 0.8)
                pose = kinds["PoseStamped"](head, kinds["Pose"](kinds["Point"](0.1 * k, 0.0, 0.0), turn))
                moved = kinds["Transform"](kinds["Vector3"](0.1 * k, 0.0, 0.0), turn)
                tree = kinds["TFMessage"]([kinds["TransformStamped"](head, "base", moved)])
                for name, message in (("/pose", pose), ("/tf", tree)):
                    writer.write(known[name], k * 10**9, bytes(store.serialize_ros1(message, topics[name])))
        return (Path(scratch) / "p.bag").read_bytes()


def _maps() -> Iterator[Reader]:
    from moteslam.robot.formats.map_arrays import MapArrays, read_map_arrays, write_map_arrays
    from moteslam.robot.formats.map_server import read_map, write_map

    values = np.random.default_rng(3).integers(-1, 2, (11, 17)).astype(np.int8)
    with tempfile.TemporaryDirectory() as scratch:
        write_map(Path(scratch) / "map.pgm", Raster(values, 0.05, (1.0, -2.0, 0.3)))
        yield Reader("map_server", _contents(Path(scratch)), "map.yaml", read_map)
    arrays = {"log_odds": values.astype(np.float32)}
    odds = MapArrays(kind="log_odds", arrays=arrays, cell_size=0.05, origin=(1.0, -2.0, 0.3))
    with tempfile.TemporaryDirectory() as scratch:
        write_map_arrays(Path(scratch) / "map.npz", odds)
        yield Reader("map_arrays", _contents(Path(scratch)), "map.npz", read_map_arrays)


def _tables() -> Iterator[Reader]:
    """Scenarios, robots, configurations, specifications of sweeps, and loops."""
    from moteslam.eval.run_tables import LOOP_COLUMNS, VERDICTS, read_loops
    from moteslam.eval.sweep.plan import plan
    from moteslam.eval.sweep.spec import read_spec
    from moteslam.robot.platforms import load_platform
    from moteslam.sim.scenario import load_scenario
    from moteslam.slam.settings import load_preset, resolve_config

    def bundled(package: str, name: str) -> bytes:
        return resources.files(package).joinpath(name).read_bytes()

    scenario = bundled("moteslam.sim.scenarios", "people.toml")
    yield Reader("scenario", {"s.toml": scenario}, "s.toml", load_scenario)
    yield Reader("platform", {"p.toml": bundled("moteslam.robot.platforms", "ucsd.toml")}, "p.toml", load_platform)
    config = load_preset().to_toml().encode()
    yield Reader("configuration", {"c.toml": config}, "c.toml", lambda path: resolve_config("default", (), path))
    spec = bundled("moteslam.eval.sweep.specs", "people.toml")
    yield Reader("sweep", {"w.toml": spec}, "w.toml", lambda path: plan(read_spec(path), check=False))
    numbers = ",".join(["0.5"] * 15)
    loops = f"{','.join(LOOP_COLUMNS)}\n" + "".join(f"{k},{k + 40},{numbers},{VERDICTS[0]}\n" for k in range(6))
    yield Reader("loops", {"loops.csv": loops.encode()}, "loops.csv", read_loops)
