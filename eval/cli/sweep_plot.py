"""What ``moteslam sweep plot`` draws."""

from __future__ import annotations

from math import inf, isfinite
from pathlib import Path

from moteslam.errors import ConfigError, InputError
from moteslam.eval.cli.sweep_file import spec_of


def plot_sweep(
    file: Path, out: Path, metrics: list[str], along: str | None, *, label: str | None = None, title: str = ""
) -> None:
    """Draw the metrics of a sweep over one of its columns.

    Args:
        file: of the sweep.
        out: the PNG.
        metrics: names.
        along: the column; None for the first key that varies.
        label: of that axis.
        title: over the figure.

    Raises:
        ConfigError: the sweep has no such column, or none is named and no key varies; the columns are listed.
        InputError: no run was made yet, or none has one of the metrics.
    """
    from moteslam.eval.report.sweep_curves import draw_sweep
    from moteslam.eval.sweep.store import opened
    from moteslam.eval.sweep.tables import summaries, varying
    from moteslam.robot.files import folder_for

    with opened(file) as store:
        spec = spec_of(store)
        found = summaries(store.rows(), metrics, dict(spec.success))
    if not found:
        raise InputError("no run was made yet, expected some", file=file)
    known = varying(found)
    column = along or next(iter(spec.vary), None)
    if column not in known:
        problem = "needed where no key varies" if column is None else f"{column!r}"
        raise ConfigError(f"{problem}, expected one of {', '.join(known)}", field="--x")
    for name in metrics:
        best = [group.values[name].best for group in found]
        if not any(isfinite(inf if value is None else value) for value in best):
            raise InputError(f"no run that ended well has {name}, expected a metric of the sweep", file=file)
    with folder_for(out):
        draw_sweep(out, found, metrics, column=column, label=label, title=title)
