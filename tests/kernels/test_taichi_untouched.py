"""Importing moteslam and running its kernels leaves Taichi, and what others compile with it, as it was."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

IMPORT_ALL = """
import importlib, pkgutil
import moteslam.kernels
for module in pkgutil.iter_modules(moteslam.kernels.__path__):
    importlib.import_module(f"moteslam.kernels.{module.name}")
"""

COMPARE = """
import sys
import taichi

def parts():
    # functions, classes and modules of Taichi's modules, and what its classes define, by name
    found = {}
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] == "taichi" and module is not None:
            for key, value in vars(module).items():
                if callable(value) or isinstance(value, type(sys)):
                    found[name, key] = value
                if isinstance(value, type) and value.__module__.startswith("taichi"):
                    members = {k: v for k, v in vars(value).items() if callable(v) or hasattr(v, "__get__")}
                    found |= {(name, key, k): v for k, v in members.items()}
    return found

before = parts()
assert ("taichi.lang.kernel_impl", "getsourcelines") in before
assert ("taichi.lang.ast.ast_transformer", "ASTTransformer", "build_range_for") in before
"""

RUN_ONE = """
import numpy as np
from moteslam.kernels.motion import sample_motion
sample_motion(np.zeros((3, 3)), (1, 0, 0), (0, 0, 0), seed=0, step=0)
after = parts()
print([name for name, value in before.items() if after.get(name) is not value])
"""

FOREIGN = """
import taichi as ti

@ti.kernel
def several_loops(values: ti.types.ndarray(dtype=ti.i32, ndim=1), table: ti.types.ndarray(dtype=ti.f32, ndim=2)):
    for i in range(values.shape[0]):
        for j in range(5):
            values[i] += i * j
    for i in values:
        values[i] += 1
    for i, j in ti.ndrange(table.shape[0], table.shape[1]):
        table[i, j] = ti.sqrt(values[i] * j)
    ti.loop_config(block_dim=8)
    for i in range(table.shape[0]):
        table[i, 0] = 0.0
"""

LAUNCH = """
import sys
import numpy as np
import taichi as ti
folder, threads = sys.argv[1:]
sys.path.insert(0, folder)
from foreign import several_loops
ti.init(
    arch=ti.cpu, cpu_max_num_threads=int(threads), log_level=ti.ERROR, offline_cache=True,
    offline_cache_file_path=folder + "/cache",
)
values, table = np.zeros(4, np.int32), np.zeros((4, 3), np.float32)
several_loops(values, table)
assert values.tolist() == [1, 11, 21, 31] and table[1, 1] > 3
"""


def run(code: str, *arguments: str, **variables: str) -> str:
    """What the code prints, in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        env={"HOME": os.sep} | os.environ | {"TI_SKIP_VERSION_CHECK": "ON"} | variables,  # Taichi aborts without HOME
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def compiled(folder: Path, threads: int, code: str) -> list[str]:
    """The keys under which Taichi keeps the foreign kernel, which are hashes of its intermediate representation."""
    folder.mkdir()
    (folder / "foreign.py").write_text(FOREIGN)
    run(code, str(folder), str(threads))
    return sorted(path.name for path in (folder / "cache").glob("*.tic"))


def test_no_function_or_class_of_taichi_is_replaced(tmp_path: Path) -> None:
    replaced = run(COMPARE + IMPORT_ALL + RUN_ONE, MOTESLAM_CACHE=str(tmp_path))
    assert replaced.splitlines()[-1] == "[]"


@pytest.mark.parametrize("threads", [1, 2])
def test_the_kernels_of_others_compile_to_the_same_code_as_without_moteslam(threads: int, tmp_path: Path) -> None:
    without = compiled(tmp_path / "without", threads, LAUNCH)
    assert len(without) == 1
    assert compiled(tmp_path / "with", threads, IMPORT_ALL + LAUNCH) == without


def test_the_environment_stays_as_it_was(tmp_path: Path) -> None:
    code = """
import os
os.environ |= {"TI_ARCH": "vulkan", "TI_SKIP_VERSION_CHECK": "OFF", "ENABLE_TAICHI_HEADER_PRINT": "1"}
before = dict(os.environ)
from moteslam.kernels.runtime import init
assert os.environ == before
init("cpu", 1)
print(os.environ == before)
"""
    assert run(code, MOTESLAM_CACHE=str(tmp_path)) == "True\n"
