"""The C loops of the bench: compiled by whatever compiler there is, and the same work as the kernels."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from moteslam.eval.bench import loops as loops_module
from moteslam.eval.bench.contest import C, Disagreement, same
from moteslam.eval.bench.loops import NATIVE, OPENMP, SOURCES, Compiled, Loops, compile_loops, without_folders
from moteslam.eval.bench.tasks.ray_peers import contenders, range_libc_casters
from moteslam.eval.bench.workload import MACHINE, TASKS, WORKLOAD, chosen

KERNELS = [name for name in TASKS if name not in (*MACHINE, "run-1", "run-30", "simulation")]
FACTS = {
    "thinning": (64, {"lookups": 1081, "bytes": 8648}),
    "registration": (1000, {"bytes": 16000}),
    "integration": (1000, {"lookups": 5480, "bytes": 61568}),
    "search": (1000, {"lookups": 54000, "bytes": 9408}),
    "matching": (2000, {"lookups": 135125, "bytes": 8648}),
    "raycasting": (216200, {"bytes": 16}),
    "grid": (1, {"lookups": 99450, "bytes": 126336}),
}
"""Of each task the work of a call and what is known of it, in workload 1: where they change, so does ``WORKLOAD``."""

needs_compiler = pytest.mark.skipif(
    all(shutil.which(name) is None for name in loops_module.COMPILERS), reason="no C compiler"
)


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Compiled]:
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("CC", raising=False)
        yield compile_loops(tmp_path_factory.mktemp("loops"))


def functions(compiled: Compiled) -> Loops:
    assert compiled.library is not None, compiled.absent
    return Loops(compiled.library, openmp=compiled.openmp)


def script(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return path


@needs_compiler
@pytest.mark.parametrize("name", KERNELS)
def test_kernel_and_loop_do_the_same_work(name: str, compiled: Compiled, taichi: None) -> None:
    contest = TASKS[name].prepare(functions(compiled), 1)
    contest.check()
    assert C in contest.contenders
    work, facts = FACTS[name]
    assert WORKLOAD == 1
    assert {who: one.work for who, one in contest.contenders.items() if who in ("moteslam", C)} == {
        "moteslam": work,
        C: work,
    }
    for fact, value in facts.items():
        assert contest.facts[fact] == pytest.approx(value, rel=0.02), fact  # bytes: where the pool begins in memory


@needs_compiler
def test_the_library_leaves_the_arithmetic_of_the_process_alone(compiled: Compiled) -> None:
    """Linked with -ffast-math it would make all that runs beside it take the smallest numbers for 0: SciPy crashes."""
    functions(compiled)
    assert (np.full(3, 1e-310) > 0).all()


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize(
    ("name", "file", "old", "new"),
    [
        ("thinning", "loops.c", ">= within)", ">= 0.9f * within)"),
        ("registration", "maps.c", "STEPS = 1023", "STEPS = 1000"),
        ("integration", "maps.c", "overlap = 0.25f", "overlap = 0.3f"),
        ("search", "maps.c", "-(near / 2)", "-(near / 3)"),
        ("matching", "loops.c", "cells[j] = y * w + x", "cells[j] = y * w + x + 1"),
        ("raycasting", "loops.c", "u <= 1.0f", "u <= 0.9f"),
        ("grid", "loops.c", "error = major / 2", "error = major / 3"),
    ],
)
def test_other_work_is_noticed(
    name: str, file: str, old: str, new: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, taichi: None
) -> None:
    copies = [Path(shutil.copy(source, tmp_path)) for source in SOURCES]
    for copy in copies:
        if copy.name == file:
            text = copy.read_text()
            assert old in text
            copy.write_text(text.replace(old, new))
    monkeypatch.setattr(loops_module, "SOURCES", copies)
    changed = functions(compile_loops(tmp_path))
    with pytest.raises(Disagreement, match=r"of kernel and C differ in a share of .*, expected at most"):
        TASKS[name].prepare(changed, 1).check()


@pytest.mark.parametrize("name", KERNELS)
def test_without_loops_the_kernel_is_alone(name: str, taichi: None) -> None:
    contest = TASKS[name].prepare(None, 1)
    contest.check()
    assert C not in contest.contenders
    assert TASKS[name].prepare(None, 2).contenders.keys() == {"moteslam"}


def test_the_machine_is_measured_by_c_alone(taichi: None) -> None:
    assert all(TASKS[name].prepare(None, 1).contenders == {} for name in MACHINE)


@needs_compiler
def test_without_openmp_the_loops_run_on_one_thread(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, taichi: None
) -> None:
    monkeypatch.delenv("CC", raising=False)
    real = next(filter(None, map(shutil.which, loops_module.COMPILERS)))
    cc = script(
        tmp_path, "cc1", f'case "$*" in *{OPENMP}*) echo "what is {OPENMP}?" >&2; exit 1;; esac; exec {real} "$@"'
    )
    monkeypatch.setenv("CC", str(cc))
    found = compile_loops(tmp_path)
    assert NATIVE in found.flags
    assert not found.openmp
    one = functions(found)
    assert C in TASKS["matching"].prepare(one, 1).contenders
    assert C not in TASKS["matching"].prepare(one, 2).contenders
    assert TASKS["arithmetic"].prepare(one, 2).contenders == {}
    only = script(tmp_path, "cc2", f'case "$*" in *-march*|*-fopenmp*) exit 1;; esac; exec {real} "$@"')
    monkeypatch.setenv("CC", f"{only} -Wall")
    assert compile_loops(tmp_path).flags == ("-O3", "-ffast-math")


def test_without_a_compiler_there_is_a_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    assert compile_loops(tmp_path) == Compiled(None, absent="no C compiler: none of gcc, clang, cc is there")
    monkeypatch.setenv("CC", "/home/somebody/bin/icc -fast")
    assert compile_loops(tmp_path).absent == "no program of the name in CC, icc"
    monkeypatch.setenv("CC", '"open')
    assert compile_loops(tmp_path).absent == 'no program of the name in CC, "open'
    broken = script(tmp_path, "broken", 'echo "/home/somebody/tmp/loops.c: no space left" >&2; exit 4')
    monkeypatch.setenv("CC", str(broken))
    found = compile_loops(tmp_path)
    assert found.library is None
    assert found.absent == "the C compiler broken ended with exit code 4: loops.c: no space left"
    silent = script(tmp_path, "silent", "exit 0")
    monkeypatch.setenv("CC", str(silent))
    assert compile_loops(tmp_path).absent.startswith("the C compiler silent loops.so: cannot open shared object")


def test_paths_are_cut_down_to_their_last_part() -> None:
    assert without_folders("/home/a/x.c:3: error in /usr/include/y.h") == "x.c:3: error in y.h"
    assert without_folders("gcc (Debian 12.2.0-14) 12.2.0") == "gcc (Debian 12.2.0-14) 12.2.0"
    assert without_folders(r"C:\Users\a\x.c") == "x.c"
    assert without_folders("24 GB/s and 1/2") == "24 GB/s and 1/2"


def test_a_share_that_is_no_number_differs() -> None:
    same("cells", 0.01, 0.01)
    with pytest.raises(Disagreement):
        same("cells", 0.011, 0.01)
    with pytest.raises(Disagreement):
        same("cells", float("nan"), 0.01)


def test_tasks_are_picked_by_name_and_the_machine_comes_along() -> None:
    assert chosen([]) == list(TASKS)
    assert chosen(["grid", "thinning"]) == ["arithmetic", "memory", "thinning", "grid"]


def test_programs_that_find_other_ranges_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    walls = np.array([(-5.0, 2.0, 5.0, 2.0), (4.0, -5.0, 4.0, 5.0)])
    rays = np.array([(1.0, 0.0, np.pi / 2), (1.0, 0.0, 0.0), (1.0, 0.0, np.pi)], np.float32)
    exact = np.array((2.0, 3.0, 30.0), np.float32)
    found, near = contenders(walls, rays, exact, 30.0)
    assert found["pymunk"].call() == pytest.approx([2.0, 3.0, 30.0], abs=1e-6)
    assert near["pymunk near"] == 1.0
    with pytest.raises(Disagreement, match=r"33% of the ranges of pymunk are within 0\.2 m of ours, expected 50%"):
        contenders(walls, rays, exact + np.array((1.0, 1.0, 0.0), np.float32), 30.0)
    monkeypatch.setattr("moteslam.eval.bench.tasks.ray_peers.find_spec", lambda name: None)
    assert range_libc_casters(walls, rays, 30.0) == {}


def test_the_sources_are_there() -> None:
    assert all(source.is_file() and os.access(source, os.R_OK) for source in SOURCES)
