"""The specifications that come with the package: found by name, listed, and identified by a hash."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from command_lines import printed, refused

from moteslam.eval.runs import read_table
from moteslam.eval.sweep.plan import PLATFORMS, SCENARIOS, PlannedRun, digest, plan
from moteslam.eval.sweep.spec import bundled_specs, read_spec
from moteslam.eval.sweep.store import opened

SUITE_1 = "e6250b323c16c3c3ba468dcda1f89303fe1a35ee901fcc90a598da2345b8b252"
"""The whole hash of corridor-suite-1."""
PUBLISHED = Path(__file__).parents[2] / "benchmarks" / "results" / "corridor-suite-1.csv"
RECIPES = {
    *("particles", "lidar-beams", "lidar-range", "range-noise"),
    *("encoder-noise", "yaw-noise", "key-scan-spacing", "people"),
}
ONE = 'scenarios = ["corridor"]\nseeds = "0"\nduration = 4\n'


def runs_of(name: str) -> list[PlannedRun]:
    return plan(read_spec(bundled_specs()[name]), check=False)


@pytest.mark.parametrize("name", sorted({*RECIPES, "corridor-suite-1"}))
def test_each_can_be_run_and_says_what_it_is_for(name: str) -> None:
    spec = read_spec(bundled_specs()[name])
    assert spec.name == name
    assert spec.description.endswith(".")
    assert 100 <= len(plan(spec)) <= 200  # every key and value is checked


def test_the_suite_is_what_it_was() -> None:
    assert digest(runs_of("corridor-suite-1")) == SUITE_1, (
        "the runs of corridor-suite-1 have changed: a spec, scenario or robot was edited. Published tables are of the "
        "runs as they were, so undo that, or leave corridor-suite-1 out and add corridor-suite-2 with a new hash"
    )


def test_the_hash_follows_from_scenarios_and_robots(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, folder in (("SCENARIOS", SCENARIOS), ("PLATFORMS", PLATFORMS)):
        shutil.copytree(folder, tmp_path / name)
        monkeypatch.setattr(f"moteslam.eval.sweep.plan.{name}", tmp_path / name)
    runs = runs_of("corridor-suite-1")
    before = digest(runs)

    def changed(file: str, old: str, new: str) -> bool:
        text = (tmp_path / file).read_text(encoding="utf-8")
        assert old in text
        (tmp_path / file).write_text(text.replace(old, new, 1), encoding="utf-8")
        after = digest(runs)
        (tmp_path / file).write_text(text, encoding="utf-8")
        return after != before

    assert changed("SCENARIOS/corridor.toml", "[[world", "[drive]\nspeed = 0.5\n\n[[world")
    assert changed("PLATFORMS/lms200.toml", "range_noise = 0.005", "range_noise = 0.006")
    assert not changed("SCENARIOS/campus.toml", "[[world", "[drive]\nspeed = 0.5\n\n[[world")
    assert not changed("PLATFORMS/lms200.toml", "# technical", "# the technical")
    assert not changed("SCENARIOS/corridor.toml", "description = ", 'description = "Other words." # ')
    assert digest(runs[::-1]) == before
    assert digest(runs[1:]) != before


def test_the_hash_follows_from_robots_that_scenarios_name(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text('base = "rplidar_a1"\nwidth = 0.3\n', encoding="utf-8")
    scenario = (SCENARIOS / "corridor.toml").read_text(encoding="utf-8")
    (tmp_path / "here.toml").write_text(f'platform = "mine.toml"\n{scenario}', encoding="utf-8")
    (tmp_path / "spec.toml").write_text(ONE.replace('"corridor"', '"here.toml"'), encoding="utf-8")
    runs = plan(read_spec(tmp_path / "spec.toml"))
    before = digest(runs)
    (tmp_path / "mine.toml").write_text('base = "rplidar_a1"\nwidth = 0.31\n', encoding="utf-8")
    assert digest(runs) != before


def test_the_hash_is_recorded_and_other_runs_of_the_same_names_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = tmp_path / "spec.toml"
    spec.write_text(ONE, encoding="utf-8")
    monkeypatch.setattr("moteslam.eval.sweep.workers.make_all", lambda *_, **__: iter(()))
    assert json.loads(printed(capsys, "sweep", spec, "--json"))["hash"] == digest(plan(read_spec(spec)))
    spec.write_text(f'description = "What it is for."\n{ONE}', encoding="utf-8")
    printed(capsys, "sweep", spec)  # words are no other sweep
    monkeypatch.setattr("moteslam.eval.sweep.store.digest", lambda _: "0" * 64)
    assert "has runs of other scenarios or robots of these names" in refused(capsys, "sweep", spec)


def test_a_bundled_one_is_run_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "particles").mkdir()  # the name is no path
    monkeypatch.setattr("moteslam.eval.sweep.workers.make_all", lambda *_, **__: iter(()))
    assert "recorded in particles.sweep" in printed(capsys, "sweep", "particles")
    with opened(tmp_path / "particles.sweep") as store:
        assert store.counts() == {"": len(runs_of("particles"))}


def test_they_are_listed_and_printed(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    lines = printed(capsys, "sweep", "list").splitlines()
    assert [line.split()[0] for line in lines[1:]] == sorted(bundled_specs())
    suite = next(line for line in lines if line.startswith("corridor-suite-1"))
    assert suite.split()[1:3] == ["200", SUITE_1[:16]]
    found = {one["name"]: one for one in json.loads(printed(capsys, "sweep", "list", "--json"))}
    assert found["corridor-suite-1"]["hash"] == SUITE_1
    (tmp_path / "mine.toml").write_text(printed(capsys, "sweep", "list", "people"), encoding="utf-8")
    assert plan(read_spec(tmp_path / "mine.toml")) == runs_of("people")
    assert 'name = "people"' in json.loads(printed(capsys, "sweep", "list", "people", "--json"))["toml"]


def test_the_published_results_of_the_suite_are_of_its_runs() -> None:
    """So that ``sweep diff`` compares all of them."""
    table = read_table(PUBLISHED)
    assert set(table) == {run.id for run in runs_of("corridor-suite-1")}
    assert {row["status"] for row in table.values()} == {"ok"}
