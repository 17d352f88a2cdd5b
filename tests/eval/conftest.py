"""A run over a small simulated recording, and the figures that are written."""

import pytest
from matplotlib.figure import Figure


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
