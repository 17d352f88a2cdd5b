"""Runs side by side, each in a process of a pool."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from parts.machine import save, stamp

Row = dict[str, Any]


def row_or_error(about: Row, measure: Callable[..., Row], *arguments: Any) -> Row:
    """A row of what is measured; of the ``error``, if that crashes: a result, too, and no reason to lose other rows.

    Args:
        about: which run it is, the beginning of the row.
        measure: gives the figures.
        arguments: of the call.
    """
    try:
        return {**about, **measure(*arguments)}
    except Exception as error:
        return {**about, "error": f"{type(error).__name__}: {error}"}


def rows_of(
    run: Callable[..., Row], calls: Iterable[tuple[Any, ...]], workers: int, *, shown: Callable[[Row], Row] = dict
) -> Iterator[Row]:
    """The rows that a function of a module returns, printed as they come, in the order of the calls.

    Args:
        run: what is called.
        calls: the arguments of each call.
        workers: processes at a time; spawned, since Taichi cannot fork.
        shown: gives what is printed of a row.
    """
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        for job in [pool.submit(run, *call) for call in calls]:
            row = job.result()
            print(
                *(f"{k} {v:.4f}" if isinstance(v, float) else f"{k} {v}" for k, v in shown(row).items()),
                sep="  ",
                flush=True,
            )
            yield row


def study(
    run: Callable[..., Row],
    calls: Iterable[tuple[Any, ...]],
    workers: int,
    out: Path | None,
    *,
    summarised: Callable[[list[Row]], Any],
    printed: Callable[[Any], str],
) -> list[Row]:
    """Run all calls, save rows and summary after each of them, print the summary, and return the rows.

    Args:
        run, calls, workers: as of ``rows_of``.
        out: the result file; None for none.
        summarised: gives the summary of rows.
        printed: gives its text.
    """
    rows: list[Row] = []
    for row in rows_of(run, calls, workers):
        rows.append(row)
        save(out, {**stamp(), "summary": summarised(rows), "rows": rows})
    print()
    print(printed(summarised(rows)))
    return rows
