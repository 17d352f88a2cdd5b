"""Text from elsewhere, shown and not obeyed, and rows of it as a table: aligned, Markdown, LaTeX or CSV."""

import csv
import io
import re
import shutil
import textwrap
import unicodedata
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import zip_longest
from math import floor, isfinite, isinf, isnan, log10
from statistics import median
from typing import Any, NamedTuple

Rows = Sequence[Sequence[str]]  # Of cells, the first one the head; all of one length

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
LENGTHS = (("mm", 1e3, 0.02), ("cm", 1e2, 1.0))
"""Units of lengths, of each how many are a metre, and below which length [m] it is taken."""


def fitting(unit: str, values: Iterable[float | None]) -> tuple[str, float]:
    """The unit of a column of values in SI, and the factor to it: of lengths the mm, cm or m that fit the median."""
    sizes = [abs(value) for value in values if value is not None and isfinite(value)]
    if unit == "m" and sizes:
        return next(((name, factor) for name, factor, below in LENGTHS if median(sizes) < below), (unit, 1.0))
    return unit, 1.0


def length(metres: float) -> str:
    """A single length in the unit that fits it."""
    unit, factor = fitting("m", [metres])
    return f"{number(factor * metres)} {unit}"


def number(value: float | None, *, sign: bool = False) -> str:
    """Three significant digits, in at most four decimals, of a difference (``sign``) nine, never as a power of ten; a
    dash for none, ``failed`` for one that is infinite.
    """
    if value is None or isnan(value):
        return "-"
    if isinf(value):
        return "failed"
    decimals = min(max(2 - floor(log10(abs(value))), 0), 9 if sign else 4) if value else 0
    text = f"{value:{'+' if sign else ''}.{decimals}f}"
    return text if float(text) else "0"


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


def shortened(text: str, longest: int) -> str:
    """Printable text of at most this number of characters."""
    text = literal(text)
    return text if len(text) <= longest else f"{text[: longest - 1]}…"


class Column(NamedTuple):
    """A figure in a table: the head of its column, its place in dicts, ``ate/rmse``, and its format.

    A ``number`` has its unit in the head; that of lengths is one that fits the column, or the column at ``like``.
    """

    head: str
    place: str
    form: str = ""
    unit: str = ""
    factor: float = 1
    like: str = ""

    def cells(self, rows: Sequence[Mapping[str, Any]]) -> list[str]:
        """The head, and the figure of each dict, a dash where it has none."""
        found = _at(rows, self.place)
        if self.form == "number":
            unit, factor = fitting(self.unit, _at(rows, self.like or self.place))
            head = f"{self.head} [{unit}]" if unit else self.head
            return [head, *(number(None if one is None else factor * one) for one in found)]
        values = (one if one is None or isinstance(one, str) else self.factor * one for one in found)
        return [self.head, *("-" if one is None else f"{one:{self.form}} {self.unit}".rstrip() for one in values)]


def _at(rows: Iterable[Any], place: str) -> list[Any]:
    for key in place.split("/"):
        rows = [None if one is None else one.get(key) for one in rows]
    return list(rows)


def rows_of(columns: Sequence[Column], figures: Iterable[Mapping[str, Any]]) -> Rows:
    """The rows of a table, the head and one a dict."""
    figures = list(figures)
    return list(zip(*(column.cells(figures) for column in columns), strict=True))


def aligned(rows: Rows) -> str:
    """Columns two spaces apart, as wide as their text, control characters escaped.

    On a terminal that is narrower heads are broken between words, then cells, those of the widest columns first.
    """
    from rich.cells import cell_len

    rows = [[literal(cell) for cell in row] for row in rows]
    right = _numeric(rows)
    columns = [list(column) for column in zip(*rows, strict=True)]
    widths = [max(map(cell_len, column)) for column in columns]
    words = [max((cell_len(word) for cell in column for word in cell.split(" ")), default=0) for column in columns]
    below = [max(map(cell_len, column[1:]), default=0) for column in columns]
    over = sum(widths) + 2 * (len(widths) - 1) - shutil.get_terminal_size((10_000, 0)).columns
    for least in (list(map(max, words, below)), words):
        for k in sorted(range(len(widths)), key=lambda k: least[k] - widths[k]):
            cut = max(min(over, widths[k] - least[k]), 0)
            widths[k], over = widths[k] - cut, over - cut

    def padded(cells: Sequence[str]) -> str:
        gaps = [" " * (width - cell_len(cell)) for cell, width in zip(cells, widths, strict=True)]
        pairs = enumerate(zip(gaps, cells, strict=True))
        return "  ".join(gap + cell if k in right else cell + gap for k, (gap, cell) in pairs).rstrip()

    lines: list[str] = []
    for row in rows:
        parts = zip(row, widths, strict=True)
        broken = [textwrap.wrap(cell, width) if cell_len(cell) > width else [cell] for cell, width in parts]
        lines += map(padded, zip_longest(*broken, fillvalue=""))
    return "\n".join(lines)


def markdown(rows: Rows) -> str:
    """A table of GitHub's Markdown."""
    written = [[MARKDOWN.sub(r"\\\1", " ".join(cell.split())) for cell in row] for row in rows]
    head, *lines = [f"| {' | '.join(row)} |" for row in written]
    right = _numeric(rows)
    rule = "".join("---:|" if index in right else "---|" for index in range(len(rows[0])))
    return "\n".join([head, f"|{rule}", *lines])


def latex(rows: Rows) -> str:
    """A ``tabular`` of LaTeX with the rules of booktabs."""
    right = _numeric(rows)
    columns = "".join("r" if index in right else "l" for index in range(len(rows[0])))

    def written(cell: str) -> str:
        text = "".join(LATEX.get(character, character) for character in " ".join(cell.split()))
        return LIGATURES.sub(r"\1{}", text).replace("+-", r"$\pm$")

    head, *lines = [f"{' & '.join(map(written, row))} \\\\" for row in rows]
    begin, end = f"\\begin{{tabular}}{{{columns}}}", "\\end{tabular}"
    return "\n".join(["% \\usepackage{booktabs}", begin, "\\toprule", head, "\\midrule", *lines, "\\bottomrule", end])


def comma_separated(rows: Sequence[Sequence[Any]]) -> str:
    """CSV as RFC 4180 has it, but for line feeds alone; cells may be numbers, and empty for None."""
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
BETWEEN = {"text": "{}", "markdown": "\n{}\n", "latex": "% {}", "csv": ""}
"""Lines between tables; CSV has none."""


def _numeric(rows: Rows) -> set[int]:
    return {k for k, (_, *cells) in enumerate(zip(*rows, strict=True)) if cells and all(map(NUMBER.fullmatch, cells))}
