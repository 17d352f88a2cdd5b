"""The scripts of examples/ run, and each draws its picture; the notebook runs in a kernel of Jupyter."""

import ast
import json
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest

import moteslam

EXAMPLES = Path(__file__).parents[2] / "examples"
MOST = {  # what ``main`` returns, at least and at most
    "closed_loop": (20.0, 30.0),
    "online": (0.0, 0.05),
    "my_weight_update": (3.0, 20.0),
    "score_my_trajectory": (0.02, 0.2),
    "real_log": (10.0, 60.0),
    "paper_figures": (2.0, 40.0),
    "particles_film": (1.0, 50.0),
    "my_filter": (0.001, 0.1),
    "gym_env": (20.0, 60.0),
    "bad_maps": (-1, 2000),
    "which_lidar": (0.0, 0.1),
}
PICTURES = {"paper_figures": [f"paper_figures_{number}.png" for number in range(1, 9)]}
PICTURES["bad_maps"] = [f"bad_maps_{name}.png" for name in ("doubled", "bent", "ghosts", "lost", "clock", "mount")]
PICTURES["particles_film"] = ["particles_film.gif"]
OF_DEVICES = {"ros2_node": "rclpy", "serial_lidar": "serial"}  # and the package that they need


def test_every_script_is_run_here():
    assert {path.stem for path in EXAMPLES.glob("*.py")} == {*MOST, *OF_DEVICES}


