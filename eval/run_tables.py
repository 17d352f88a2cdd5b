"""The tables of a run: ``diagnostics.csv`` a row a scan, ``loops.csv`` a row a candidate, and ``particles.npz``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import isfinite, isnan
from os import PathLike
from pathlib import Path
from typing import IO, get_args

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.files import Shape, read_arrays, read_text, write_atomically
from moteslam.robot.values import Summarised
from moteslam.slam.backend.ledger import LoopCandidate, Verdict
from moteslam.slam.estimate import Estimate
from moteslam.slam.filter.certainty import LocalisationState

ELEMENTS = {
    "var_x": (0, 0),
    "var_y": (1, 1),
    "var_theta": (2, 2),
    "cov_xy": (0, 1),
    "cov_x_theta": (0, 2),
    "cov_y_theta": (1, 2),
}
"""Columns of the covariance, and the element of each."""
VALUES = ("degenerate", "wrong", "particles", "n_eff", "score", "updated", "resampled", "corrected")
"""Columns that are diagnostics of the estimate; its seconds are not, since they differ from run to run."""
DIAGNOSTICS_COLUMNS = ("stamp", "state", *ELEMENTS, *VALUES)
"""Of ``diagnostics.csv``; what they mean: ``Estimate``. Metres, radians and seconds."""
LOOP_COLUMNS = (
    *("earlier", "later", "earlier_stamp", "later_stamp"),
    *("predicted_x", "predicted_y", "predicted_theta", "found_x", "found_y", "found_theta"),
    *("window_distance", "window_angle", "share", "runner_up", "known", "likelihood", "crossed", "verdict"),
)
"""Of ``loops.csv``; what they mean: ``LoopCandidate``. Metres, radians and seconds."""
PARTICLE_SHAPES: dict[str, Shape] = {
    "stamps": ("updates",),
    "paths": ("particles", "updates", 3),
    "spread": ("updates", 3),
}
"""Of the arrays of ``particles.npz``; what they mean: ``Estimate``. Metres, radians and seconds."""

STATES = tuple(state.name.lower() for state in LocalisationState)
VERDICTS: tuple[Verdict, ...] = get_args(Verdict)
MAX_BYTES = 1_000_000_000
"""No table is larger: some five million rows."""
MAX_DIGITS = 18
"""Of the index of a scan: what fits into 64 bits."""


@dataclass(frozen=True, eq=False, repr=False)
class Diagnostics(Summarised):
    """What ``diagnostics.csv`` holds.

    Attributes:
        stamps: [n] of the scans [s].
        covariances: [n, 3, 3] of the online poses.
        values: [n] by name: ``state`` as of ``LocalisationState``, and ``VALUES``, as in ``Estimate.diagnostics``.
    """

    stamps: NDArray[np.float64]
    covariances: NDArray[np.float64]
    values: dict[str, NDArray[np.float64]]


@dataclass(frozen=True, eq=False, repr=False)
class Particles(Summarised):
    """What ``particles.npz`` holds.

    Attributes:
        stamps: [u] float64, of the updates of the filter [s].
        paths: [K, u, 3] float32, paths that end in the particles of the last update.
        spread: [u, 3] float32, standard deviation of all particles after every update: along and across their mean
            heading [m], and of the heading [rad].
    """

    stamps: NDArray[np.float64]
    paths: NDArray[np.float32]
    spread: NDArray[np.float32]


def write_diagnostics(path: str | PathLike[str], estimate: Estimate) -> None:
    """Write ``diagnostics.csv``: numbers with the fewest digits that read back the same.

    Raises:
        OutputError: it cannot be written.
    """
    states = [STATES[int(state)] for state in estimate.diagnostics["state"]]
    numbers = [estimate.covariances[:, i, j] for i, j in ELEMENTS.values()]
    numbers += [estimate.diagnostics[name] for name in VALUES]
    rows = zip(estimate.trajectory.stamps.tolist(), states, np.column_stack(numbers).tolist(), strict=True)
    _write(path, DIAGNOSTICS_COLUMNS, ([repr(stamp), state, *map(_shown, row)] for stamp, state, row in rows))


def read_diagnostics(path: str | PathLike[str]) -> Diagnostics:
    """Read ``diagnostics.csv``.

    Raises:
        InputError: another header, or a row that does not fit it.
    """
    rows = []
    for row in _read(Path(path), DIAGNOSTICS_COLUMNS, "a table of diagnostics"):
        values = {name: row.number(name, nan=name == "degenerate") for name in ("stamp", *ELEMENTS, *VALUES)}
        rows.append([values["stamp"], row.choice("state", STATES), *(values[name] for name in (*ELEMENTS, *VALUES))])
    table = np.array(rows, np.float64).reshape(-1, len(DIAGNOSTICS_COLUMNS))
    columns = dict(zip(DIAGNOSTICS_COLUMNS, table.T, strict=True))
    covariances = np.empty((len(table), 3, 3))
    for name, (i, j) in ELEMENTS.items():
        covariances[:, i, j] = covariances[:, j, i] = columns[name]
    return Diagnostics(columns["stamp"], covariances, {name: columns[name] for name in ("state", *VALUES)})


def loop_counts(loops: Sequence[LoopCandidate]) -> dict[str, int]:
    """How many candidates there are, and how many of each verdict."""
    counts = Counter(loop.verdict for loop in loops)
    return {"candidates": len(loops), **{verdict: counts[verdict] for verdict in VERDICTS}}


def write_loops(path: str | PathLike[str], loops: Sequence[LoopCandidate]) -> None:
    """Write ``loops.csv``: numbers with the fewest digits that read back the same.

    Raises:
        OutputError: it cannot be written.
    """
    rows = []
    for loop in loops:
        scores = (loop.share, loop.runner_up, loop.known, loop.likelihood, loop.crossed)
        numbers = (*loop.stamps, *loop.predicted, *loop.found, *loop.window, *scores)
        rows.append([str(loop.earlier), str(loop.later), *(repr(float(one)) for one in numbers), loop.verdict])
    _write(path, LOOP_COLUMNS, rows)


def read_loops(path: str | PathLike[str]) -> tuple[LoopCandidate, ...]:
    """Read ``loops.csv``.

    Raises:
        InputError: another header, or a row that is no candidate.
    """
    return tuple(_candidate(row) for row in _read(Path(path), LOOP_COLUMNS, "a table of loops"))


def _candidate(row: _Row) -> LoopCandidate:
    earlier, later = row.index("earlier"), row.index("later")
    if earlier >= later:
        raise row.error(f"{later}, expected more than that of earlier, {earlier}", "later")
    numbers = [row.number(name) for name in LOOP_COLUMNS[2:-1]]
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
        verdict=VERDICTS[row.choice("verdict", VERDICTS)],
    )


def write_particles(path: str | PathLike[str], estimate: Estimate) -> None:
    """Write ``particles.npz``; the same run writes the same bytes.

    Raises:
        OutputError: it cannot be written.
    """
    stamps, paths, spread = estimate.particle_stamps, estimate.particle_paths, estimate.particle_spread

    def write(file: IO[bytes]) -> None:
        np.savez_compressed(file, stamps=stamps, paths=paths.astype(np.float32), spread=spread.astype(np.float32))

    write_atomically(path, write)


def read_particles(path: str | PathLike[str]) -> Particles:
    """Read ``particles.npz``.

    Raises:
        InputError: no archive of these arrays, or one with values that are not finite.
    """
    path = Path(path)
    arrays = read_arrays(path, PARTICLE_SHAPES)
    for name, values in arrays.items():
        if not np.isfinite(values).all():
            raise InputError("expected finite numbers", file=path, field=name)
    stamps = arrays["stamps"].astype(np.float64)
    if (np.diff(stamps) < 0).any():
        raise InputError("stamps go back, expected rising seconds", file=path, field="stamps")
    return Particles(stamps, arrays["paths"].astype(np.float32), arrays["spread"].astype(np.float32))


@dataclass(frozen=True)
class _Row:
    """A row of a table, its texts by column."""

    file: Path
    line: int
    texts: dict[str, str]

    def error(self, problem: str, field: str) -> InputError:
        return InputError(problem, file=self.file, line=self.line, field=field)

    def number(self, column: str, *, nan: bool = False) -> float:
        try:
            number = float(self.texts[column])
        except ValueError:
            number = float("inf")
        if isfinite(number) or (nan and isnan(number)):
            return number
        raise self.error(f"{self.texts[column]!r}, expected a finite number", column)

    def index(self, column: str) -> int:
        text = self.texts[column]
        if not (text.isascii() and text.isdecimal() and len(text) <= MAX_DIGITS):
            raise self.error(f"{text!r}, expected the index of a scan", column)
        return int(text)

    def choice(self, column: str, known: Sequence[str]) -> int:
        """The place of the text among the known ones."""
        if self.texts[column] not in known:
            raise self.error(f"{self.texts[column]!r}, expected one of {', '.join(known)}", column)
        return known.index(self.texts[column])


def _read(path: Path, columns: Sequence[str], what: str) -> Iterator[_Row]:
    header, *lines = read_text(path, what, limit=MAX_BYTES).splitlines() or [""]
    if header != ",".join(columns):
        raise InputError(f"expected the columns {','.join(columns)}", file=path, line=1)
    for number, line in enumerate(lines, start=2):
        words = line.split(",")
        if len(words) != len(columns):
            raise InputError(f"{len(words)} columns, expected {len(columns)}", file=path, line=number)
        yield _Row(path, number, dict(zip(columns, words, strict=True)))


def _write(path: str | PathLike[str], columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    write_atomically(path, "\n".join(map(",".join, [columns, *rows])) + "\n")


def _shown(number: float) -> str:
    """A whole number without a point, any other with the fewest digits that read back the same."""
    return str(int(number)) if number.is_integer() else repr(number)
