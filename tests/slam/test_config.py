"""Presets, overrides, and one-line refusals."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path

import pytest

from moteslam.errors import ConfigError
from moteslam.slam.config import SlamConfig
from moteslam.slam.settings import load_preset, preset_names, resolve_config


def test_the_paper_preset_has_the_papers_parameters():
    paper = load_preset("paper")
    assert paper.method == "paper"
    assert paper.particles == 100
    assert paper.resample_below == 1.0  # III.4 as printed: docs/paper.md
    assert paper.search.offsets_xy == paper.search.offsets_theta == (-0.1, -0.05, 0.0, 0.05, 0.1)
    assert paper.map.log_odds_step == pytest.approx(math.log(4))
    assert paper.map.limit == 50
    assert paper.sync.method == "nearest"
    assert paper.sync.kinematics == "euler"
    assert paper.sync.low_pass_hz == 10


def test_toml_reads_back_equal():
    for name in preset_names():
        config = load_preset(name)
        assert SlamConfig.model_validate(tomllib.loads(config.to_toml())) == config


def test_a_flag_goes_over_the_file_over_the_preset(tmp_path: Path):
    file = tmp_path / "mine.toml"
    file.write_text("particles = 50\n[map]\ncell_size = 0.1\n")
    config = resolve_config("paper", ["particles=30", "sync.method=interpolate"], file)
    assert (config.particles, config.map.cell_size, config.sync.method) == (30, 0.1, "interpolate")
    assert config.map.limit == 50


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("particle=30", "particle: unknown key, expected one of method, particles"),
        ("map.cells=1", "map.cells: unknown key, expected one of cell_size"),
        ("particles=0", "particles"),
        ("particles=many", "particles"),
        ("particles=nan", "particles"),
        ("particles=true", "particles: True, expected a valid integer"),
        ("particles='30'", "particles: '30', expected a valid integer"),
        ("map.cell_size=true", "map.cell_size: True, expected a valid number"),
        ("kld.enabled=1", "kld.enabled: 1, expected a valid boolean"),
        ("registration.rotation=1e6", "registration.rotation: 1000000.0, expected less than or equal to 1"),
        ("registration.translation=1e9", "registration.translation"),
        ("registration.wide_distance=1e9", "registration.wide_distance"),
        ("registration.sure_above=2", "registration.sure_above: 2, expected less than or equal to 1"),
        ("map.cell_size=nan", "map.cell_size"),
        ("map.hit_probability=0.5", "map.hit_probability"),
        ("search.offsets_xy=[0.1, 0.2]", "search.offsets_xy: expected rising offsets, zero among them"),
        ("search.offsets_xy=[]", "search.offsets_xy: 0 items, expected at least 1"),
        ("search.offsets_xy=3", "search.offsets_xy: 3, expected a list"),
        ("method=guess", "method: 'guess', expected 'paper' or 'surface'"),
        ("map=3", "map: 3, expected a table"),
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
    ("setting", "told"),
    [
        ("surface.cell_size=0.5", r"surface: truncation of 0\.16 m, expected 0\.5 to 50 m"),
        ("surface.truncation=0.01", r"surface: truncation of 0\.01 m, expected 0\.08 to 8 m"),
        ("surface.coarse_truncation=0.1", r"surface: coarse_truncation of 0\.1 m, expected 0\.16 to 16 m"),
        ("surface.truncation=1000", r"surface: truncation of 1000 m, expected 0\.08 to 8 m"),
    ],
)
def test_a_truncation_that_does_not_reach_the_next_cell_or_too_far_is_refused(setting: str, told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        resolve_config("default", [setting])
