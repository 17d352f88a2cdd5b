"""The one seam to Taichi: quiet and offline, initialised once a process, its kernels launched fast.

Kernel files import ``ti`` from here. It imports Taichi (0.2 s): modules that must load at once import it in functions.
"""

import atexit
import contextlib
import io
import os
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any
from weakref import ref

import numpy as np

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

__all__ = ["Runtime", "init", "kernel", "one_thread", "passes_for", "runtime", "ti"]

ARCHES = ("cpu", "cuda")
BATCH, BATCHES = 512, 8  # Passes of a loop that Taichi hands out at a time, whatever `block_dim` says; and a thread's
STALE = 60.0  # Taichi locks its cache for moments: an older lock [s] is that of a killed process


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

    With this line an outermost loop runs in the thread that launches it, and Taichi does not wake its one worker, which
    costs 60 us of processor time and twice as much to wait for (docs/results.md).
    """
    return runtime().arch == "cpu" and runtime().threads == 1


def passes_for(work: int) -> int:
    """How many passes of a loop there are for each piece of work of some microseconds, so that all threads have some:
    ``for k in range(work * passes): if k % passes: continue``, then piece ``k // passes``. An empty pass takes 1 ns.
    """
    if one_thread() or runtime().arch != "cpu" or not work:
        return 1
    return min(BATCH, -(-BATCH * BATCHES * runtime().threads // work))


def init(arch: str = "cpu", threads: int | None = None, *, debug: bool = False) -> Runtime:
    """Initialise Taichi for this process; a second call with the same settings does nothing.

    ``threads`` are of the CPU backend, by default one for each processor that this process may use.
    """
    global _runtime  # noqa: PLW0603 - there is one Taichi in a process
    if arch not in ARCHES:
        raise BackendError(f"{arch!r}, expected one of {', '.join(ARCHES)}", field="arch")
    if threads is not None and not 1 <= threads <= 1024:
        raise BackendError(f"{threads}, expected 1 to 1024", field="threads")
    processors = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    threads = threads or (_runtime.threads if _runtime else len(processors) or os.cpu_count() or 1)
    if _runtime is not None:
        if _runtime != (wanted := Runtime(arch, threads, debug, _runtime.cache)):
            raise BackendError(f"Taichi runs with {_runtime} in this process, not {wanted}: start a new one")
        return _runtime
    tasks, cache = Path("/proc/self/task"), _cache_folder()
    before = list(tasks.iterdir()) if processors else []
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
        _pin([int(task.name) for task in tasks.iterdir() if task not in before], processors)
    _runtime = Runtime(arch, threads, debug, cache)
    if cache:  # what was compiled is written when the program ends, which pydantic's classes hold to the last
        atexit.register(_environment()(ti.reset))
    return _runtime


def _pin(threads: list[int], processors: list[int]) -> None:
    """Pin each of Taichi's threads to a processor of its own: Linux wakes them on that of their waker, where they queue
    for some 4 ms (docs/results.md). Fewer threads than processors stay free: other programs may pin theirs, too.
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


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """``ti.kernel`` for a function of arrays, numbers and templates that are numbers, launched in a third of the time.

    Taichi spends 13 us on each array of a call, longer than many a kernel runs. Once a kernel is compiled, a call whose
    arguments have exactly the annotated types is handed to the compiled kernel directly; every other call, and every
    call with another release of Taichi, goes through Taichi, initialised if it was not yet. On the CPU arguments
    that did not change since the last launch are not set again. Without this a replay takes a third longer with one
    particle, an eighth with thirty.
    """
    own, known = ti.kernel(function), ti.__version__ == (1, 7, 4)  # the release whose internals are used here
    annotations = [argument.annotation for argument in own._primal.arguments] if known else []
    templates = [index for index, each in enumerate(annotations) if isinstance(each, ti.template)]
    compiled: dict[tuple[Any, ...], Any] = {}  # by the values of the templates
    idle: dict[tuple[Any, ...], list[_Launch]] = {}

    @wraps(own)
    def launcher(*arguments: Any) -> None:
        complete = known and len(arguments) == len(annotations)
        values = tuple([arguments[index] for index in templates]) if complete else ()
        if complete and values in compiled:
            waiting = idle[values]
            launch = waiting.pop() if waiting else _Launch(compiled[values], annotations)  # each thread has its own
            if launch.run(arguments):
                if runtime().arch == "cpu":
                    waiting.append(launch)
                return
        debug = runtime().debug  # initialised before the first launch
        own(*arguments)
        if known and not debug:  # only Taichi's own launch reports a bounds check that failed
            idle[values] = []
            compiled[values] = own._primal.compiled_kernels[own._primal.ensure_compiled(*arguments)]

    return launcher


class _Launch:
    """A compiled kernel with the arguments of its last launch; those that are equal are not set again."""

    def __init__(self, compiled: Any, annotations: list[Any]) -> None:
        self._program = program = ti.lang.impl.get_runtime().prog
        self._code = program.compile_kernel(program.config(), program.get_device_caps(), compiled)
        self._context = context = compiled.make_launch_context()
        integer, real = (int, np.integer), (float, int, np.floating, np.integer)
        setters = {ti.i32: (integer, context.set_arg_int, int), ti.u32: (integer, context.set_arg_uint, int)}
        setters |= dict.fromkeys((ti.f32, ti.f64), (real, context.set_arg_float, float))
        given = [(k, each) for k, each in enumerate(annotations) if not isinstance(each, ti.template)]
        # number in the call, place among those that are set, and what it must be
        self._arrays: list[tuple[int, int, np.dtype[Any], int]] = []
        self._numbers: list[tuple[int, int, tuple[type, ...], Callable[..., None], type]] = []
        for place, (index, each) in enumerate(given):
            if isinstance(each, ti.types.ndarray_type.NdarrayType):
                self._arrays.append((index, place, np.dtype(ti.lang.util.to_numpy_type(each.dtype)), each.ndim))
            else:
                self._numbers.append((index, place, *setters[each]))
        self._last: list[Any] = [None] * len(given)  # numbers; address and shape of arrays
        self._same: list[Callable[[], Any]] = [lambda: None] * len(given)  # weak references to the arrays

    def run(self, arguments: tuple[Any, ...]) -> bool:
        """Launch the kernel; False, and nothing done, if the arguments have other types than it was compiled for."""
        last = self._last
        for number, place, dtype, dimensions in self._arrays:
            value = arguments[number]
            same = self._same[place]()
            if same is value and same is not None and same.shape == last[place][1]:
                continue
            if type(value) is np.ndarray:
                if value.dtype != dtype or value.ndim != dimensions or not value.flags.c_contiguous:
                    return False
                memory = (value.ctypes.data, value.shape)
                if memory != last[place]:
                    self._context.set_arg_external_array_with_shape((place,), memory[0], value.nbytes, memory[1], 0)
                    last[place] = memory
                self._same[place] = ref(value)
            elif type(value) is ti.lang._ndarray.ScalarNdarray:  # one of Taichi's own, on the device
                if len(value.shape) != dimensions or ti.lang.util.to_numpy_type(value.dtype) != dtype:
                    return False
                self._context.set_arg_ndarray((place,), value.arr)  # at every launch, which writes over it
                last[place], self._same[place] = None, lambda: None
            else:
                return False
        for number, place, accepted, set_argument, convert in self._numbers:
            value = arguments[number]
            if value is last[place]:
                continue
            if not isinstance(value, accepted):
                return False
            if value != last[place] or value == 0:  # zeros may differ in their sign
                set_argument((place,), convert(value))
                last[place] = value
        self._program.launch_kernel(self._code, self._context)
        return True
