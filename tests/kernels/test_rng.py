"""Philox against the published answers, the NumPy twin, and the laws of its distributions."""

from __future__ import annotations

import numpy as np
import pytest
from random_words import philox_words
from twins.philox import philox

from moteslam.errors import InputError
from moteslam.kernels.rng import seed_words

pytestmark = pytest.mark.usefixtures("taichi")

# Random123 1.14, tests/kat_vectors, philox 4x32 10: counter, key, words
KNOWN = [
    ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
    ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
]


@pytest.mark.parametrize(("counter", "key", "words"), KNOWN)
def test_known_answers(counter: tuple[int, ...], key: tuple[int, ...], words: tuple[int, ...]) -> None:
    assert philox_words([counter], [key]).tolist() == [list(words)]
    assert philox([counter], [key]).tolist() == [list(words)]


def test_equals_the_twin() -> None:
    generator = np.random.default_rng(0)
    counters = generator.integers(0, 2**32, (500, 4), dtype=np.uint32)
    keys = generator.integers(0, 2**32, (500, 2), dtype=np.uint32)
    np.testing.assert_array_equal(philox_words(counters, keys), philox(counters, keys))


@pytest.mark.parametrize(("seed", "step"), [(-1, 0), (2**64, 0), (0, -1), (0, 2**32)])
def test_seed_and_step_out_of_bounds(seed: int, step: int) -> None:
    with pytest.raises(InputError, match=r"^(seed|step): -?\d+, expected 0 to"):
        seed_words(seed, step)


def test_seed_of_64_bits() -> None:
    assert seed_words(2**64 - 2, 7) == (0xFFFFFFFE, 0xFFFFFFFF, 7)
