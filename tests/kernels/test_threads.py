"""Every kernel computes the same bytes on one thread and on more than there are cores."""

from pathlib import Path

import pytest
from kernel_cases import run_cases


@pytest.mark.slow
def test_each_kernel_gives_the_same_bytes_on_any_number_of_threads(tmp_path: Path) -> None:
    """On one thread no other thread runs: see ``kernel_cases``."""
    on_one, on_many = run_cases(tmp_path, threads=1), run_cases(tmp_path, threads=3)
    assert on_one.keys() == on_many.keys()
    for name, array in on_one.items():
        assert (on_many[name].dtype, on_many[name].tobytes()) == (array.dtype, array.tobytes()), name
        assert (array != array.flat[0]).any(), f"{name} is {array.flat[0]} throughout"
