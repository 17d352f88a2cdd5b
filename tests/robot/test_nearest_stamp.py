"""The one search for the stamp nearest to a time."""

from __future__ import annotations

import numpy as np

from moteslam.robot.stamps import nearest_stamp


def test_the_earlier_of_two_equally_near_is_taken():
    stamps = np.array([0.0, 1.0, 2.0])
    np.testing.assert_array_equal(nearest_stamp(stamps, np.array([-5, 0.4, 0.5, 0.6, 1.5, 9])), [0, 0, 0, 1, 1, 2])
    np.testing.assert_array_equal(nearest_stamp(np.array([3.0]), np.array([0.0, 9.0])), [0, 0])


def test_of_equal_stamps_the_first_or_the_last_is_taken():
    stamps = np.array([0.0, 1.0, 1.0, 1.0, 2.0])
    assert nearest_stamp(stamps, np.array([1.0])) == 1
    assert nearest_stamp(stamps, np.array([1.0]), side="right") == 3


def test_the_shape_is_that_of_the_times():
    assert nearest_stamp(np.arange(5.0), np.array([[0.2, 1.7], [3.9, 9.0]])).tolist() == [[0, 2], [4, 4]]
