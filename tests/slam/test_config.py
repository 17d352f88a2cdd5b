"""Presets, overrides, and one-line refusals."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path

import pytest

from moteslam.errors import ConfigError
from moteslam.slam.config import ParticleFilterConfig, SlamConfig
from moteslam.slam.paper.config import PaperFilterConfig
from moteslam.slam.settings import load_preset, preset_names, resolve_config
from moteslam.slam.tsdf.config import TsdfFilterConfig


def test_the_paper_preset_has_the_papers_parameters():
    paper = load_preset("paper")
    assert isinstance(paper, PaperFilterConfig)
    assert paper.particles == 100
    assert paper.resample_below == 1.0  # III.4 as printed: docs/theory/paper.md
    assert paper.search.offsets_xy == paper.search.offsets_theta == (-0.1, -0.05, 0.0, 0.05, 0.1)
    assert paper.map.log_odds_step == pytest.approx(math.log(4))
    assert paper.map.limit == 50
    assert paper.sync.method == "nearest"
    assert paper.sync.kinematics == "euler"
    assert paper.sync.low_pass_hz == 10


def test_toml_reads_back_equal():
    for name in preset_names():
        config = load_preset(name)
        assert type(config).model_validate(tomllib.loads(config.to_toml())) == config


def test_a_flag_goes_over_the_file_over_the_preset(tmp_path: Path):
    file = tmp_path / "mine.toml"
    file.write_text("particles = 50\n[map]\ncell_size = 0.1\n")
    config = resolve_config("paper", ["particles=30", "sync.method=interpolate"], file)
    assert (config.particles, config.map.cell_size, config.sync.method) == (30, 0.1, "interpolate")
    assert config.map.limit == 50


def test_another_back_end_drops_the_keys_of_the_one_below(tmp_path: Path):
    file = tmp_path / "mine.toml"
    file.write_text('[backend]\nmethod = "graph"\ndistance = 0.25\n')
    assert resolve_config("default", file=file).backend.model_dump()["distance"] == 0.25
    assert resolve_config("default", ["backend.method=none"], file).backend.model_dump() == {"method": "none"}
    with pytest.raises(ConfigError, match="distance"):
        resolve_config("default", ["backend.method=none", "backend.distance=0.3"], file)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("particle=30", "particle: "),
        ("map.cells=1", "map.cells: "),
        ("particles=0", "particles"),
        ("particles=many", "particles"),
        ("particles=nan", "particles"),
        ("particles=true", "particles: "),
        ("particles='30'", "particles: "),
        ("map.cell_size=true", "map.cell_size: "),
        ("kld.enabled=1", "kld.enabled: "),
        ("map.cell_size=nan", "map.cell_size"),
        ("map.hit_probability=0.5", "map.hit_probability"),
        ("search.offsets_xy=[0.1, 0.2]", "search.offsets_xy: expected rising offsets, zero among them"),
        ("search.offsets_xy=[]", "search.offsets_xy: "),
        ("search.offsets_xy=3", "search.offsets_xy: "),
        ("method=mine", "method: 'mine', expected one of tsdf, paper"),
        ("map=3", "map: "),
        ("particles", "expected key=value"),
        ("=3", "expected key=value"),
    ],
)
def test_a_bad_setting_is_refused_in_one_line(setting: str, words: str):
    with pytest.raises(ConfigError) as caught:
        resolve_config("paper", [setting])
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_unknown_preset_lists_those_there_are():
    with pytest.raises(ConfigError, match=r"expected one of .*paper"):
        load_preset("papre")


@pytest.mark.parametrize("text", ["particles = ", "particles = 'x'", "[maps]\n", "\x00"])
def test_a_bad_file_is_named(tmp_path: Path, text: str):
    file = tmp_path / "mine.toml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=r"mine\.toml"):
        resolve_config("paper", [], file)
    with pytest.raises(ConfigError, match=r"none\.toml"):
        resolve_config("paper", [], tmp_path / "none.toml")


@pytest.mark.parametrize(
    ("setting", "problem"),
    [
        ("registration.rotation=1e6", r"registration\.rotation: "),
        ("registration.translation=1e9", r"registration\.translation: "),
        ("tracking.relocation_distance=1e9", r"tracking\.relocation_distance: "),
        ("tracking.accept_likelihood=2", r"tracking\.accept_likelihood: "),
        ("tsdf.cell_size=0.5", r"tsdf: truncation of 0\.16 m, expected 0\.5 to 50 m"),
        ("tsdf.truncation=0.01", r"tsdf: truncation of 0\.01 m, expected 0\.08 to 8 m"),
        ("tsdf.coarse_truncation=0.1", r"tsdf: coarse_truncation of 0\.1 m, expected 0\.16 to 16 m"),
        ("tsdf.truncation=1000", r"tsdf: truncation of 1000 m, expected 0\.08 to 8 m"),
    ],
)
def test_values_out_of_bounds_are_refused(setting: str, problem: str) -> None:
    with pytest.raises(ConfigError, match=problem):
        resolve_config("default", [setting])


def test_the_presets_are_the_defaults_of_their_models():
    assert load_preset("default") == TsdfFilterConfig()
    assert load_preset("paper") == PaperFilterConfig()


@pytest.mark.parametrize("model", [SlamConfig, ParticleFilterConfig])
def test_a_configuration_of_no_method_cannot_be_built(model: type[SlamConfig]):
    with pytest.raises(ValueError, match="expected the model of a method"):
        model()
    with pytest.raises(ValueError, match="expected the model of a method"):
        model(method="tsdf")


def test_another_method_takes_from_a_preset_what_both_know():
    config = resolve_config("paper", ["method=tsdf"])
    assert isinstance(config, TsdfFilterConfig)
    assert config == TsdfFilterConfig()
    assert resolve_config("default", ["method=paper", "search.offsets_xy=[0]"]).search.offsets_xy == (0.0,)


@pytest.mark.parametrize(
    ("setting", "line"),
    [
        ("backend.method=mine", "backend.method: 'mine', expected one of none, graph"),
        ("backend.method=3", "backend.method: 3, expected one of none, graph"),
        ("backend.size=3", "backend.size: "),
        ("backend=3", "backend: "),
    ],
)
def test_a_back_end_that_is_none_is_refused(setting: str, line: str):
    with pytest.raises(ConfigError) as caught:
        resolve_config("default", [setting])
    assert str(caught.value).startswith(line)


@pytest.mark.parametrize(("preset", "settings"), [("default", ["backend.method=none"]), ("paper", [])])
def test_a_key_of_another_back_end_is_named_so(preset: str, settings: list[str]):
    with pytest.raises(ConfigError, match=r'^backend\.loops: no key of the back end "none", expected "graph"$'):
        resolve_config(preset, [*settings, "backend.loops.enabled=false"])
    with pytest.raises(ConfigError, match=r"^backend\.nothing: "):
        resolve_config(preset, [*settings, "backend.nothing=1"])
