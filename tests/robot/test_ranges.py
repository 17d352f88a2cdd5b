import numpy as np
import pytest
from numpy.typing import NDArray

from moteslam.robot.recording import ChunkedRanges, chosen, chunks

ALL = np.random.default_rng(3).uniform(0.1, 30, (1000, 7)).astype(np.float32)


class File:
    """Ranges in a file that counts how many scans are read."""

    def __init__(self) -> None:
        self.read = 0

    def load(self, first: int, last: int) -> NDArray[np.float32]:
        self.read += last - first
        return ALL[first:last].copy()


@pytest.mark.parametrize(
    "key",
    [
        0,
        -1,
        np.int64(517),
        slice(None),
        slice(250, 262),
        slice(None, None, -300),
        np.array([999, 3, 3, 511]),
        ALL[:, 0] > 20,
        (5, slice(None, None, 2)),
        (slice(0, 900, 100), slice(1, 3)),
        (np.array([1, 700]), slice(None)),
        (255, np.array([1, 4])),
    ],
)
def test_chunks_are_indexed_as_an_array_is(key: object) -> None:
    np.testing.assert_array_equal(ChunkedRanges(File().load, 1000, 7)[key], ALL[key])


def test_all_of_it_as_an_array_and_in_chunks() -> None:
    ranges = ChunkedRanges(File().load, 1000, 7)
    np.testing.assert_array_equal(np.asarray(ranges), ALL)
    np.testing.assert_array_equal(np.concatenate(list(chunks(ranges))), ALL)


def test_scans_in_order_are_read_once_and_not_before() -> None:
    file = File()
    ranges = ChunkedRanges(file.load, 1000, 7)
    assert file.read == 0
    for index in range(1000):
        np.testing.assert_array_equal(ranges[index], ALL[index])
    assert file.read == 1000


def test_chosen_scans_are_read_when_they_are_asked_for() -> None:
    file, some = File(), np.array([900, 2, 300])
    few = chosen(ChunkedRanges(file.load, 1000, 7), some)
    assert file.read == 0
    assert few.shape == (3, 7)
    np.testing.assert_array_equal(few[:], ALL[some])
    np.testing.assert_array_equal(chosen(ALL, some)[:], ALL[some])
