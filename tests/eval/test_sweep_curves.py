"""Curves of a sweep: which lines there are, where they lie, and that they are drawn."""

from __future__ import annotations

from math import inf
from pathlib import Path

import pytest
from made_sweeps import swept
from PIL import Image

from moteslam.eval.cli import main
from moteslam.eval.report.sweep_curves import Places, _unit, dodged, draw_sweep, far_apart, lines_of
from moteslam.eval.statistics import Proportion, Summary
from moteslam.eval.sweep.tables import GroupSummary


def group(scenario: str, configuration: str, error: float | None, **varied: object) -> GroupSummary:
    about = {"scenario": scenario, "platform": "", "noise": "", "configuration": configuration, **varied}
    values = [None] if error is None else [error]
    summary = Summary.of(values if error != inf else [], 1 if error == inf else 0)
    return GroupSummary(about, 1, Proportion(1, 1), {"final.ate": summary})


def test_numbers_lie_where_they_are_and_words_side_by_side() -> None:
    assert [Places.of([10, 1.0, 3]).of_value(value) for value in (1.0, 3, 10)] == [1.0, 3.0, 10.0]
    assert Places.of(["90", "45"]).values == ["45", "90"]
    assert Places.of(["90", "45"]).of_value("45") == 45.0
    words = Places.of(["none", "graph", "none"])
    assert [words.of_value(value) for value in ("none", "graph")] == [0.0, 1.0]
    assert Places.of([False, True]).of_value(True) == 1.0
    assert not Places.of([True, False]).numeric


def test_axes_are_logarithmic_where_values_are_far_apart() -> None:
    assert far_apart([1, 12])
    assert not far_apart([1, 11])
    assert not far_apart([0, 100])
    assert Places.of([1, 3, 10]).logarithmic
    assert not Places.of([0, 4, 32]).logarithmic
    assert not Places.of(["a", "b"]).logarithmic


def test_lines_beside_each_other() -> None:
    assert dodged([0.0, 10.0], 0.01, (0.0, 10.0), logarithmic=False) == pytest.approx([0.1, 10.1])
    assert dodged([1.0, 100.0], 0.5, (1.0, 100.0), logarithmic=True) == pytest.approx([10.0, 1000.0])


def test_a_colour_a_scenario_and_dashes_a_configuration() -> None:
    groups = [
        group(scenario, configuration, value, **{"slam.particles": count})
        for scenario in ("corridor", "office")
        for configuration in ("default", "paper")
        for count, value in ((10, 0.1), (3, 0.2))
    ]
    lines = lines_of(groups, "slam.particles", Places.of([10, 3]))
    assert [line.label for line in lines] == [
        "corridor, default", "corridor, paper", "office, default", "office, paper"
    ]  # fmt: skip
    colours, dashes = ([line.look[key] for line in lines] for key in ("color", "ls"))
    assert colours[0] == colours[1]
    assert colours[0] != colours[2]
    assert dashes[0] == dashes[2]
    assert dashes[0] != dashes[1]
    assert lines[0].places == [3.0, 10.0]
    assert [one.values["final.ate"].median for one in lines[0].groups] == [0.2, 0.1]


@pytest.mark.parametrize(
    "errors", [(0.1, 0.2, 0.3), (0.01, 0.1, 5.0), (0.1, inf, None), (inf, inf, inf), (0.0, 0.0, 0.0)]
)
def test_whatever_the_values_are_they_are_drawn(errors: tuple[float | None, ...], tmp_path: Path) -> None:
    groups = [group("corridor", "default", error, **{"slam.particles": k}) for k, error in enumerate(errors)]
    draw_sweep(tmp_path / "a.png", groups, ["final.ate"], column="slam.particles", label="$ [m]", title="$\\x")
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.size[0] > 500
        assert len(picture.convert("RGB").getcolors(1 << 24) or ()) > 10


def test_errors_below_a_metre_are_drawn_in_centimetres() -> None:
    assert _unit("m", [0.02, 0.99]) == ("cm", 100.0)
    assert _unit("m", [0.02, 1.0]) == ("m", 1.0)
    assert _unit("m", []) == ("m", 1.0)
    assert _unit("deg", [0.02]) == ("deg", 1.0)


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, out = swept(tmp_path), tmp_path / "new" / "a.png"
    assert main.run(["sweep", "plot", str(file), "--out", str(out), "--label", "window"]) == 0
    before = out.read_bytes()
    assert main.run(["sweep", "plot", str(file), "--out", str(out), "--x", "configuration", "--force"]) == 0
    assert out.read_bytes() != before
    capsys.readouterr()
    for options, problem in (
        (["--out", str(out)], "a.png: exists already"),
        (["--out", str(tmp_path / "a.pdf")], "a.pdf: expected a name that ends in .png"),
        (
            ["--out", str(tmp_path / "b.png"), "--x", "seed"],
            "--x: 'seed', expected one of scenario, configuration, slam.",
        ),
        (["--out", str(tmp_path / "b.png"), "--metric", "map_f1"], "a.sweep: no run that ended well has map_f1"),
        (["--out", str(tmp_path / "b.png"), "--metric", "mapf1"], "'mapf1', expected one of"),
    ):
        assert main.run(["sweep", "plot", str(file), *options]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert problem in line
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.sweep", "a.toml", "new"]
