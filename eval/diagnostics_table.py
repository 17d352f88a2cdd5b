"""What a run knows of itself at every scan, as ``diagnostics.csv``: how sure it is, and how the filter works."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.eval.metrics.localisation import state_counts
from moteslam.robot.files import read_text, write_atomically
from moteslam.robot.values import Summarised
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
COLUMNS = ("stamp", "state", *ELEMENTS, *VALUES)
"""Of ``diagnostics.csv``; what they mean: ``Estimate``. Metres, radians and seconds."""

MAX_BYTES = 1_000_000_000
"""No table of diagnostics is larger: some five million scans."""


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


def localisation_summary(estimate: Estimate) -> dict[str, Any]:
    """How many scans are in each state, and the stamp of the first that is lost [s], as they go into JSON."""
    states = estimate.diagnostics["state"]
    lost = np.flatnonzero(states == LocalisationState.LOST)
    first = float(estimate.trajectory.stamps[lost[0]]) if len(lost) else None
    return {"states": state_counts(states), "first_lost_stamp": first}


def write_diagnostics(path: str | PathLike[str], estimate: Estimate) -> None:
    """Write ``diagnostics.csv``: a header and a row a scan, numbers with the fewest digits that read back the same.

    Raises:
        OutputError: it cannot be written.
    """
    names = [LocalisationState(int(state)).name.lower() for state in estimate.diagnostics["state"]]
    numbers = [estimate.covariances[:, i, j] for i, j in ELEMENTS.values()]
    numbers += [estimate.diagnostics[name] for name in VALUES]
    rows = zip(estimate.trajectory.stamps.tolist(), names, np.column_stack(numbers).tolist(), strict=True)
    lines = [f"{stamp!r},{name},{','.join(map(_shown, row))}" for stamp, name, row in rows]
    write_atomically(path, "\n".join([",".join(COLUMNS), *lines]) + "\n")


def read_diagnostics(path: str | PathLike[str]) -> Diagnostics:
    """Read ``diagnostics.csv``.

    Raises:
        InputError: no text file of at most ``MAX_BYTES``, another header, or a row that is none.
    """
    path = Path(path)
    header, *rows = read_text(path, "a table of diagnostics", limit=MAX_BYTES).splitlines() or [""]
    if header.split(",") != list(COLUMNS):
        raise InputError(f"expected the columns {','.join(COLUMNS)}", file=path, line=1)
    table = np.array([_numbers(row, path, line) for line, row in enumerate(rows, start=2)]).reshape(-1, len(COLUMNS))
    columns = dict(zip(COLUMNS, table.T, strict=True))
    covariances = np.empty((len(table), 3, 3))
    for name, (i, j) in ELEMENTS.items():
        covariances[:, i, j] = covariances[:, j, i] = columns[name]
    return Diagnostics(columns["stamp"], covariances, {name: columns[name] for name in ("state", *VALUES)})


def _shown(number: float) -> str:
    """A whole number without a point, any other with the fewest digits that read back the same."""
    return str(int(number)) if number.is_integer() else repr(number)


def _numbers(row: str, path: Path, line: int) -> list[float]:
    words = row.split(",")
    if len(words) != len(COLUMNS):
        raise InputError(f"{len(words)} columns, expected {len(COLUMNS)}", file=path, line=line)
    stamp, name, *texts = words
    if name not in (known := [state.name.lower() for state in LocalisationState]):
        raise InputError(f"{name!r}, expected one of {', '.join(known)}", file=path, line=line, field="state")
    try:
        numbers = [float(stamp), float(known.index(name)), *map(float, texts)]
    except ValueError:
        raise InputError("expected numbers in all columns but the state", file=path, line=line) from None
    if not np.isfinite(np.delete(numbers, COLUMNS.index("degenerate"))).all():
        raise InputError("expected finite numbers, nan for degenerate alone", file=path, line=line)
    return numbers
