"""The tables of a run: ``diagnostics.csv`` a row a scan, ``loops.csv`` a row a candidate, and ``particles.npz``.

Numbers are written with the fewest digits that read back the same.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, isnan
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import File, InputError
from moteslam.eval.tables import comma_separated
from moteslam.files import Shape, read_arrays, read_text, write_atomically
from moteslam.robot.values import Summarised
from moteslam.slam.backend.protocol import LoopCandidate, Verdict
from moteslam.slam.estimate import Estimate
from moteslam.slam.filter.certainty import LocalisationState

STATES = tuple(state.name.lower() for state in LocalisationState)
VERDICTS: tuple[Verdict, ...] = get_args(Verdict)
MAX_BYTES = 1_000_000_000  # No table is larger: some five million rows
MAX_DIGITS = 18  # Of the index of a scan: what fits into 64 bits

Kind = Literal["number", "number or nan", "index"] | tuple[str, ...]
"""Of a column: its numbers, or the names of which it holds one, read as its place among them."""

ELEMENTS = {"var_x": (0, 0), "var_y": (1, 1), "var_theta": (2, 2)}
ELEMENTS |= {"cov_xy": (0, 1), "cov_x_theta": (0, 2), "cov_y_theta": (1, 2)}
"""Columns of the covariance, and the element of each."""
VALUES = ("degenerate", "wrong", "particles", "n_eff", "score", "updated", "resampled", "corrected")
"""Columns that are diagnostics of the estimate; its seconds are not, since they differ from run to run."""
DIAGNOSTICS_COLUMNS: dict[str, Kind] = {
    "stamp": "number",
    "state": STATES,
    **dict.fromkeys((*ELEMENTS, *VALUES), "number"),
    "degenerate": "number or nan",
}
"""Of ``diagnostics.csv``; what they mean: ``Estimate``. Metres, radians and seconds."""
AXES = ("x", "y", "theta")
SCORES = ("share", "runner_up", "known", "likelihood", "crossed")
"""Columns of a loop that are fields of ``LoopCandidate`` by their names."""
PAIR = ("earlier_stamp", "later_stamp", *(f"{pose}_{axis}" for pose in ("predicted", "found") for axis in AXES))
LOOP_COLUMNS: dict[str, Kind] = {
    **dict.fromkeys(("earlier", "later"), "index"),
    **dict.fromkeys((*PAIR, "window_distance", "window_angle", *SCORES), "number"),
    "verdict": VERDICTS,
}
"""Of ``loops.csv``; what they mean: ``LoopCandidate``. Metres, radians and seconds."""
PARTICLE_SHAPES: dict[str, Shape] = {
    "stamps": ("updates",),
    "paths": ("particles", "updates", 3),
    "spread": ("updates", 3),
}
"""Of the arrays of ``particles.npz``: of the updates of the filter the stamps [s], paths that end in the particles of
the last one, and the standard deviation of all particles after each, along and across their mean heading [m], and of
the heading [rad].
"""


@dataclass(frozen=True, eq=False, repr=False)
class Diagnostics(Summarised):
    """What ``diagnostics.csv`` holds: of the scans the stamps [n] [s], covariances [n, 3, 3] of the online poses, and
    values [n] by name: ``state`` as of ``LocalisationState``, and ``VALUES``, as in ``Estimate.diagnostics``.
    """

    stamps: NDArray[np.float64]
    covariances: NDArray[np.float64]
    values: dict[str, NDArray[np.float64]]


def write_diagnostics(path: Path, estimate: Estimate) -> None:
    """``diagnostics.csv``."""
    states = [STATES[int(state)] for state in estimate.diagnostics["state"]]
    numbers = [estimate.covariances[:, i, j] for i, j in ELEMENTS.values()]
    numbers += [estimate.diagnostics[name] for name in VALUES]
    rows = zip(estimate.trajectory.stamps.tolist(), states, np.column_stack(numbers), strict=True)
    cells = ([stamp, state, *map(_shown, row.tolist())] for stamp, state, row in rows)
    write_atomically(path, comma_separated([[*DIAGNOSTICS_COLUMNS], *cells]) + "\n")


def read_diagnostics(path: File) -> Diagnostics:
    """Read ``diagnostics.csv``; an ``InputError`` names the line and the column that is broken."""
    rows = [row for _, row in _read(Path(path), DIAGNOSTICS_COLUMNS, "a table of diagnostics")]
    columns = {name: np.array([row[name] for row in rows], np.float64) for name in DIAGNOSTICS_COLUMNS}
    covariances = np.empty((len(rows), 3, 3))
    for name, (i, j) in ELEMENTS.items():
        covariances[:, i, j] = covariances[:, j, i] = columns[name]
    return Diagnostics(columns["stamp"], covariances, {name: columns[name] for name in ("state", *VALUES)})


def loop_counts(loops: Sequence[LoopCandidate]) -> dict[str, int]:
    """How many candidates there are, and how many of each verdict."""
    counts = Counter(loop.verdict for loop in loops)
    return {"candidates": len(loops), **{verdict: counts[verdict] for verdict in VERDICTS}}


def write_loops(path: File, loops: Sequence[LoopCandidate]) -> None:
    """Write ``loops.csv``."""
    rows: list[list[Any]] = [[*LOOP_COLUMNS]]
    for loop in loops:
        numbers = (*loop.stamps, *loop.predicted, *loop.found, *loop.window, *(getattr(loop, name) for name in SCORES))
        rows.append([loop.earlier, loop.later, *map(float, numbers), loop.verdict])
    write_atomically(path, comma_separated(rows) + "\n")


def read_loops(path: File) -> tuple[LoopCandidate, ...]:
    """Read ``loops.csv``; an ``InputError`` names the line and the column that is broken."""
    loops = []
    for line, row in _read(Path(path), LOOP_COLUMNS, "a table of loops"):
        earlier, later = row["earlier"], row["later"]
        if earlier >= later:
            problem = f"{later}, expected more than that of earlier, {earlier}"
            raise InputError(problem, file=path, line=line, field="later")
        predicted, found = (np.array([row[f"{pose}_{axis}"] for axis in AXES]) for pose in ("predicted", "found"))
        stamps, window = (row["earlier_stamp"], row["later_stamp"]), (row["window_distance"], row["window_angle"])
        scores = {name: row[name] for name in SCORES}
        verdict = VERDICTS[row["verdict"]]
        loops.append(LoopCandidate(earlier, later, stamps, predicted, found, window, **scores, verdict=verdict))
    return tuple(loops)


def read_particles(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """The stamps and paths of ``particles.npz``; an ``InputError`` names the array that is broken."""
    arrays = read_arrays(path, PARTICLE_SHAPES)
    for name, values in arrays.items():
        if not np.isfinite(values).all():
            raise InputError("expected finite numbers", file=path, field=name)
    stamps = arrays["stamps"].astype(np.float64)
    if (np.diff(stamps) < 0).any():
        raise InputError("stamps go back, expected rising seconds", file=path, field="stamps")
    return stamps, arrays["paths"].astype(np.float32)


def _read(path: Path, columns: Mapping[str, Kind], what: str) -> Iterator[tuple[int, dict[str, Any]]]:
    header, *lines = read_text(path, what, limit=MAX_BYTES).splitlines() or [""]
    if header != ",".join(columns):
        raise InputError(f"expected the columns {','.join(columns)}", file=path, line=1)
    for line, text in enumerate(lines, start=2):
        words = text.split(",")
        if len(words) != len(columns):
            raise InputError(f"{len(words)} columns, expected {len(columns)}", file=path, line=line)
        row = {}
        for (name, kind), word in zip(columns.items(), words, strict=True):
            row[name] = _value(word, kind)
            if row[name] is None:
                expected = f"one of {', '.join(kind)}" if isinstance(kind, tuple) else f"a finite {kind}"
                raise InputError(f"{word!r}, expected {expected}", file=path, line=line, field=name)
        yield line, row


def _value(word: str, kind: Kind) -> float | None:
    if isinstance(kind, tuple):
        return kind.index(word) if word in kind else None
    if kind == "index":
        return int(word) if word.isascii() and word.isdecimal() and len(word) <= MAX_DIGITS else None
    try:
        value = float(word)
    except ValueError:
        return None
    return value if isfinite(value) or (kind == "number or nan" and isnan(value)) else None


def _shown(number: float) -> float:
    """A whole number without a point."""
    return int(number) if number.is_integer() else number
