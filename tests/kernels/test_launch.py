"""Kernels that load and launch fast: the same results and errors as Taichi's own, whatever the arguments are."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from moteslam.kernels.runtime import ti
from moteslam.kernels.types import F32, F32_1D, I32, I32_2D, U32, func, kernel, template

pytestmark = pytest.mark.usefixtures("taichi")


@kernel
def fill(values: F32_1D, add: F32, unsigned: U32, more: I32, factor: template, out: I32_2D):
    for i in range(values.shape[0]):
        out[i, 0] = ti.cast(values[i] + add, ti.i32) * ti.static(factor) + more
        out[i, 1] = ti.cast(unsigned // ti.u32(2), ti.i32)
        out[i, 2] = 3


@kernel
def keep(value: F32, out: F32_1D):
    for i in range(out.shape[0]):
        out[i] = value


@func
def inlined(x):
    return x + absent  # noqa: F821


@kernel
def unknown(values: F32_1D):
    values[0] = inlined(1.0)


def test_numbers_and_arrays_arrive_and_each_template_has_its_own_form() -> None:
    out = np.zeros((2, 3), np.int32)
    for _ in range(3):  # the first call compiles, the others are launched directly
        for factor, add in ((2, 5), (3, np.int64(-7)), (2, True)):
            out[:] = 0
            fill(np.array([1.5, 2.5], np.float32), np.float32(0.5), 2**31 + 4, add, factor, out)
            expected = [(int(x + 0.5) * factor + int(add)) for x in (1.5, 2.5)]
            assert out.tolist() == [[value, 2**30 + 2, 3] for value in expected]


def test_an_error_in_a_kernel_names_file_line_and_code() -> None:
    with pytest.raises(ti.TaichiNameError) as caught:
        unknown(np.zeros(2, np.float32))
    for part in (f'File "{__file__}", line ', "in unknown:", "values[0] = inlined(1.0)", "in inlined:", "x + absent"):
        assert part in str(caught.value)


def test_arguments_that_change_between_launches_arrive() -> None:
    """Arguments that are equal to those of the last launch are not set again."""
    first, second = np.zeros((2, 3), np.int32), np.zeros((2, 3), np.int32)
    values = np.array([1.0, 2.0], np.float32)
    fill(values, 1.0, 1, 1, 2, first)
    for out, add, more in ((first, 1.0, 1), (second, 1.0, 1), (second, 2.0, 1), (first, 2.0, -1), (first, 0.0, 0)):
        values += 1  # in place: the same memory, other numbers
        fill(values, add, 1, more, 2, out)
        assert out[:, 0].tolist() == [int(v + add) * 2 + more for v in values]
    values.shape = (1, 2)  # the same array, of another shape
    with pytest.raises(Exception, match=r"."):
        fill(values, 1.0, 1, 1, 2, out)
    signs = np.zeros(1, np.float32)
    for zero in (0.0, -0.0, 0.0, np.nan, -0.0):
        keep(zero, signs)
        assert str(signs[0]) == str(np.float32(zero))


def test_arguments_of_other_types_raise_taichis_errors_after_direct_launches_too() -> None:
    values, out = np.zeros(2, np.float32), np.zeros((2, 3), np.int32)
    right = (values, 1.0, 1, 1, 2, out)
    for _ in range(3):
        fill(*right)
    strided = np.zeros(4, np.float32)[::2]
    wrong = [(0, other) for other in (values.astype(np.float64), np.zeros((2, 2), np.float32), strided, None, "x")]
    for place, value in (*wrong, (1, "x"), (2, 1.5)):
        with pytest.raises(Exception, match=r"."):
            fill(*(value if k == place else each for k, each in enumerate(right)))
    with pytest.raises(Exception, match=r"."):
        fill(values, 1.0)


ANOTHER_RELEASE = """
import taichi as ti
ti.__version__ = (1, 7, 99)  # without the internals that are used of the one that is known
del ti.lang.ast.ast_transformer_utils.ASTTransformerContext, ti.lang._ndarray.ScalarNdarray
import numpy as np
from moteslam.kernels.motion import sample_motion
for _ in range(3):
    poses = np.zeros((3, 3))
    sample_motion(poses, (1, 0, 0.5), (0, 0, 0), seed=0, step=0)
    assert (poses == (1, 0, 0.5)).all(), poses
from moteslam.kernels import motion
assert motion._sample_motion._primal.compiled_kernels
print("launched by Taichi itself")
"""


def test_with_another_release_taichi_itself_loads_and_launches(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", ANOTHER_RELEASE],
        # Taichi itself needs a home folder
        env=os.environ | {"MOTESLAM_CACHE": str(tmp_path), "ENABLE_TAICHI_HEADER_PRINT": "0", "HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert (done.returncode, done.stdout) == (0, "launched by Taichi itself\n"), done.stderr
