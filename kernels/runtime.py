"""Taichi, quiet and offline, initialised once a process; with `launch.py` the one seam to it.

Every kernel file imports ``ti`` from here. Importing this module imports Taichi (0.2 s): modules that must load at once
import it inside functions.
"""

from __future__ import annotations

import contextlib
import io
import os
import tempfile
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from moteslam.errors import BackendError


@contextlib.contextmanager
def _environment(**values: str) -> Iterator[None]:
    """Environment variables while Taichi reads them, which aborts without HOME; afterwards they are as before."""
    before = dict(os.environ)
    os.environ.update(values, HOME=before.get("HOME") or os.sep)
    os.environ.pop("TI_ARCH", None)  # it would overrule the arch that is asked for
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


with _environment(ENABLE_TAICHI_HEADER_PRINT="0"), warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import taichi as ti

__all__ = ["ARCHES", "Runtime", "init", "one_thread", "passes_for", "runtime", "ti"]

ARCHES = ("cpu", "cuda")
BATCH, BATCHES = 512, 8
"""Taichi hands out so many passes of a loop at a time, whatever ``block_dim`` says. A loop is made long enough for so
many of these a thread: where one takes longer, others are left for the threads that are free."""
STALE = 60.0
"""Taichi locks its cache for moments: an older lock [s] is that of a killed process."""


@dataclass(frozen=True)
class Runtime:
    """What Taichi was initialised with: backend, threads (of the CPU backend), bounds checks, cache folder."""

    arch: str
    threads: int
    debug: bool
    cache: Path | None


_runtime: Runtime | None = None


def runtime() -> Runtime:
    """The runtime of this process, initialised with the defaults if it was not yet."""
    return _runtime if _runtime is not None else init()


def one_thread() -> bool:
    """Whether loops run on one thread of a processor: ``ti.loop_config(serialize=ti.static(one_thread()))``.

    With this line before an outermost loop it runs in the thread that launches it. Else Taichi would wake its one
    worker, which costs 60 us of processor time and twice as much to wait for (docs/results.md).
    """
    current = runtime()
    return current.arch == "cpu" and current.threads == 1


def passes_for(work: int) -> int:
    """How many passes of a loop there are for each piece of work of some microseconds, so that all threads have some.

    Such a loop begins ``for k in range(work * passes): if k % passes: continue`` and works on piece ``k // passes``. An
    empty pass takes a nanosecond.
    """
    current = runtime()
    if one_thread() or current.arch != "cpu" or not work:
        return 1
    return min(BATCH, -(-BATCH * BATCHES * current.threads // work))


def init(arch: str = "cpu", threads: int | None = None, *, debug: bool = False) -> Runtime:
    """Initialise Taichi for this process; a second call with the same settings does nothing.

    Args:
        arch: ``cpu`` or ``cuda``.
        threads: of the CPU backend; by default one for each processor that this process may use.
    """
    global _runtime  # noqa: PLW0603 - there is one Taichi in a process
    if arch not in ARCHES:
        raise BackendError(f"{arch!r}, expected one of {', '.join(ARCHES)}", field="arch")
    if threads is not None and not 1 <= threads <= 1024:
        raise BackendError(f"{threads}, expected 1 to 1024", field="threads")
    processors = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    threads = threads or (_runtime.threads if _runtime else len(processors) or os.cpu_count() or 1)
    if _runtime is not None:
        if (_runtime.arch, _runtime.threads, _runtime.debug) != (arch, threads, debug):
            wanted = Runtime(arch, threads, debug, _runtime.cache)
            raise BackendError(f"Taichi runs with {_runtime} in this process, not {wanted}: start a new one")
        return _runtime
    cache, before = _cache_folder(), _thread_ids()
    try:
        # no query of the newest version over the network; "[Taichi] Starting on arch=" is a bare print
        with _environment(TI_SKIP_VERSION_CHECK="ON"), contextlib.redirect_stdout(io.StringIO()):
            ti.init(
                arch=ti.cuda if arch == "cuda" else ti.cpu,
                cpu_max_num_threads=threads,
                debug=debug,
                fast_math=False,  # the same bits whatever the vectoriser does; integer kernels lose nothing
                default_fp=ti.f32,
                default_ip=ti.i32,
                log_level=ti.ERROR,
                offline_cache=cache is not None and not debug,
                # without a cache Taichi looks into this folder at exit, too, and crashes if it does not exist
                offline_cache_file_path=str(cache or os.sep),
                enable_fallback=False,
            )
    except Exception as error:  # Taichi raises bare RuntimeErrors of several kinds here
        raise BackendError(f"Taichi cannot start on {arch}: {str(error).splitlines()[0]}", field="arch") from error
    if 1 < threads == len(processors):
        _pin([thread for thread in _thread_ids() if thread not in before], processors)
    _runtime = Runtime(arch, threads, debug, cache)
    return _runtime


def _thread_ids() -> list[int]:
    """The threads of this process in the order they were made; empty on other systems than Linux."""
    try:
        return [int(name) for name in os.listdir("/proc/self/task")]  # noqa: PTH208 - in the system's order
    except OSError:
        return []


def _pin(threads: list[int], processors: list[int]) -> None:
    """Pin each of Taichi's threads to a processor of its own, in turns, where there are as many as processors.

    Linux prefers to wake a thread on the processor of its waker, where they queue for some 4 ms: kernels shorter than
    that would gain nothing from a second thread (measured: docs/results.md). Fewer threads than processors stay free,
    since several programs that pinned theirs would share the first few processors.
    """
    for index, thread in enumerate(threads):
        with contextlib.suppress(OSError):  # the thread has ended, or the system refuses
            os.sched_setaffinity(thread, {processors[index % len(processors)]})


def _cache_folder() -> Path | None:
    """The user's own folder for compiled kernels (mode 0700), or None if it cannot be created."""
    try:
        shared = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        root = Path(os.environ.get("MOTESLAM_CACHE") or Path(shared) / "moteslam")
        folder = root / f"taichi-{'.'.join(map(str, ti.__version__))}"
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if hasattr(os, "getuid") and folder.stat().st_uid != os.getuid():
            return None  # another user's folder could hold another user's code
        folder.chmod(0o700)
        for lock in folder.rglob("ticache.lock"):  # while it is there, nothing is cached
            if time.time() - lock.stat().st_mtime > STALE:
                lock.unlink(missing_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except (OSError, RuntimeError):  # RuntimeError: there is no home folder
        return None
