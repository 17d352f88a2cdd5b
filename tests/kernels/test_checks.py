"""Arrays that a kernel cannot use are refused by the name of the argument, once for all kernels."""

from __future__ import annotations

import numpy as np
import pytest

from moteslam.errors import InputError
from moteslam.kernels.checks import as_finite, check_array

GOOD = np.zeros((3, 2), np.float32)
READ_ONLY = GOOD.copy()
READ_ONLY.setflags(write=False)


@pytest.mark.parametrize("written", [False, True])
@pytest.mark.parametrize("shape", [(3, 2), (None, 2), (None, None)])
def test_an_array_that_fits_is_taken_as_it_is(shape: tuple[int | None, ...], written: bool) -> None:
    assert check_array("ends", GOOD, np.float32, shape, written=written) is GOOD
    assert as_finite("ends", GOOD, np.float32, shape) is GOOD


@pytest.mark.parametrize(
    "bad",
    [
        None,
        [(0, 0)],
        GOOD.astype(np.float64),
        GOOD[:, :1].copy(),
        GOOD.ravel(),
        np.zeros((2, 3), np.float32).T,
        READ_ONLY,
    ],
)
def test_another_type_shape_or_layout_is_refused(bad: object) -> None:
    with pytest.raises(InputError) as caught:
        check_array("ends", bad, np.float32, (None, 2), written=True)
    assert caught.value.field == "ends"


@pytest.mark.parametrize("bad", [[(0, np.nan)], [(0, np.inf)], [(0, 0, 0)], [0, 0]])
def test_numbers_that_are_not_finite_or_of_another_shape_are_refused(bad: object) -> None:
    with pytest.raises(InputError) as caught:
        as_finite("ends", bad, np.float32, (None, 2))  # type: ignore[arg-type]
    assert caught.value.field == "ends"
