"""A small simulated recording, and a run over it."""

from pathlib import Path

import pytest
from matplotlib.figure import Figure

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


@pytest.fixture(scope="session")
def run(simulation, taichi):
    """SLAM over it, and the map at its stages."""
    from moteslam.eval.report.maps import keep_map
    from moteslam.slam.config import resolve_config
    from moteslam.slam.online import OnlineSlam

    session = OnlineSlam.over(simulation.recording, resolve_config(settings=["particles=10"]), seed=1)
    snapshots = []
    for update in session:
        keep_map(snapshots, session, update)
    return session.estimate(), snapshots


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures that were written."""
    figures: list[Figure] = []
    save = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda figure, *a, **k: (figures.append(figure), save(figure, *a, **k)))
    return figures
