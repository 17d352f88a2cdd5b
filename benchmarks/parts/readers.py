"""All that reads files from elsewhere, each with a file that it can read."""

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer

from moteslam.eval.metrics.relations import read_relations
from moteslam.eval.results import BUILDING as NAME
from moteslam.eval.results import read_building, write_building
from moteslam.eval.run_tables import LOOP_COLUMNS, VERDICTS, read_loops
from moteslam.eval.scores import against
from moteslam.eval.sweep.plan import plan
from moteslam.eval.sweep.spec import read_spec
from moteslam.robot.formats import FORMATS, open_recording
from moteslam.robot.formats.bags.write import Event, header, transform, turned, vector, write_events
from moteslam.robot.formats.map_server import read_map, write_map
from moteslam.robot.inspection import inspect_recording
from moteslam.robot.platforms import UCSD, load_platform
from moteslam.robot.raster import Raster, read_map_arrays, write_map_arrays
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, OdometryStream, Recording
from moteslam.robot.trajectories import WRITERS, read_trajectory
from moteslam.robot.trajectory import Trajectory
from moteslam.sim.scenario import load_scenario
from moteslam.slam.backend.building import Building, Session
from moteslam.slam.backend.graph.pose_graph import Edges, MeasuredChain
from moteslam.slam.config import load_preset, resolve_config


@dataclass(frozen=True)
class Reader:
    """A reader and what it reads."""

    name: str  # of the format
    files: dict[str, bytes]  # by their paths within a folder
    main: str  # the path to read, ``.`` for the folder itself
    read: Callable[[Path], Any]  # reads a path, and looks at all that is in it

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
    return (*_recordings(), *_trajectories(), *_maps(), *_tables(), *_sessions())


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


def _made(main: str, write: Callable[..., Any], *given: Any) -> dict[str, bytes]:
    """The files that a writer leaves in a folder, by their paths; ``main`` is what it is told to write."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "r"
        folder.mkdir()
        write(folder / main, *given)
        files = (path for path in sorted(folder.rglob("*")) if path.is_file())
        return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def _recordings() -> Iterator[Reader]:
    """Every format of recordings that can be written."""
    for name, known in FORMATS.items():
        if known.write is not None:
            main = "." if known.is_folder else f"log{known.endings[0]}"
            files = _made(main, known.write, recorded())
            yield Reader(name, files, main, lambda path: inspect_recording(open_recording(path), deep=True))


def _trajectories() -> Iterator[Reader]:
    stamps = np.arange(9) / 2
    path = Trajectory(stamps, np.column_stack((stamps, np.sin(stamps), 0.1 * stamps)))
    for name, (ending, write) in WRITERS.items():
        yield Reader(name, _made(f"path{ending}", write, path), f"path{ending}", read_trajectory)
    turns = np.column_stack((np.sin(stamps), np.zeros((9, 2)), np.cos(stamps)))
    rows = np.column_stack((stamps, stamps, np.sin(stamps), 0.1 * stamps, turns)).tolist()
    lines = "".join(f"{k},{','.join(map(repr, row))},0.5\n" for k, row in enumerate(rows))
    table = f"#num,t,x,y,z,qx,qy,qz,qw,cov_x\n{lines}".encode()
    yield Reader("csv table", {"t.csv": table}, "t.csv", lambda file: against(read_trajectory(file), path))
    yield Reader(
        "bag topics", _made("p.bag", _write_bag_of_poses), "p.bag",
        lambda file: [read_trajectory(f"{file}:{name}") for name in ("/pose", "tf:map:base")],
    )  # fmt: skip
    lines = "".join(f"{k}.5 {k + 1}.5 0.5 0.1 0 0 0 0.2\n" for k in range(8))
    yield Reader("relations", {"a.relations": lines.encode()}, "a.relations", read_relations)


def _write_bag_of_poses(path: Path) -> None:
    """A bag of ROS 1 with poses and transforms."""
    turn, events = turned(1.3), []
    for k in range(9):
        stamp, place = (k + 1) * 10**9, (0.1 * k, 0.0, 0.0)
        pose = {"header": header(stamp, "map"), "pose": {"position": vector(*place), "orientation": turn}}
        events.append(Event(stamp, "/pose", "geometry_msgs/PoseStamped", pose))
        tree = {"transforms": [transform(stamp, "map", "base", place, turn)]}
        events.append(Event(stamp, "/tf", "tf2_msgs/TFMessage", tree))
    with Writer(path) as writer:
        write_events(writer, iter(events), ros1=True)


def _maps() -> Iterator[Reader]:
    values = np.random.default_rng(3).integers(-1, 2, (11, 17)).astype(np.int8)
    files = _made("map.pgm", write_map, Raster(values, 0.05, (1.0, -2.0, 0.3)))
    yield Reader("map_server", files, "map.yaml", read_map)
    odds = {"log_odds": Raster(values.astype(np.float32), 0.05, (1.0, -2.0, 0.3))}
    yield Reader("map_arrays", _made("map.npz", write_map_arrays, odds), "map.npz", read_map_arrays)


def _tables() -> Iterator[Reader]:
    """Scenarios, robots, configurations, specifications of sweeps, and loops."""

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


def _sessions() -> Iterator[Reader]:
    """What a recording is bound to."""
    rng, stamps, nodes = np.random.default_rng(4), np.arange(9) / 2, np.arange(0, 9, 2)
    path = np.column_stack((stamps, np.sin(stamps), 0.1 * stamps))
    steps, spread = rng.normal(size=(4, 3)), np.repeat(np.eye(3)[None] * 0.01, 4, axis=0)
    chain = MeasuredChain(steps, spread, steps, spread, np.zeros(4, bool))
    points, counts = rng.normal(0, 5, (40, 2)).astype(np.float32), np.full(5, 8, np.int32)
    session = Session(stamps, path, nodes, chain, points, counts, np.zeros(2), np.ones(5, bool))
    loops = Edges(np.array([0]), np.array([4]), np.zeros((1, 3)), np.eye(3)[None], np.ones(1, bool))
    files = _made(NAME, write_building, Building((session,), loops))
    yield Reader("sessions", files, NAME, lambda file: read_building(file.parent).graph)
