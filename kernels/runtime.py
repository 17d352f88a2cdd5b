"""The one seam to Taichi: quiet, offline, initialised once a process.

Every kernel file imports ``ti`` from here, so that another implementation of Taichi is a change of one line.
Importing this module imports Taichi (0.2 s): modules that must load at once import it inside functions.
"""

from __future__ import annotations

import contextlib
import io
import os
import struct
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from moteslam.errors import BackendError


@contextlib.contextmanager
def _environment(**values: str | None) -> Iterator[None]:
    """Environment variables set, or unset where None, while Taichi reads them; afterwards they are as before."""
    before = {name: os.environ.get(name) for name in values}
    _set(values)
    try:
        yield
    finally:
        _set(before)


def _set(values: Mapping[str, str | None]) -> None:
    for name, value in values.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value


def _home() -> str:
    """A home folder for Taichi, which aborts the process without one; nothing is put there."""
    return os.environ.get("HOME") or os.sep


with _environment(HOME=_home(), ENABLE_TAICHI_HEADER_PRINT="0"), warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import taichi as ti

__all__ = ["ARCHES", "Runtime", "init", "one_thread", "passes_for", "runtime", "ti"]

ARCHES = ("cpu", "cuda")
BATCH = 512
"""Taichi hands out this many passes of a loop at a time, whatever ``block_dim`` says: one of fewer has one thread."""
BATCHES = 8
"""A loop is made long enough for this many a thread: where one piece of work takes longer, others are left for those
that are free."""
RECENT = 5.0
"""What another process left in the cache longer ago than this [s] is no longer being written."""


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

    Every outermost loop of a kernel is preceded by this line, which Taichi evaluates when it compiles the kernel. With
    one thread the loop then runs in the thread that launches it. Otherwise Taichi would wake its one worker and wait
    for it, which costs 60 us of processor time and twice as much to wait for (docs/results.md).
    """
    current = runtime()
    return current.arch == "cpu" and current.threads == 1


def passes_for(work: int) -> int:
    """How many passes of a loop there are to be for each piece of work, so that all threads have some of it to do.

    A kernel of which one pass takes long, as registering a scan to a particle's map does, begins ``for k in range(work
    * passes): if k % passes: continue`` and works on piece ``k // passes``. An empty pass takes a nanosecond.

    Args:
        work: pieces of work, each of some microseconds or more.
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
        debug: bounds checks in every kernel (slow), for tests.

    Raises:
        BackendError: the backend is missing, a setting is out of bounds, or Taichi already runs with other settings
            (a second initialisation would leave every array of the first dangling).
    """
    global _runtime  # noqa: PLW0603 - there is one Taichi in a process
    if arch not in ARCHES:
        raise BackendError(f"backend {arch!r}, expected one of {', '.join(ARCHES)}", field="arch")
    allowed = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    available = len(allowed) or os.cpu_count() or 1
    if threads is not None and not 1 <= threads <= 1024:
        raise BackendError(f"{threads} threads, expected 1 to 1024", field="threads")
    wanted = (arch, threads or (_runtime.threads if _runtime else available), debug)
    if _runtime is not None:
        if (_runtime.arch, _runtime.threads, _runtime.debug) != wanted:
            raise BackendError(
                f"Taichi runs on {_runtime.arch} with {_runtime.threads} threads"
                f"{' and bounds checks' if _runtime.debug else ''} in this process, "
                f"expected the same settings again, not {wanted[0]} with {wanted[1]} threads"
                f"{' and bounds checks' if debug else ''}; start a new process"
            )
        return _runtime
    if arch == "cuda" and not _cuda_present():
        raise BackendError("no NVIDIA driver (libcuda) on this machine, expected a CUDA device", field="arch")
    cache = _cache_folder()
    if cache is not None:
        _remove_stale_lock(cache)
        _empty_if_truncated(cache)
    before = _threads()
    # no query of the newest version over the network; and TI_ARCH would overrule the arch that is asked for here
    environment = _environment(HOME=_home(), TI_SKIP_VERSION_CHECK="ON", TI_ARCH=None)
    try:
        with environment, contextlib.redirect_stdout(io.StringIO()):  # "[Taichi] Starting on arch=" is a bare print
            ti.init(
                arch=ti.cuda if arch == "cuda" else ti.cpu,
                cpu_max_num_threads=wanted[1],
                debug=debug,
                fast_math=False,  # the same bits whatever the vectoriser does; integer kernels lose nothing
                default_fp=ti.f32,
                default_ip=ti.i32,
                log_level=ti.ERROR,
                offline_cache=cache is not None and not debug,
                # without a cache Taichi still looks into this folder at exit, and crashes if it does not exist: the
                # root exists everywhere, and no other user can put files into it
                offline_cache_file_path=str(cache or os.sep),
                enable_fallback=False,
            )
    except Exception as error:  # Taichi raises bare RuntimeErrors of several kinds here
        raise BackendError(f"Taichi cannot start on {arch}: {str(error).splitlines()[0]}", field="arch") from error
    if 1 < wanted[1] == len(allowed):
        _pin([thread for thread in _threads() if thread not in before], allowed)
    _runtime = Runtime(arch, wanted[1], debug, cache)
    return _runtime


def _threads() -> list[int]:
    """The threads of this process in the order they were made; empty on other systems than Linux."""
    try:
        return [int(name) for name in os.listdir("/proc/self/task")]  # noqa: PTH208 - in the system's order
    except OSError:
        return []


def _pin(threads: list[int], processors: list[int]) -> None:
    """Pin each of Taichi's threads to a processor of its own, in turns, where there are as many as processors.

    For each kernel all threads are woken at once, and Linux prefers to wake a thread on the processor of its waker:
    there they queue, and only after some 4 ms one is moved away, so that kernels shorter than that gain nothing from a
    second thread (measured: docs/results.md). Fewer threads than processors are not pinned, since several programs
    that did so would share the first few processors; nor are the main thread and the threads that it starts.

    Taichi starts some threads that compile, then its workers, one after another: in turns no two workers share a
    processor.
    """
    for index, thread in enumerate(threads):
        with contextlib.suppress(OSError):  # the thread has ended, or the system refuses
            os.sched_setaffinity(thread, {processors[index % len(processors)]})


def _cuda_present() -> bool:
    import ctypes.util

    names = ("nvcuda.dll",) if sys.platform == "win32" else ("libcuda.so.1", ctypes.util.find_library("cuda"))
    for name in filter(None, names):
        with contextlib.suppress(OSError):
            driver = ctypes.CDLL(name)
            count = ctypes.c_int(0)
            return driver.cuInit(0) == 0 and driver.cuDeviceGetCount(ctypes.byref(count)) == 0 and count.value > 0
    return False


def _cache_folder() -> Path | None:
    """The user's own folder for compiled kernels (mode 0700), or None where none can be created."""
    if os.environ.get("MOTESLAM_CACHE"):
        root = Path(os.environ["MOTESLAM_CACHE"])
    elif os.environ.get("XDG_CACHE_HOME"):
        root = Path(os.environ["XDG_CACHE_HOME"]) / "moteslam"
    else:
        try:
            root = Path.home() / ".cache" / "moteslam"
        except RuntimeError:
            return None
    folder = root / f"taichi-{'.'.join(map(str, ti.__version__))}"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.stat()
        if hasattr(os, "getuid") and status.st_uid != os.getuid():
            return None  # another user's folder could hold another user's code
        if status.st_mode & 0o077:
            folder.chmod(0o700)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:
        return None


