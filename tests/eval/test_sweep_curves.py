"""Curves of a sweep: which lines there are, where they lie, and that they are drawn."""

from __future__ import annotations

from math import inf
from pathlib import Path

import pytest
from command_lines import refused
from made_sweeps import swept
from PIL import Image

from moteslam.eval.cli import main
from moteslam.eval.report.sweep_curves import axis_unit, draw_sweep, far_apart, lines_of, places_of
from moteslam.eval.statistics import Proportion, Summary
from moteslam.eval.sweep.tables import GroupSummary


def group(scenario: str, configuration: str, error: float | None, **varied: object) -> GroupSummary:
    about = {"scenario": scenario, "platform": "", "noise": "", "configuration": configuration, **varied}
    values = [None] if error is None else [error]
    summary = Summary.of(values if error != inf else [], 1 if error == inf else 0)
    return GroupSummary(about, 1, Proportion(1, 1), {"final.ate": summary})


@pytest.mark.parametrize(
    ("values", "places"),
    [
        ([10, 1.0, 3], {1.0: 1.0, 3: 3.0, 10: 10.0}),
        (["90", "45"], {"45": 45.0, "90": 90.0}),
        (["none", "graph", "none"], {"none": 0.0, "graph": 1.0}),
        ([True, False], {True: 0.0, False: 1.0}),
    ],
)
def test_numbers_lie_where_they_are_and_words_side_by_side(values: list[object], places: dict[object, float]) -> None:
    assert list(places_of(values).items()) == list(places.items())


def test_axes_are_logarithmic_where_values_are_far_apart() -> None:
    assert far_apart([1, 12])
    assert not far_apart([1, 11])
    assert not far_apart([0, 100])


def test_a_colour_a_scenario_and_dashes_a_configuration() -> None:
    groups = [
        group(scenario, configuration, value, **{"slam.particles": count})
        for scenario in ("corridor", "office")
        for configuration in ("default", "paper")
        for count, value in ((10, 0.1), (3, 0.2))
    ]
    lines = lines_of(groups, "slam.particles", places_of([10, 3]))
    assert [line.label for line in lines] == [
        "corridor, default", "corridor, paper", "office, default", "office, paper"
    ]  # fmt: skip
    colours, dashes = ([line.look[key] for line in lines] for key in ("color", "ls"))
    assert colours[0] == colours[1] != colours[2]
    assert dashes[0] == dashes[2] != dashes[1]
    assert lines[0].places == [3.0, 10.0]
    assert [one.values["final.ate"].median for one in lines[0].groups] == [0.2, 0.1]


@pytest.mark.parametrize(
    "errors", [(0.1, 0.2, 0.3), (0.01, 0.1, 5.0), (0.1, inf, None), (inf, inf, inf), (0.0, 0.0, 0.0)]
)
def test_whatever_the_values_are_they_are_drawn(errors: tuple[float | None, ...], tmp_path: Path) -> None:
    groups = [group("corridor", "default", error, **{"slam.particles": k}) for k, error in enumerate(errors)]
    draw_sweep(tmp_path / "a.png", groups, ["final.ate"], column="slam.particles", label="$ [m]")
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.size[0] > 500
        assert len(picture.convert("RGB").getcolors(1 << 24) or ()) > 10


def test_errors_below_a_metre_are_drawn_in_centimetres() -> None:
    assert axis_unit("m", [0.02, 0.99]) == ("cm", 100.0)
    assert axis_unit("m", [0.02, 1.0]) == axis_unit("m", []) == ("m", 1.0)
    assert axis_unit("deg", [0.02]) == ("deg", 1.0)


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, out = swept(tmp_path), tmp_path / "new" / "a.png"
    assert main.run(["sweep", "plot", str(file), "--out", str(out), "--label", "window"]) == 0
    before = out.read_bytes()
    assert main.run(["sweep", "plot", str(file), "--out", str(out), "--x", "configuration", "--force"]) == 0
    assert out.read_bytes() != before
    capsys.readouterr()
    for options, problem in (
        (["--out", str(out)], "a.png: exists already"),
        (["--out", str(tmp_path / "a.pdf")], "a.pdf: "),
        (["--out", str(tmp_path / "b.png"), "--x", "seed"], "--x: 'seed', expected one of scenario, configuration"),
        (["--out", str(tmp_path / "b.png"), "--metric", "map_f1"], "a.sweep: no run that ended well has map_f1"),
        (["--out", str(tmp_path / "b.png"), "--metric", "mapf1"], "'mapf1', expected one of"),
    ):
        assert problem in refused(capsys, "sweep", "plot", file, *options)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.sweep", "a.toml", "new"]
