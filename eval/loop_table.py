"""The ledger of a run's loops as ``loops.csv``, a row a candidate, and as counts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from math import isfinite
from os import PathLike
from pathlib import Path
from typing import get_args

import numpy as np

from moteslam.errors import InputError
from moteslam.robot.files import read_text, write_atomically
from moteslam.slam.backend.ledger import LoopCandidate, Verdict
from moteslam.slam.config import SlamConfig

COLUMNS = (
    *("earlier", "later", "earlier_stamp", "later_stamp"),
    *("predicted_x", "predicted_y", "predicted_theta", "found_x", "found_y", "found_theta"),
    *("window_distance", "window_angle", "share", "runner_up", "known", "likelihood", "crossed", "verdict"),
)
"""Of ``loops.csv``; what they mean: ``LoopCandidate``. Metres, radians and seconds."""

VERDICTS: tuple[Verdict, ...] = get_args(Verdict)

MAX_BYTES = 200_000_000
"""No table of loops is larger: some million candidates."""

MAX_DIGITS = 18
"""Of an index: what fits into 64 bits."""


def looks_for_loops(config: SlamConfig) -> bool:
    """Whether the back end of a run looks for loops: any but the null one, unless they are switched off."""
    loops = getattr(config.backend, "loops", None)
    return config.backend.method != "none" and getattr(loops, "enabled", True)


def loop_counts(loops: Sequence[LoopCandidate]) -> dict[str, int]:
    """How many candidates there are, and how many of each verdict, as they go into ``run.json``."""
    counts = Counter(loop.verdict for loop in loops)
    return {"candidates": len(loops), **{verdict: counts[verdict] for verdict in VERDICTS}}


def write_loops(path: str | PathLike[str], loops: Sequence[LoopCandidate]) -> None:
    """Write ``loops.csv``: a header and a row a candidate, numbers with the fewest digits that read back the same.

    Raises:
        OutputError: it cannot be written.
    """
    write_atomically(path, "\n".join([",".join(COLUMNS), *map(_row, loops)]) + "\n")


def read_loops(path: str | PathLike[str]) -> tuple[LoopCandidate, ...]:
    """Read ``loops.csv``.

    Raises:
        InputError: no text file of at most ``MAX_BYTES``, another header, or a row that is no candidate.
    """
    path = Path(path)
    header, *rows = read_text(path, "a table of loops", limit=MAX_BYTES).splitlines() or [""]
    if header.split(",") != list(COLUMNS):
        raise InputError(f"expected the columns {','.join(COLUMNS)}", file=path, line=1)
    return tuple(_candidate(row, path, line) for line, row in enumerate(rows, start=2))


def _row(loop: LoopCandidate) -> str:
    scores = (loop.share, loop.runner_up, loop.known, loop.likelihood, loop.crossed)
    numbers = (*loop.stamps, *loop.predicted, *loop.found, *loop.window, *scores)
    return ",".join([str(loop.earlier), str(loop.later), *(repr(float(number)) for number in numbers), loop.verdict])


def _candidate(row: str, path: Path, line: int) -> LoopCandidate:
    words = row.split(",")
    if len(words) != len(COLUMNS):
        raise InputError(f"{len(words)} columns, expected {len(COLUMNS)}", file=path, line=line)
    *texts, word = words
    verdict = next((known for known in VERDICTS if known == word), None)
    if verdict is None:
        raise InputError(f"{word!r}, expected one of {', '.join(VERDICTS)}", file=path, line=line, field="verdict")
    earlier, later = (_index(text, name, path, line) for name, text in zip(COLUMNS, texts[:2], strict=False))
    numbers = [_number(text, name, path, line) for name, text in zip(COLUMNS[2:-1], texts[2:], strict=True)]
    if earlier >= later:
        raise InputError(f"{later}, expected more than that of earlier, {earlier}", file=path, line=line, field="later")
    return LoopCandidate(
        earlier=earlier,
        later=later,
        stamps=(numbers[0], numbers[1]),
        predicted=np.array(numbers[2:5]),
        found=np.array(numbers[5:8]),
        window=(numbers[8], numbers[9]),
        share=numbers[10],
        runner_up=numbers[11],
        known=numbers[12],
        likelihood=numbers[13],
        crossed=numbers[14],
        verdict=verdict,
    )


def _index(text: str, field: str, path: Path, line: int) -> int:
    if not (text.isascii() and text.isdecimal() and len(text) <= MAX_DIGITS):
        raise InputError(f"{text!r}, expected the index of a scan", file=path, line=line, field=field)
    return int(text)


def _number(text: str, field: str, path: Path, line: int) -> float:
    with suppress(ValueError):
        if isfinite(number := float(text)):
            return number
    raise InputError(f"{text!r}, expected a finite number", file=path, line=line, field=field)