def _remove_stale_lock(cache: Path) -> None:
    """Remove Taichi's cache lock if the process that took it was killed: while it is there, nothing is cached.

    Taichi holds the lock for moments, while it reads or writes its metadata, and does not record who holds it. So every
    process writes its number to the folder ``owners``; a lock is stale if it is older than a few seconds and no other
    process of that folder is alive.
    """
    owners = cache / "owners"
    with contextlib.suppress(OSError):
        owners.mkdir(mode=0o700, exist_ok=True)
        for owner in owners.iterdir():
            if not owner.name.isdecimal() or not _alive(int(owner.name)):
                owner.unlink(missing_ok=True)
        others = [owner for owner in owners.iterdir() if owner.name != str(os.getpid())]
        for lock in cache.rglob("ticache.lock"):
            if not others and time.time() - lock.stat().st_mtime > RECENT:
                lock.unlink(missing_ok=True)
        mine = owners / str(os.getpid())
        mine.touch()
        import atexit

        atexit.register(mine.unlink, missing_ok=True)


def _empty_if_truncated(cache: Path) -> None:
    """Empty the cache if a compiled kernel or their index was cut off, by a full disk or a killed process.

    Taichi compiles such a kernel anew in every process and never replaces the file, nor one that the index lists and
    that is missing. A file has a head of 24 bytes, ``TIC`` and the lengths of two parts, then these parts, and their
    SHA-256 in 64 hexadecimal digits; the index begins with its own length.
    """
    kernels, index = list(cache.rglob("T*.tic")), list(cache.rglob("ticache.tcb"))
    try:
        complete = all(map(_complete_kernel, kernels)) and all(map(_complete_index, index))
    except OSError:  # other processes remove files, too
        return
    if not complete:
        for path in (*kernels, *index):
            path.unlink(missing_ok=True)


def _complete_kernel(path: Path) -> bool:
    head, size, age = _head(path, 24)
    return age < RECENT or (len(head) == 24 and sum(struct.unpack("<8xQQ", head)) + 24 + 64 == size)


def _complete_index(path: Path) -> bool:
    head, size, age = _head(path, 8)
    return age < RECENT or (len(head) == 8 and struct.unpack("<Q", head)[0] == size)


def _head(path: Path, length: int) -> tuple[bytes, int, float]:
    """The first bytes of a file, its size, and how long ago it was written [s]: just now it may not be complete."""
    status = path.stat()
    with path.open("rb") as file:
        return file.read(length), status.st_size, time.time() - status.st_mtime


def _alive(pid: int) -> bool:
    if sys.platform == "win32":
        return True  # os.kill would interrupt it there
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        return True
    return True
