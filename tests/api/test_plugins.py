"""Filters, back ends, formats and metrics from outside the package, by the recipe in CONTRIBUTING.md."""

import json
import os
import subprocess
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
import pytest
import yaml
from command_lines import program

from moteslam.errors import ConfigError
from moteslam.plugins import Plugins, PluginWarning
from moteslam.robot.trajectories.text import read_tum

TOYS = Path(__file__).parent / "plugins"
ENTRIES = """
[moteslam.filters]
toy = toy_filter:METHOD
[moteslam.backends]
toy = toy_backend:BACKEND
[moteslam.formats]
toy = toy_format:FORMAT
[moteslam.metrics]
end_error = toy_metric:METRIC
"""


def installed(folder: Path, entries: str, name: str = "toys") -> str:
    """What an installed package of these entry points leaves in a folder of the search path."""
    about = folder / f"{name}-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n", encoding="utf-8")
    (about / "entry_points.txt").write_text(entries, encoding="utf-8")
    return str(folder)


def moteslam(path: list[str], *arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    """The command line of a user who has installed the packages of these folders."""
    search = os.pathsep.join([*path, os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
    return program(*arguments, cwd=cwd, PYTHONPATH=search)


def plug_in_lines(said: str) -> list[str]:
    """Of what went to stderr the lines on plug-ins: the drive, which hardly turns, has a warning of its own."""
    return [line for line in said.splitlines() if "plug-in" in line]


@pytest.fixture(scope="module")
def toys(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """A package with one of each, installed."""
    return [installed(tmp_path_factory.mktemp("toys"), ENTRIES), str(TOYS)]


@pytest.mark.slow
def test_a_filter_and_a_metric_of_another_package(toys: list[str], simulated_folder: Path, tmp_path: Path):
    arguments = [
        "replay",
        simulated_folder,
        "--set",
        "method=toy",
        "--set",
        "scale=0.9",
        "--no-figures",
        "--out",
        "result",
    ]
    done = moteslam(toys, *arguments, cwd=tmp_path)
    assert (done.returncode, plug_in_lines(done.stderr)) == (0, [])
    assert 'method = "toy"\n' in (tmp_path / "result/config.toml").read_text(encoding="utf-8")
    scores = json.loads((tmp_path / "result/metrics.json").read_text(encoding="utf-8"))["metrics"]
    assert 0.2 < scores["final.end_error"]["value"] < 0.4  # a tenth of three metres
    assert scores["dead_reckoning.end_error"]["value"] < 0.1
    again = ["replay", simulated_folder, "--config", "result/config.toml", "--no-figures", "--out", "again"]
    assert moteslam(toys, *again, cwd=tmp_path).returncode == 0
    for name in ("trajectory.tum", "map.pgm"):
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / "result" / name).read_bytes()


@pytest.mark.slow
def test_a_back_end_of_another_package_moves_path_map_and_filter(
    toys: list[str], simulated_folder: Path, tmp_path: Path
):
    arguments = ["replay", simulated_folder, "--set", "particles=8", "--no-figures"]
    assert moteslam(toys, *arguments, "--out", "alone", cwd=tmp_path).returncode == 0
    done = moteslam(toys, *arguments, "--set", "backend.method=toy", "--out", "moved", cwd=tmp_path)
    assert (done.returncode, plug_in_lines(done.stderr)) == (0, [])
    alone, moved = (read_tum(tmp_path / name / "trajectory_final.tum") for name in ("alone", "moved"))
    np.testing.assert_allclose(moved.poses[:, :2], alone.poses[:, :2] + (0.0, 2.0), atol=0.1)
    alone, moved = (read_tum(tmp_path / name / "trajectory.tum") for name in ("alone", "moved"))
    np.testing.assert_allclose(moved.poses[0], alone.poses[0])
    np.testing.assert_allclose(moved.poses[-1, :2], alone.poses[-1, :2] + (0.0, 1.0), atol=0.1)
    about = [yaml.safe_load((tmp_path / name / "map.yaml").read_text(encoding="utf-8")) for name in ("alone", "moved")]
    assert about[1]["origin"][1] - about[0]["origin"][1] == pytest.approx(2.0, abs=0.15)


def test_a_format_of_another_package(toys: list[str], tmp_path: Path):
    rows = "".join(f"{t},{','.join(['2.0'] * 9)}\n" for t in range(3))
    (tmp_path / "log.toy").write_text("# toy ranges\n" + rows, encoding="utf-8")
    done = moteslam(toys, "inspect", "log.toy", "--json", cwd=tmp_path)
    assert json.loads(done.stdout)["lidar"]["beams"] == 9
    (tmp_path / "log.toy").write_text("# toy ranges\n1,x\n", encoding="utf-8")
    done = moteslam(toys, "inspect", "log.toy", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("moteslam: log.toy: ")
    assert moteslam([], "inspect", "log.toy", cwd=tmp_path).stderr.startswith("moteslam: log.toy: not a recording")


@pytest.mark.slow
def test_one_that_fails_to_load_is_one_warning_and_an_error_where_it_is_asked_for(
    simulated_folder: Path, tmp_path: Path
):
    entries = "[moteslam.formats]\nbad = nowhere_at_all:FORMAT\n[moteslam.metrics]\nodd = os:sep\n"
    broken = [installed(tmp_path / "site", entries + "[moteslam.filters]\nbad = nowhere_at_all:METHOD\n")]
    assert moteslam(broken, "inspect", simulated_folder, cwd=tmp_path).stderr == ""  # known before it is asked
    (tmp_path / "log.txt").write_text("neither", encoding="utf-8")
    done = moteslam(broken, "inspect", "log.txt", cwd=tmp_path)
    assert done.returncode == 2
    warned, refused = done.stderr.splitlines()
    assert warned.startswith("moteslam: warning: plug-in 'bad' of package toys (moteslam.formats) is left out")
    assert refused.startswith("moteslam: log.txt: ")
    done = moteslam(
        broken, "replay", simulated_folder, "--out", "x", "--set", "particles=3", "--no-figures", cwd=tmp_path
    )
    assert done.returncode == 0
    (warned,) = plug_in_lines(done.stderr)
    assert "plug-in 'odd' of package toys (moteslam.metrics) is left out" in warned
    done = moteslam(broken, "replay", simulated_folder, "--out", "y", "--set", "method=bad", cwd=tmp_path)
    assert done.returncode == 2  # it was asked for
    assert done.stderr.startswith("moteslam: --set method: 'bad' of package toys cannot be loaded")


@pytest.mark.slow
def test_a_metric_that_fails_costs_a_warning_and_not_the_run(simulated_folder: Path, tmp_path: Path):
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "bad_metrics.py").write_text(
        "from moteslam.eval.metrics.registry import Metric\n"
        "def fails(track):\n    raise RuntimeError('boom')\n"
        "RAISES = Metric('m', 'Raises.', 'bad', fails)\n"
        "NO_RESULT = Metric('m', 'No number.', 'bad', lambda _: 'x')\n",
        encoding="utf-8",
    )
    entries = "[moteslam.metrics]\nraises = bad_metrics:RAISES\nempty = bad_metrics:NO_RESULT\n"
    path = [installed(tmp_path / "packages", entries, "bad"), str(tmp_path / "bad")]
    done = moteslam(
        path, "replay", simulated_folder, "--set", "particles=3", "--no-figures", "--out", "result", cwd=tmp_path
    )
    assert done.returncode == 0
    assert "'raises' of package bad (moteslam.metrics) is left out: RuntimeError: boom" in done.stderr
    assert "'empty' of package bad (moteslam.metrics) is left out: TypeError" in done.stderr
    written = json.loads((tmp_path / "result/metrics.json").read_text(encoding="utf-8"))["metrics"]
    assert written["final.raises"] == {"absent": "RuntimeError: boom"}
    assert written["final.empty"]["absent"].startswith("TypeError")
    assert written["final.ate"]["value"] < 0.1


def test_the_name_of_a_bundled_one_is_not_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(installed(tmp_path / "one", "[toy.group]\nmine = os:sep\nsame = os:linesep\n", "one"))
    monkeypatch.syspath_prepend(installed(tmp_path / "two", "[toy.group]\nsame = os:curdir\n", "two"))
    monkeypatch.setattr("moteslam.plugins._installed", entry_points)
    table: Plugins[str] = Plugins("toy.group", str, bundled={"mine": "os:pardir"})
    with pytest.warns(PluginWarning, match="taken") as caught:
        once, again = dict(table.items()), dict(table.items())
    assert once == again == {"mine": "..", "same": os.linesep}
    assert len(caught) == 2
    assert table["mine"] == ".."
    with pytest.raises(ConfigError, match="'other', expected one of mine, same"):
        table["other"]
