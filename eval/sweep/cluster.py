"""The runs of a sweep on an existing Dask cluster (extra ``cluster``); each in a process of its own there."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from moteslam.errors import BackendError
from moteslam.eval.sweep.plan import PlannedRun
from moteslam.eval.sweep.workers import Outcome, make_all

CONNECT = 20
"""A scheduler that does not answer within this time is not there [s]."""


def make_all_on(address: str, runs: Iterable[PlannedRun], *, timeout: float, timed: bool = False) -> Iterator[Outcome]:
    """As ``make_all``, on the workers of a cluster, which need moteslam and the recordings under the same paths.

    A run is made in a new process, since Taichi wants the main thread and a run may die. Where a worker of the cluster
    dies the scheduler gives its runs to another one; a run with which several workers died has crashed.

    Args:
        address: of the scheduler, ``tcp://host:8786``.
        runs: to make.
        timeout: of a run [s].
        timed: measure time and memory.

    Raises:
        BackendError: Dask is not installed, or the scheduler does not answer.
    """
    try:
        from distributed import Client, as_completed
    except ImportError as error:
        raise BackendError(
            "needs Dask, expected it installed: pip install 'moteslam[cluster]'", field="--scheduler"
        ) from error
    try:
        client = Client(address, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError) as error:
        raise BackendError(f"no scheduler answers at {address}", field="--scheduler") from error
    with client:
        futures = {
            client.submit(_made, run.as_dict(), timeout, timed=timed, key=f"moteslam-{run.id}", pure=False): run
            for run in runs
        }
        try:
            for future in as_completed(list(futures), loop=client.loop):
                run, failure = futures[future], future.exception()
                if failure is None:
                    yield Outcome(run, **future.result())
                else:  # the workers that had it died
                    yield Outcome(run, "crashed", f"{type(failure).__name__}: {failure}".splitlines()[0])
        finally:
            client.cancel(list(futures))


def _made(run: dict[str, Any], timeout: float, *, timed: bool) -> dict[str, Any]:
    """On a worker of the cluster: make one run."""
    (outcome,) = make_all([PlannedRun.of(run)], workers=1, timeout=timeout, timed=timed)
    return {name: getattr(outcome, name) for name in ("status", "error", "result", "seconds")}
