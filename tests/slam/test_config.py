"""Presets, overrides, and one-line refusals."""

import math
import tomllib
from pathlib import Path

import pytest
from refusals import refusal

from moteslam.errors import ConfigError
from moteslam.slam.config import ParticleFilterConfig, SlamConfig, load_preset, preset_names, resolve_config
from moteslam.slam.paper.config import PaperFilterConfig
from moteslam.slam.tsdf.config import TsdfFilterConfig


def test_the_paper_preset_has_the_papers_parameters():
    paper = load_preset("paper")
    assert paper.particles == 100
    assert paper.resample_below == 1.0  # III.4 as printed: docs/theory/paper.md
    assert paper.search.offsets_xy == paper.search.offsets_theta == (-0.1, -0.05, 0.0, 0.05, 0.1)
    assert paper.map.log_odds_step == pytest.approx(math.log(4))
    assert paper.map.limit == 50
    assert paper.sync.method == "nearest"
    assert paper.sync.kinematics == "euler"
    assert paper.sync.low_pass_hz == 10


def test_presets_are_the_defaults_of_their_models_and_read_back_equal():
    assert load_preset("default") == TsdfFilterConfig()
    assert load_preset("paper") == PaperFilterConfig()
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


REFUSED = {
    "paper": (
        "particle=30", "map.cells=1", "particles=0", "particles=nan", "particles=true", "particles='30'",
        "map.cell_size=nan", "map.hit_probability=0.5", "search.offsets_xy=[0.1, 0.2]", "method=mine", "map=3",
        "search.offsets_theta=[-5, 0, 5]", "colours.enabled=true", "backend.loops=true", "backend.nothing=1",
        "resampling=branching",
    ),
    "default": (
        "registration.rotation=1e6", "tracking.accept_likelihood=2", "backend.method=mine", "backend.method=3",
        "backend.size=3", "backend=3", "tsdf.cell_size=0.5", "tsdf.truncation=0.01", "tsdf.coarse_truncation=0.1",
        "tsdf.truncation=1000",
    ),
}  # fmt: skip


@pytest.mark.parametrize("preset", REFUSED)
def test_a_bad_setting_is_refused_by_its_key_in_one_line(preset: str):
    for setting in REFUSED[preset]:
        with pytest.raises(ConfigError) as caught:
            resolve_config(preset, [setting])
        key = setting.partition("=")[0]
        field = str(caught.value.field)
        assert key.startswith(field) or field.startswith(key), setting
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("preset", "settings"), [("paper", ["particles"]), ("paper", ["=3"]), ("papre", [])])
def test_a_setting_is_a_key_and_a_value_and_a_preset_one_of_those_there_are(preset: str, settings: list[str]):
    with refusal(ConfigError, field="settings" if settings else preset):
        resolve_config(preset, settings)


@pytest.mark.parametrize(
    ("preset", "setting", "said"),
    [
        ("default", "cell_size=1", "unknown key, expected one like map.cell_size"),
        ("default", "backend.distanc=3", "unknown key, expected one like backend.distance; "),
        ("default", "nothing_alike=3", "unknown key, expected one of "),
        ("paper", "motion.yaw_noise=3", "expected one of yaw_rate, translation"),
        ("paper", "search.enabled=false", "expected one of offsets_theta, offsets_xy; "),
        ("paper", "search=off", "expected a table of offsets_xy, offsets_theta, found 'off'"),
        ("paper", "search.offsets_xy=0", "expected a list: [0], found 0"),
        ("paper", "particles=0", "expected at least 1, found 0"),
        ("paper", "particles=true", "expected a whole number, found True"),
        ("default", "map.cell_size=50", "expected at most 1 m, found 50"),
        ("default", "sync.method=3", "expected 'nearest' or 'interpolate', found 3"),
        ("default", "method=mine", "expected one of tsdf, paper, known_map; your own package must be installed: pip"),
    ],
)
def test_what_is_expected_in_place_of_a_value_or_key_is_told(preset: str, setting: str, said: str):
    with pytest.raises(ConfigError) as caught:
        resolve_config(preset, [setting])
    assert said in caught.value.problem
    assert ("like" in caught.value.problem) == ("like" in said)
    assert ("--print-config" in caught.value.problem) == ("unknown key" in caught.value.problem)


def test_a_table_sets_what_its_keys_and_values_do():
    table = {"particles": 7, "map": {"cell_size": 0.1}}
    assert resolve_config("paper", table) == resolve_config("paper", ["particles=7", "map.cell_size=0.1"])
    with refusal(ConfigError, field="map.cell"):
        resolve_config("paper", {"map": {"cell": 0.1}})


@pytest.mark.parametrize("text", [None, "particles = ", "[maps]\n"])
def test_a_bad_file_is_named(tmp_path: Path, text: str | None):
    file = tmp_path / "mine.toml"
    if text is not None:
        file.write_text(text)
    with refusal(ConfigError, file=file):
        resolve_config("paper", [], file)


@pytest.mark.parametrize("model", [SlamConfig, ParticleFilterConfig])
def test_a_configuration_of_no_method_cannot_be_built(model: type[SlamConfig]):
    with pytest.raises(ConfigError, match="expected the model of a method"):
        model(method="tsdf")


def test_another_method_takes_from_a_preset_what_both_know():
    assert resolve_config("paper", ["method=tsdf"]) == TsdfFilterConfig()
    assert resolve_config("default", ["method=paper", "search.offsets_xy=[0]"]).search.offsets_xy == (0.0,)
