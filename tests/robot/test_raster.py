"""Rasters: where their cells lie, turned ones too."""

import numpy as np
import pytest

from moteslam.errors import InputError
from moteslam.robot.raster import Raster

VALUES = np.arange(6).reshape(2, 3)
TURNED = Raster(VALUES, 0.5, (1.0, 2.0, np.pi / 2))
"""Its columns run along y, its rows against x."""


def test_centres_and_corners_of_a_turned_raster() -> None:
    np.testing.assert_allclose(TURNED.centres([(0, 0), (1, 2)]), [(0.75, 2.25), (0.25, 3.25)])
    np.testing.assert_allclose(TURNED.to_world([(0, 0), (3, 2)]), [(1.0, 2.0), (0.0, 3.5)], atol=1e-12)
    assert TURNED.shape == (2, 3)


def test_values_are_found_where_the_centres_are_and_nowhere_else() -> None:
    cells = np.argwhere(VALUES >= 0)
    np.testing.assert_array_equal(TURNED.values_at(TURNED.centres(cells), outside=-1), VALUES.ravel())
    beyond = TURNED.to_world([(-0.1, 1.0), (3.1, 1.0), (1.0, -0.1), (1.0, 2.1)])
    np.testing.assert_array_equal(TURNED.values_at(beyond, outside=-1), [-1] * 4)


def test_colours_have_a_row_each() -> None:
    picture = Raster(np.arange(12, dtype=np.uint8).reshape(2, 2, 3), 1.0)
    np.testing.assert_array_equal(picture.values_at([(1.5, 0.5), (9.0, 9.0)], outside=7), [(3, 4, 5), (7, 7, 7)])


@pytest.mark.parametrize(("shape", "cell_size"), [((2,), 1.0), ((2, 2), 0.0), ((2, 2), float("nan"))])
def test_what_is_no_raster_is_refused(shape: tuple[int, ...], cell_size: float) -> None:
    with pytest.raises(InputError, match="expected"):
        Raster(np.zeros(shape), cell_size)
