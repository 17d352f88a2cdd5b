"""Tables as Markdown, LaTeX and CSV: what is written reads back as it was."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import pytest
from command_lines import printed
from made_sweeps import swept

from moteslam.eval.cli import main
from moteslam.eval.tables import aligned, comma_separated, fitting, latex, markdown, number

NASTY = r"a|b \ `c` <d> *e* _f_ [g] ~h~ $i$ & #j 100 % {k} ^l"
HEAD = ("name", "value")


def test_markdown_marks_nothing_up() -> None:
    lines = markdown([HEAD, (NASTY, "1.5")]).splitlines()
    assert lines[:2] == ["| name | value |", "|---|---:|"]
    assert lines[2] == (r"| a\|b \\ \`c\` \<d\> \*e\* \_f\_ \[g\] \~h\~ \$i\$ \& \#j 100 % \{k\} ^l | 1.5 |")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("\\", r"\textbackslash{}"),
        ("50 %", r"50 \%"),
        ("map_f1", r"map\_f1"),
        ("a & b", r"a \& b"),
        ("#$", r"\#\$"),
        ("{}", r"\{\}"),
        ("~", r"\textasciitilde{}"),
        ("^", r"\textasciicircum{}"),
        ("<|>", r"\textless{}\textbar{}\textgreater{}"),
        ("[m] *", "{[}m{]} {*}"),
        ("a--b---c", "a-{}-b-{}-{}-c"),
        ("-0.5", "-0.5"),
        ("``a''", "`{}`a'{}'"),
        ("a\nb", "a b"),
    ],
)
def test_latex_prints_what_it_is_given(text: str, expected: str) -> None:
    assert latex([(text,)]).splitlines()[3] == rf"{expected} \\"


def test_a_table_wider_than_the_terminal_is_broken_between_words(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [
        ("scenario", "median of the final error [mm]", "what it is"),
        ("corridor", "1.23", "a way of many turns"),
    ]
    monkeypatch.delenv("COLUMNS", raising=False)
    assert len(aligned(rows).splitlines()) == 2
    monkeypatch.setenv("COLUMNS", "40")
    lines = aligned(rows).splitlines()
    assert max(map(len, lines)) <= 40
    assert set(" ".join(lines).split()) == {word for row in rows for cell in row for word in cell.split()}


@pytest.mark.parametrize(
    ("unit", "values", "shown"),
    [
        ("m", [0.001697, -8.899e-05], ["mm", "1.70", "-0.0890"]),
        ("m", [0.153, None], ["cm", "15.3", "-"]),
        ("m", [12.0, 0.05], ["m", "12.0", "0.0500"]),
        ("deg", [0.02, float("inf")], ["deg", "0.0200", "failed"]),
        ("", [12345.0, 0.0], ["", "12345", "0"]),
    ],
)
def test_numbers_have_a_unit_that_fits(unit: str, values: list[float | None], shown: list[str]) -> None:
    unit, factor = fitting(unit, values)
    assert [unit, *(number(None if value is None else factor * value) for value in values)] == shown


def test_csv_reads_back() -> None:
    rows = [list(HEAD), [NASTY, 'say "1,5"'], ["two\nlines", ""]]
    assert list(csv.reader(comma_separated(rows).split("\n"))) != rows  # a cell of two lines is one of the file, too
    assert list(csv.reader(comma_separated(rows).splitlines(keepends=True))) == rows


def test_a_sweep_in_every_format(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = swept(tmp_path)
    lines = printed(capsys, "sweep", "show", file, "--format", "markdown").splitlines()
    assert len(lines) == 2 + 4
    assert lines[0].startswith(
        "| scenario | configuration | slam.tracking.window | runs | success | final ATE \\[cm\\] | 95 % |"
    )
    assert lines[4].startswith(r"| corridor | a\_b | 1.0 | 4 | 4 (51 to 100 %) | 11.5 | - |")
    assert " | failed | " in lines[5]
    tex = printed(capsys, "sweep", "show", file, "--format", "latex").splitlines()
    assert tex[7].startswith(r"corridor & a\_b & 1.0 & 4 & 4 (51 to 100 \%) & 11.5 & ")
    table = list(csv.DictReader(printed(capsys, "sweep", "show", file, "--format", "csv").splitlines()))
    assert [row["final ATE [cm]"] for row in table] == ["11.5", "21.5", "11.5", "failed"]
    assert json.loads(printed(capsys, "sweep", "show", file, "--json"))["hash"] == "ab"


def test_runs_without_a_result_are_counted_on_stderr(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = swept(tmp_path, whole=False)
    assert main.run(["sweep", "show", str(file), "--format", "csv"]) == 0
    assert "13 not made yet, 3 ok" in capsys.readouterr().err


def test_configurations_compared_in_every_format(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = swept(tmp_path)
    text = printed(capsys, "compare", file)
    assert text.splitlines()[0] == "final ATE [cm], against plain, slam.tracking.window=1.0"
    lines = printed(capsys, "compare", file, "--format", "markdown").splitlines()
    assert lines[0].startswith("| metric | configuration | pairs | better |")
    assert re.match(r"\| final ATE \\\[cm\\\] \| a\\_b, slam.tracking.window=1.0 \| 4 \| 0 \| 0 \| 4 \|", lines[3])
    assert r"a\_b, slam.tracking.window=1.0" in printed(capsys, "compare", file, "--format", "latex")
    table = list(csv.DictReader(printed(capsys, "compare", file, "--format", "csv").splitlines()))
    by_name = {row["configuration"]: row for row in table}
    assert by_name["plain, slam.tracking.window=2.0"]["median difference"] == "+10.0"
    assert by_name["a_b, slam.tracking.window=2.0"]["failed"] == "3"
