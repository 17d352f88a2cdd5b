"""The report's page: what is gathered, what a player is given, and that nothing of a name is taken for markup."""

import gzip
import hashlib
import json
import re
import shutil
from base64 import b64decode, b64encode
from pathlib import Path

import numpy as np
import pytest
from report_material import HOSTILE, sweep

from moteslam.errors import InputError
from moteslam.eval.cli import main
from moteslam.eval.page.document import data_block, gather, page
from moteslam.eval.page.player import CLOUDS, playable
from moteslam.eval.results import write_results
from moteslam.eval.run_tables import read_particles
from moteslam.eval.runs import compared
from moteslam.eval.sweep.plan import PlannedRun
from moteslam.eval.sweep.store import Row
from moteslam.robot.formats.map_server import write_picture
from moteslam.robot.raster import Raster
from moteslam.robot.se2 import transform_points
from moteslam.robot.trajectories.text import read_tum


@pytest.fixture(scope="session")
def result(run, simulation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report") / "result"
    write_results(folder, run[0], simulation.truth, figures=False)
    return folder


def decoded(deltas: list[int], unit: float = 1e-3) -> np.ndarray:
    return np.cumsum(deltas) * unit


def test_a_player_has_the_paths_of_the_folder(result: Path) -> None:
    found = playable(result)
    final = read_tum(result / "trajectory_final.tum")
    assert len(found["t"]) == len(final)
    np.testing.assert_allclose(decoded(found["t"]), final.stamps - final.stamps[0], atol=6e-4)
    for axis in (0, 1):
        np.testing.assert_allclose(decoded(found["final"][axis]), final.poses[:, axis], atol=6e-4)
    truth = np.stack([decoded(found["truth"][axis]) for axis in (0, 1)], axis=-1)
    assert np.abs(truth - final.poses[:, :2]).max() < 0.2  # the truth as the estimate has its frame
    assert [len(found[name][0]) for name in ("online", "odometry", "truth")] == [len(final)] * 3
    assert b64decode(found["map"]["source"].partition(",")[2]).startswith(b"\x89PNG")


def test_errors_are_those_of_the_metrics(result: Path) -> None:
    found = playable(result)
    scores = json.loads((result / "metrics.json").read_text())["metrics"]
    assert decoded(found["errors"]["final"], 1e-4).max() == pytest.approx(scores["final.ate_max"]["value"], abs=1e-4)


def test_the_coloured_floor_is_a_layer_of_its_own(result: Path, tmp_path: Path) -> None:
    shutil.copytree(result, tmp_path / "result")
    floor = np.zeros((80, 120, 4), np.uint8)
    write_picture(tmp_path / "result" / "texture.png", Raster(floor, 0.05, (-1.0, -2.0, 0.5)))
    found = playable(tmp_path / "result")["texture"]
    assert {name: found[name] for name in ("x", "y", "yaw", "width", "height")} == {
        **{"x": -1.0, "y": -2.0, "yaw": 0.5, "width": 6.0, "height": 4.0}
    }
    assert found["source"].startswith("data:image/webp;base64,")
    (tmp_path / "result" / "texture.yaml").write_text("resolution: 0.05\n")
    with pytest.raises(InputError, match=r"texture\.yaml: expected resolution and origin"):
        playable(tmp_path / "result")


def test_particles_are_written_and_read(result: Path, run) -> None:
    estimate, _ = run
    stamps, paths = read_particles(result / "particles.npz")
    np.testing.assert_array_equal(stamps, estimate.particle_stamps)
    np.testing.assert_allclose(paths, estimate.particle_paths, atol=1e-5)
    shown = playable(result)["particles"]
    assert len(shown["paths"]) == len(estimate.particle_paths)
    np.testing.assert_allclose(decoded(shown["paths"][0][0])[-1], estimate.particle_paths[0, -1, 0], atol=1e-3)


def test_the_player_has_the_key_scans_where_they_were_taken(result: Path, run) -> None:
    found, session = playable(result)["scans"], run[0].building.sessions[-1]
    assert len(found["t"]) == len(found["places"]) == len(session)
    stamps = run[0].trajectory_final.stamps
    np.testing.assert_allclose(decoded(found["t"]), stamps[session.nodes] - stamps[0], atol=6e-4)
    pose, points = run[0].trajectory_final.poses[session.nodes[-1]], session.points[-session.counts[-1] :]
    ends = np.stack([decoded(axis, 1e-2) for axis in found["places"][-1]], axis=-1)
    np.testing.assert_allclose(ends[[0, -1]], transform_points(pose, points)[[0, -1]], atol=0.01)
    few = playable(result, CLOUDS // 360)["scans"]
    assert len(few["places"]) == 3
    assert sum(few["t"]) == sum(found["t"])


def test_what_is_gathered_of_a_sweep(tmp_path: Path) -> None:
    found = gather([sweep(tmp_path / "s.sweep", fail=1)])
    assert (len(found.runs), found.pending) == (58, 2)
    assert found.wanted == ["final.ate", "map_f1"]
    names = list(compared(found.runs))
    assert names[:2] == ["default, slam.particles=1", "default, slam.particles=10"]
    assert [run.status for run in found.runs].count("failed") == 1


def test_a_report_of_the_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    sweep(Path("s.sweep"))
    assert main.run(["report", "s.sweep", "--json"]) == 0
    size = Path("report.html").stat().st_size
    assert json.loads(capsys.readouterr().out) == {"file": "report.html", "bytes": size, "runs": 58}
    assert main.run(["report", "s.sweep", "--force", "--title", "again"]) == 0
    assert "<title>again</title>" in Path("report.html").read_text(encoding="utf-8")


def test_names_are_text(tmp_path: Path) -> None:
    material = gather([sweep(tmp_path / "s.sweep", fail=2)])
    run = PlannedRun(scenario=HOSTILE, seed=0, configuration=HOSTILE)
    material.runs.append(Row(run, "crashed", HOSTILE))
    material.documents.append((HOSTILE, HOSTILE))
    text = page(material, title=HOSTILE)
    assert [bad for bad in ("<img src=x", "document.title='x'</script>", "\u202e", "\x1b") if bad in text] == []
    assert all(shown in text for shown in ("&lt;/script&gt;", "\\u202e"))


def test_the_policy_allows_the_scripts_of_the_page_and_no_others(tmp_path: Path) -> None:
    text = page(gather([sweep(tmp_path / "s.sweep")]), title="t")
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)
    assert policy[1].startswith("default-src 'none'; ")
    assert "unsafe" not in policy[1]
    scripts = re.findall(r"<script>(.*?)</script>", text, flags=re.S)
    hashes = ["sha256-" + b64encode(hashlib.sha256(each.encode()).digest()).decode() for each in scripts]
    packed = re.search(r'id="library">([^<]*)<', text)
    library = gzip.decompress(b64decode(packed[1])).decode()
    hashes.append("sha256-" + b64encode(hashlib.sha256(library.encode()).digest()).decode())
    assert len(hashes) == 3
    assert len(text) < 2_500_000
    assert all(f"'{each}'" in policy[1] for each in hashes)
    assert "http://" not in re.sub(r"<script>.*?</script>", "", text, flags=re.S)


def test_data_cannot_end_their_script() -> None:
    value = {"</script>": ["<!--", "]]>", "\u2028", "&"]}
    block = data_block(value)
    assert not set("<>&\u2028") & set(block)
    assert json.loads(block) == value


@pytest.mark.parametrize(
    ("stamps", "value", "problem"), [((1.0, 0.0), 0.0, "stamps: stamps go back"), ((0.0, 1.0), np.nan, "paths: ")]
)
def test_damaged_particles_name_their_file(
    tmp_path: Path, stamps: tuple[float, float], value: float, problem: str
) -> None:
    file = tmp_path / "particles.npz"
    np.savez(file, stamps=stamps, paths=np.full((2, 2, 3), value), spread=np.zeros((2, 3)))
    with pytest.raises(InputError, match=rf"particles\.npz: {problem}"):
        read_particles(file)
