"""What every test may use: the real recordings, a small simulated one, and Taichi set up once a process."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

ROOT = Path(__file__).parents[1]

os.environ.pop("COLUMNS", None)  # of a terminal, which a worker of pytest-xdist is told: tables would be as narrow

# a test asserts no time: a busy machine is no failure
settings.register_profile("moteslam", deadline=None, max_examples=40)
settings.load_profile("moteslam")


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The folder of real recordings: MOTESLAM_DATA, else ../shared/data; skips with a reason where absent."""
    folder = Path(os.environ.get("MOTESLAM_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no real recordings at {folder}: set MOTESLAM_DATA")
    return folder


@pytest.fixture(scope="session")
def taichi() -> None:
    """Taichi on the CPU as a user has it, on all processors; with MOTESLAM_TEST_DEBUG=1 with bounds checks.

    It may run already, started by what another fixture called: the settings are the same, in whatever order.
    """
    from moteslam.kernels import runtime

    runtime.init("cpu", debug=os.environ.get("MOTESLAM_TEST_DEBUG") == "1")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip the tests marked `gpu` where there is no GPU."""
    gpu = [item for item in items if "gpu" in item.keywords]
    if gpu and not Path("/dev/nvidia0").exists():
        for item in gpu:
            item.add_marker(pytest.mark.skip(reason="no NVIDIA GPU on this machine"))


@pytest.fixture
def signals_are_heard() -> Iterator[None]:
    """Where the tests themselves run under nohup or in the background, their children would ignore signals, rightly."""
    usual = {signal.SIGHUP: signal.SIG_DFL, signal.SIGINT: signal.default_int_handler}
    before = {number: signal.signal(number, handler) for number, handler in usual.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


ROOM = """
description = "one room with a box in it"
[route]
waypoints = [[0.0, 0.0], [3.0, 0.0], [3.0, 1.5]]
[[world.walls]]
points = [[-2.0, -2.0], [6.0, -2.0], [6.0, 4.0], [-2.0, 4.0]]
closed = true
[[world.walls]]
points = [[0.5, 2.0], [1.5, 2.0], [1.5, 3.0], [0.5, 3.0]]
closed = true
"""


@pytest.fixture(scope="session")
def scenario_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scenario of a few seconds: a drive round a corner in one room."""
    file = tmp_path_factory.mktemp("scenario") / "room.toml"
    file.write_text(ROOM)
    return file


@pytest.fixture(scope="session")
def simulation(scenario_file: Path):
    """That drive: the recording and its truth."""
    from moteslam.sim.scenario import load_scenario
    from moteslam.sim.simulate import simulate

    return simulate(load_scenario(scenario_file), 1)


@pytest.fixture(scope="session")
def simulated_folder(simulation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same on disk, in the UCSD layout."""
    from moteslam.sim.output import write_simulation

    folder = tmp_path_factory.mktemp("simulated")
    write_simulation(folder, simulation)
    return folder
