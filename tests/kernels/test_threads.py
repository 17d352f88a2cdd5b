"""Every kernel computes the same bytes on one thread and on many, more than there are cores among them."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import pytest
from kernel_cases import Results, run_cases


def digests(results: Results) -> dict[str, str]:
    """SHA-256 of each array's bytes, with its type and shape."""
    return {
        name: hashlib.sha256(f"{array.dtype}{array.shape}".encode() + array.tobytes()).hexdigest()
        for name, array in results.items()
    }


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("threads")


@pytest.fixture(scope="module")
def on_one_thread(folder: Path) -> Results:
    """With an empty cache: the others run what this process compiled."""
    return run_cases(folder, threads=1)


@pytest.mark.parametrize("threads", [2, *(pytest.param(n, marks=pytest.mark.slow) for n in (3, 5))])
def test_each_kernel_gives_the_same_bytes_on_any_number_of_threads(
    folder: Path, on_one_thread: Results, threads: int
) -> None:
    assert digests(run_cases(folder, threads=threads)) == digests(on_one_thread)


def test_the_results_that_are_compared_say_something(on_one_thread: Results) -> None:
    for name, array in on_one_thread.items():
        assert (array != array.flat[0]).any(), f"{name} is {array.flat[0]} throughout"


SWITCHES = """
import os, sys
sys.path.insert(0, sys.argv[1])
from moteslam.kernels import runtime
runtime.init("cpu", 1)
import kernel_cases

def switches():
    # how often each thread but the main one has run, by its number
    counts = {}
    for thread in set(os.listdir("/proc/self/task")) - {str(os.getpid())}:
        with open(f"/proc/self/task/{thread}/status") as status:
            counts[thread] = sum(int(line.split()[1]) for line in status if "ctxt_switches" in line)
    return counts

kernel_cases.compute()
before = switches()
assert before, "Taichi has threads"
kernel_cases.compute()
print(switches() == before)
"""


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="Linux alone counts how often a thread runs")
def test_on_one_thread_every_loop_runs_where_it_is_launched(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", SWITCHES, str(Path(__file__).parents[1])],
        env=os.environ | {"MOTESLAM_CACHE": str(tmp_path), "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert (done.returncode, done.stdout) == (0, "True\n"), done.stderr
