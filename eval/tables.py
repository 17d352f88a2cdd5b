"""Text from elsewhere, shown and not obeyed, and rows of it as a table: aligned, Markdown, LaTeX or CSV."""

from __future__ import annotations

import csv
import io
import re
import unicodedata
from collections.abc import Callable, Sequence

Rows = Sequence[Sequence[str]]
"""Of cells, the first one the head; all of one length."""

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
NUMBER = re.compile(r"([-+±]*[0-9][0-9.]*(e[-+][0-9]+)?( .*|$))?|-|failed")
"""Cells of columns that are flush right: numbers, with what follows them, and what stands in their place."""


def literal(text: object) -> str:
    r"""Text in one line that a terminal shows and does not obey.

    Control characters, line breaks and reversals of the writing direction are written as escapes (``\x1b``), and so
    are the bytes of a file name that is no text (``\xe9``); everything else, brackets of markup too, stays as it is.
    """
    return "".join(map(_literal, str(text)))


def _literal(character: str) -> str:
    if "\udc80" <= character <= "\udcff":  # how Python writes a byte that is no text
        return f"\\x{ord(character) - 0xDC00:02x}"
    if unicodedata.category(character) in ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"):
        return character.encode("unicode_escape").decode("ascii")
    return character


def aligned(rows: Rows) -> str:
    """Columns two spaces apart, as wide as their text, control characters escaped."""
    from rich.cells import cell_len

    rows = [[literal(cell) for cell in row] for row in rows]
    widths = [max(map(cell_len, column)) for column in zip(*rows, strict=True)]
    right = _numeric(rows)

    def padded(row: Sequence[str]) -> str:
        gaps = [" " * (width - cell_len(cell)) for cell, width in zip(row, widths, strict=True)]
        cells = [gap + cell if k in right else cell + gap for k, (cell, gap) in enumerate(zip(row, gaps, strict=True))]
        return "  ".join(cells).rstrip()

    return "\n".join(map(padded, rows))


def markdown(rows: Rows) -> str:
    """A table of GitHub's Markdown."""
    head, *lines = [f"| {' | '.join(map(_markdown, row))} |" for row in rows]
    right = _numeric(rows)
    rule = "".join("---:|" if index in right else "---|" for index in range(len(rows[0])))
    return "\n".join([head, f"|{rule}", *lines])


def latex(rows: Rows) -> str:
    """A ``tabular`` of LaTeX that needs no package."""
    right = _numeric(rows)
    columns = "".join("r" if index in right else "l" for index in range(len(rows[0])))
    head, *lines = [f"{' & '.join(map(_latex, row))} \\\\" for row in rows]
    begin, end = f"\\begin{{tabular}}{{{columns}}}", "\\end{tabular}"
    return "\n".join([begin, "\\hline", head, "\\hline", *lines, "\\hline", end])


def comma_separated(rows: Rows) -> str:
    """CSV as RFC 4180 has it, but for line feeds alone."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().removesuffix("\n")


FORMATS: dict[str, Callable[[Rows], str]] = {
    "text": aligned,
    "markdown": markdown,
    "latex": latex,
    "csv": comma_separated,
}
"""What writes rows in each format, without a line feed at the end."""


def _numeric(rows: Rows) -> set[int]:
    """The columns that hold numbers below their head."""
    return {k for k, (_, *cells) in enumerate(zip(*rows, strict=True)) if cells and all(map(NUMBER.fullmatch, cells))}


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _markdown(text: str) -> str:
    return MARKDOWN.sub(r"\\\1", _one_line(text))


def _latex(text: str) -> str:
    return LIGATURES.sub(r"\1{}", "".join(LATEX.get(character, character) for character in _one_line(text)))
