"""The seam to Taichi: quiet, offline, once a process, with a cache folder of its own. Each case in a new process."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

POSIX = pytest.mark.skipif(os.name != "posix", reason="file modes and signals of POSIX")
LOCK = "ticache.lock"
KERNEL = """
import numpy as np
from moteslam.kernels.matching import match_poses
grid = np.zeros((8, 8), np.uint8)
grid[3, 4] = 1
match = match_poses(
    grid, (0.0, 0.0), 1.0, [[0, 0, 0], [1, 0, 0]], [[4.5, 3.5], [3.5, 3.5], [3.6, 3.6]], offsets_xy=[0.0],
    offsets_theta=[0.0],
)
assert match.scores.tolist() == [1, 2], match
"""
SETTINGS = """
from moteslam.errors import BackendError
from moteslam.kernels.runtime import init, runtime
def refused(*args, **options):
    try:
        init(*args, **options)
    except BackendError as error:
        return str(error)
    return f"{args} {options} taken"
"""


def start(code: str, tmp_path: Path, **variables: str | None) -> subprocess.Popen[str]:
    """A process that runs the code, with a cache and a home folder of its own in tmp_path; None unsets a variable."""
    changed = {"HOME": str(tmp_path / "home"), "MOTESLAM_CACHE": str(tmp_path / "cache")} | variables
    environment = {name: value for name, value in (os.environ | changed).items() if value is not None}
    pipe = subprocess.PIPE
    return subprocess.Popen(
        [sys.executable, "-c", code], env=environment, stdin=pipe, stdout=pipe, stderr=pipe, text=True
    )


def run(code: str, tmp_path: Path, **variables: str | None) -> str:
    """What the code prints; it must end well and print nothing on stderr."""
    with start(code, tmp_path, **variables) as process:
        out, err = process.communicate(timeout=600)
    assert (process.returncode, err) == (0, "")
    return out


def cache_of(tmp_path: Path) -> Path:
    """The folder the kernels are kept in."""
    (folder,) = (tmp_path / "cache").iterdir()
    return folder


def leave_lock(cache: Path, *, age: float) -> Path:
    """Taichi's lock, as a process leaves it that is killed while it holds it."""
    lock = cache / LOCK
    lock.touch()
    os.utime(lock, (time.time() - age,) * 2)
    return lock


def test_init_and_a_first_kernel_print_nothing_and_fill_the_cache_alone(tmp_path: Path) -> None:
    (tmp_path / "home").mkdir()
    assert run(KERNEL, tmp_path, ENABLE_TAICHI_HEADER_PRINT="1") == ""
    kept = sorted(path.name for path in cache_of(tmp_path).glob("*.tic"))
    assert kept
    assert run(KERNEL, tmp_path) == ""  # and the same answer from the cache, nothing compiled again
    assert sorted(path.name for path in cache_of(tmp_path).glob("*.tic")) == kept
    assert not list((tmp_path / "home").iterdir())


@POSIX
def test_the_cache_folder_is_its_owners_alone_whatever_the_mask_and_whatever_it_was(tmp_path: Path) -> None:
    code = "import os; os.umask(0); from moteslam.kernels.runtime import init; print(init('cpu', 1).cache)"
    cache = Path(run(code, tmp_path).strip())
    assert cache == cache_of(tmp_path)
    assert cache.stat().st_mode & 0o777 == 0o700
    cache.chmod(0o777)
    run(code, tmp_path)
    assert cache.stat().st_mode & 0o777 == 0o700