@pytest.mark.slow
@pytest.mark.usefixtures("taichi")
@pytest.mark.parametrize("name", MOST)
def test_a_script_draws_its_picture(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The slowest ones with fewer particles or seeds."""
    import matplotlib

    matplotlib.use("agg")
    if name == "gym_env":
        pytest.importorskip("gymnasium")
    script = import_module(name)
    if name == "bad_maps":
        monkeypatch.setattr(script, "PAPER", moteslam.resolve_config("paper", ["particles=20"]))
    if name == "paper_figures":
        run = script.run
        monkeypatch.setattr(script, "run", lambda recording, *settings: run(recording, "particles=20", *settings))
    if name == "which_lidar":
        monkeypatch.setattr(script, "SEEDS", range(1))
    found = script.main(tmp_path / "new")
    for picture in PICTURES.get(name, [f"{name}.png"]):
        assert (tmp_path / "new" / picture).stat().st_size > 5000
    least, most = MOST[name]
    assert all(least < each < most for each in (found.values() if isinstance(found, dict) else [found]))


@pytest.mark.parametrize(
    ("given", "code", "words"),
    [
        ("--help", 0, "A log of a real robot (CARMEN, CSV, a bag) to a map and a path."),
        ("a.log", 2, "'a.log' is a file"),
        ("new nothing.log", 2, "nothing.log: No such file or directory, expected a recording"),
    ],
)
def test_a_script_has_help_and_says_what_does_not_fit(given: str, code: int, words: str, tmp_path: Path):
    (tmp_path / "a.log").touch()
    command = [sys.executable, str(EXAMPLES / "real_log.py"), *given.split()]
    found = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert found.returncode == code
    assert words in found.stdout + found.stderr
    assert found.stderr.count("\n") == (code != 0)


@pytest.mark.slow
@pytest.mark.usefixtures("taichi")
def test_the_environment_is_one_of_gymnasium():
    pytest.importorskip("gymnasium")
    from gymnasium.utils.env_checker import check_env

    check_env(import_module("gym_env").DriveToGoal(), skip_render_check=True)


def test_the_environment_ends_where_the_body_touches_a_wall():
    pytest.importorskip("gymnasium")
    env = import_module("gym_env").DriveToGoal()
    platform = env.scenario.platform
    for lateral, heading, touches in ((0.03, 0.0, False), (0.01, 0.0, True), (0.03, 0.5, True), (-0.1, 0.0, True)):
        y = platform.width / 2 + lateral  # the wall is nearer than half the diagonal
        world = SimpleNamespace(segments=np.array([[-3.0, y, 3.0, y], [5.0, -1.0, 5.0, 1.0]]))
        env.simulator = SimpleNamespace(world=world, pose=np.array((0.0, 0.0, heading)))
        assert env._touches() == touches, (lateral, heading)


def test_the_bytes_of_a_serial_lidar_are_ranges(monkeypatch: pytest.MonkeyPatch):
    turn = b"".join(
        bytes((0b111110 if degrees else 0b111101, (64 * degrees & 127) << 1 | 1, 64 * degrees >> 7, *metres))
        for degrees in range(360)
        for metres in [(4000 + 100 * degrees).to_bytes(2, "little")]
    )
    sent = b"\xa5\x5a\x05\0\0\x40\x81" + turn[:500] + turn + b"\0" + turn + turn[:5]

    class Device:
        def __init__(self, *_: object, **__: object) -> None:
            self.left = sent

        def __enter__(self) -> "Device":
            return self

        def __exit__(self, *_: object) -> None: ...

        def write(self, command: bytes) -> None:
            assert command == b"\xa5\x20"

        def read(self, count: int) -> bytes:
            taken, self.left = self.left[:count], self.left[count:]
            return taken

    monkeypatch.setitem(sys.modules, "serial", SimpleNamespace(Serial=Device))
    scans = import_module("serial_lidar").scans("port")
    found = [next(scans)[1] for _ in range(2)]
    monkeypatch.delitem(sys.modules, "serial_lidar")
    with pytest.raises(SystemExit, match="no reading"):
        next(scans)
    degrees = (180 - np.arange(360)) % 360  # clockwise from ahead, of beams counterclockwise from behind
    for ranges in found:
        np.testing.assert_allclose(ranges, 1 + degrees / 40, atol=1e-6)


@pytest.mark.usefixtures("taichi")
def test_the_node_takes_what_ros_sends_logs_the_rest_and_keeps_the_result(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    topics, said, nodes = {}, [], []

    class Node:
        def __init__(self, _name: str) -> None:
            nodes.append(self)
            self.create_subscription = lambda _type, topic, take, qos: topics.update({topic: (take, qos)})
            self.create_publisher = lambda _type, topic, qos: topics.update({topic: (None, qos)})
            self.create_timer = lambda *_: None
            self.get_clock, self.get_logger = MagicMock(), lambda: SimpleNamespace(warning=said.append)

    def spin(_node: Node) -> None:
        still = SimpleNamespace(position=SimpleNamespace(x=0.0, y=0.0), orientation=SimpleNamespace(z=0.0, w=1.0))
        limits = {"range_min": 0.1, "range_max": 3.5, "scan_time": 0.2, "time_increment": 0.0}
        for sec, beams in ((1, 0), (1, 360), (0, 360), (2, 360), (3, 364), (4, 350)):
            header = SimpleNamespace(stamp=SimpleNamespace(sec=sec, nanosec=0))
            step = 2 * np.pi / max(beams, 1)
            ranges = 2 + np.cos(step * np.arange(beams))
            angles = {"angle_min": 0.0, "angle_increment": step}
            topics["scan"][0](SimpleNamespace(header=header, ranges=ranges, **angles, **limits))
            topics["odom"][0](SimpleNamespace(header=header, pose=SimpleNamespace(pose=still)))
        raise KeyboardInterrupt

    qos = SimpleNamespace(QoSProfile=dict, DurabilityPolicy=MagicMock(), ReliabilityPolicy=MagicMock())
    for name in ("rclpy", "geometry_msgs.msg", "nav_msgs.msg", "sensor_msgs.msg", "tf2_ros", "rclpy.utilities"):
        monkeypatch.setitem(sys.modules, name, MagicMock(spin=spin))
    monkeypatch.setitem(sys.modules, "rclpy.node", SimpleNamespace(Node=Node))
    monkeypatch.setitem(sys.modules, "rclpy.qos", qos)
    monkeypatch.setitem(sys.modules, "rclpy.executors", SimpleNamespace(ExternalShutdownException=RuntimeError))
    import_module("ros2_node").main("turtlebot3", str(tmp_path / "result"))
    monkeypatch.delitem(sys.modules, "ros2_node")
    assert len(said) == 3, said  # no beams, and a scan and a pose of an earlier stamp
    assert topics["map"][1]["durability"] is qos.DurabilityPolicy.TRANSIENT_LOCAL
    assert all(topics[name][1]["reliability"] is qos.ReliabilityPolicy.BEST_EFFORT for name in ("scan", "odom"))
    assert len(moteslam.read_trajectory(tmp_path / "result/trajectory.tum")) == 4
    rows = nodes[0].slam._taken.beginning.recording("x").lidar.ranges
    assert np.abs(rows - (2 + np.cos(np.deg2rad(np.arange(360))))).max() < 0.02


@pytest.mark.slow
def test_the_notebook_of_the_course_runs(tmp_path: Path):
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    notebook = nbformat.read(EXAMPLES / "course.ipynb", as_version=4)
    assert not [cell for cell in notebook.cells if cell.get("outputs")]
    nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3").execute(cwd=str(tmp_path))
    shown = json.dumps([cell.get("outputs") for cell in notebook.cells])
    assert shown.count('"image/png"') == 6
    assert "trajectory_final: " in shown


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_the_public_names_that_a_script_uses_exist_and_it_is_short(path: Path):
    text = path.read_text(encoding="utf-8")
    named = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Attribute)]
    used = {node.attr for node in named if isinstance(node.value, ast.Name) and node.value.id == "moteslam"}
    assert used <= {name for names in moteslam.PUBLIC.values() for name in names}
    assert text.count("\n") <= 110
