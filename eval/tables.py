"""Rows of text as a table of a format: Markdown, LaTeX or CSV, with what means something there escaped."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Sequence

Rows = Sequence[Sequence[str]]

LATEX = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    **{character: f"\\{character}" for character in "&%$#_{}"},
    **{character: f"{{{character}}}" for character in "[]*"},
}
"""What stands for a character; those in braces would be an argument of the line break before them."""
LIGATURES = re.compile(r"([-`',!?])(?=[-`',])")
"""Characters that LaTeX would join with the next one, such as two hyphens."""
MARKDOWN = re.compile(r"([\\`*_{}\[\]<>|~$&#])")
"""Characters that mark something up, in GitHub's dialect too."""


def markdown(rows: Rows, *, right: Sequence[int] = ()) -> str:
    """A table of GitHub's Markdown.

    Args:
        rows: of cells, the first one the head; all of one length.
        right: indices of the columns that are flush right.
    """
    lines = [f"| {' | '.join(map(_markdown, row))} |" for row in rows]
    rule = "".join("---:|" if index in right else "---|" for index in range(len(rows[0])))
    return "\n".join([lines[0], f"|{rule}", *lines[1:]])


def latex(rows: Rows, *, right: Sequence[int] = ()) -> str:
    """A ``tabular`` of LaTeX that needs no package; arguments as of ``markdown``."""
    columns = "".join("r" if index in right else "l" for index in range(len(rows[0])))
    lines = [f"{' & '.join(map(_latex, row))} \\\\" for row in rows]
    begin, end = f"\\begin{{tabular}}{{{columns}}}", "\\end{tabular}"
    return "\n".join([begin, "\\hline", lines[0], "\\hline", *lines[1:], "\\hline", end])


def comma_separated(rows: Rows, *, right: Sequence[int] = ()) -> str:
    """CSV as RFC 4180 has it, but for line feeds alone; ``right`` changes nothing."""
    del right
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().removesuffix("\n")


FORMATS: dict[str, Callable[..., str]] = {"markdown": markdown, "latex": latex, "csv": comma_separated}
"""What writes rows in each format, without a line feed at the end."""


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _markdown(text: str) -> str:
    return MARKDOWN.sub(r"\\\1", _one_line(text))


def _latex(text: str) -> str:
    return LIGATURES.sub(r"\1{}", "".join(LATEX.get(character, character) for character in _one_line(text)))