def test_where_no_cache_can_be_had_kernels_run_without(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    code = KERNEL + "from moteslam.kernels.runtime import runtime; print(runtime().cache)"
    assert run(code, tmp_path, MOTESLAM_CACHE=str(tmp_path / "file" / "cache")) == "None\n"
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@POSIX
def test_the_lock_of_a_killed_process_is_removed_and_kernels_are_kept_again(tmp_path: Path) -> None:
    with start(
        "import os; from moteslam.kernels.runtime import init; init(); os.kill(os.getpid(), 9)", tmp_path
    ) as dead:
        dead.communicate(timeout=600)
    assert dead.returncode == -signal.SIGKILL
    cache = cache_of(tmp_path)
    assert [path.name for path in (cache / "owners").iterdir()] == [str(dead.pid)]
    lock = leave_lock(cache, age=60)
    assert run(KERNEL, tmp_path) == ""
    assert not lock.exists()
    assert list(cache.glob("*.tic"))
    assert not list((cache / "owners").iterdir())


@pytest.mark.parametrize("name", ["T*.tic", "ticache.tcb"])
@pytest.mark.parametrize("length", [0, 100])
def test_a_file_of_the_cache_that_was_cut_off_is_replaced(name: str, length: int, tmp_path: Path) -> None:
    run(KERNEL, tmp_path)
    cache = cache_of(tmp_path)
    cut = next(cache.glob(name))
    size = cut.stat().st_size
    os.truncate(cut, length)
    os.utime(cut, (time.time() - 60,) * 2)
    assert run(KERNEL, tmp_path) == ""
    assert cut.stat().st_size == size


@POSIX
def test_the_lock_stays_while_its_owner_may_live(tmp_path: Path) -> None:
    setup = "from moteslam.kernels.runtime import init; init('cpu', 1)"
    with start(f"{setup}; print(flush=True); input()", tmp_path) as alive:
        try:
            assert alive.stdout is not None
            alive.stdout.readline()
            lock = leave_lock(cache_of(tmp_path), age=60)
            run(setup, tmp_path)
            assert lock.exists()
            assert run(KERNEL, tmp_path) == ""  # locked out of the cache it computes all the same
        finally:
            alive.communicate("\n", timeout=600)
    assert alive.returncode == 0


@POSIX
def test_a_lock_just_taken_stays_and_strange_names_among_the_owners_do_no_harm(tmp_path: Path) -> None:
    setup = "from moteslam.kernels.runtime import init; init('cpu', 1)"
    run(setup, tmp_path)
    cache = cache_of(tmp_path)
    lock = leave_lock(cache, age=-60)
    for name in ("9" * 30, "²", "notes"):
        with contextlib.suppress(UnicodeEncodeError):  # the locale's encoding has no such letter
            (cache / "owners" / name).touch()
    run(setup, tmp_path)
    assert lock.exists()
    leave_lock(cache, age=60)
    run(setup, tmp_path)
    assert not lock.exists()
    assert not list((cache / "owners").iterdir())


@pytest.mark.parametrize("home", [None, "", "/proc/none", "a home with spaces"])
def test_kernels_run_wherever_home_is(home: str | None, tmp_path: Path) -> None:
    home = str(tmp_path / home) if home else home  # an absolute one stays as it is
    check = f"import os\nassert os.environ.get('HOME') == {home!r}, os.environ.get('HOME')\n"
    assert run(check + KERNEL + check, tmp_path, HOME=home, MOTESLAM_CACHE=None, XDG_CACHE_HOME=None) == ""


def test_settings_are_checked_and_taken_once(tmp_path: Path) -> None:
    code = (
        SETTINGS
        + """
print(refused("vulkan"))
for threads in (0, -3, 1025):
    print(refused("cpu", threads))
first = init("cpu", 2)
assert init("cpu", 2) is init() is runtime() is first
print(refused("cpu", 3))
print(refused("cuda"))
print(refused("cpu", 2, debug=True))
"""
    )
    other = "Taichi runs on cpu with 2 threads in this process, expected the same settings again, not"
    assert run(code, tmp_path).splitlines() == [
        "arch: backend 'vulkan', expected one of cpu, cuda",
        "threads: 0 threads, expected 1 to 1024",
        "threads: -3 threads, expected 1 to 1024",
        "threads: 1025 threads, expected 1 to 1024",
        f"{other} cpu with 3 threads; start a new process",
        f"{other} cuda with 2 threads; start a new process",
        f"{other} cpu with 2 threads and bounds checks; start a new process",
    ]


@pytest.mark.skipif(Path("/dev/nvidia0").exists(), reason="there is an NVIDIA GPU on this machine")
def test_cuda_is_refused_in_one_line_where_there_is_none_and_the_cpu_serves_still(tmp_path: Path) -> None:
    lines = run(SETTINGS + "print(refused('cuda'))\n" + KERNEL, tmp_path).splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("arch: ")
    assert "expected a CUDA device" in lines[0]


def test_nothing_asks_the_network_even_if_the_environment_asks_for_it(tmp_path: Path) -> None:
    hook = """
import os, sys, threading
def no_network(event, arguments):
    if event in ("socket.connect", "socket.getaddrinfo", "socket.gethostbyname", "socket.sendto"):
        os.write(2, f"{event} {arguments}".encode())
        os._exit(70)
sys.addaudithook(no_network)
"""
    wait = "\nfor thread in set(threading.enumerate()) - {threading.main_thread()}:\n    thread.join()\n"
    assert run(hook + KERNEL + wait, tmp_path, TI_SKIP_VERSION_CHECK="OFF") == ""


MASKS = """
import os
from moteslam.kernels.runtime import init
allowed = sorted(os.sched_getaffinity(0))
before = os.listdir("/proc/self/task")
init("cpu", {threads})
masks = [os.sched_getaffinity(int(thread)) for thread in os.listdir("/proc/self/task") if thread not in before]
assert masks and os.sched_getaffinity(0) == set(allowed)
print(sorted({{tuple(sorted(mask)) for mask in masks[-{threads}:]}}) == {expected})
"""


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="Linux alone reports and sets where threads run")
@pytest.mark.parametrize(
    ("threads", "expected"),
    [
        ("len(allowed)", "[(cpu,) for cpu in allowed]"),
        ("1", "[tuple(allowed)]"),
        ("1 + len(allowed)", "[tuple(allowed)]"),
    ],
)
def test_as_many_threads_as_processors_have_one_each_and_others_are_free(
    threads: str, expected: str, tmp_path: Path
) -> None:
    if os.environ.get("MOTESLAM_TEST_PROCESSORS"):
        pytest.skip("threads cannot be placed on processors that are not there")
    if len(os.sched_getaffinity(0)) < 2:
        pytest.skip("one processor: nothing to choose from")
    assert run(MASKS.format(threads=threads, expected=expected) + KERNEL, tmp_path) == "True\n"


def test_a_system_that_does_not_place_threads_computes_all_the_same(tmp_path: Path) -> None:
    code = "import os\nfor name in ('sched_getaffinity', 'sched_setaffinity'):\n    vars(os).pop(name, None)\n"
    assert run(code + KERNEL, tmp_path) == ""
