"""Mutated inputs for every reader; ``benchmarks/fuzz.py`` makes a hundred thousand of them."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from parts import fuzzing
from parts.fuzzing import fuzz, mutant
from parts.mutations import mutated
from parts.readers import Reader, readers

from moteslam.errors import InputError

CORPUS = Path(__file__).parent / "fuzz_corpus"
"""Inputs that a reader once failed on, in a folder of the reader's name, by the name of the mutated file."""


@pytest.mark.slow
@pytest.mark.parametrize("part", range(8))
def test_mutated_inputs_are_read_or_refused_in_one_line(part: int) -> None:
    tally = fuzz(readers(), range(2500 * part, 2500 * (part + 1)))
    assert not [(failure.reader, failure.index, failure.what) for failure in tally.failures]


@pytest.mark.parametrize("reader", readers(), ids=lambda reader: reader.name)
def test_the_inputs_are_read_before_they_are_mutated(reader: Reader, tmp_path: Path) -> None:
    with reader.written(tmp_path, {}) as path:
        assert reader.read(path) is not None


def test_inputs_that_once_failed_are_refused() -> None:
    by_name = {reader.name: reader for reader in readers()}
    for file in sorted(CORPUS.glob("*/*")):
        reader = by_name[file.parent.name]
        name = next(name for name in reader.files if file.name.endswith(Path(name).name))
        failed = fuzz([replaced(reader, name, file.read_bytes())], [0]).failures
        assert not failed, (file, failed[0].what)


def replaced(reader: Reader, name: str, content: bytes) -> Reader:
    """A reader whose file is not mutated any more."""
    return Reader(reader.name, {**reader.files, name: content}, reader.main, reader.read)


def reader_that(read: Any) -> list[Reader]:
    return [Reader("some", {"a.txt": b"1 2 3\n" * 30}, "a.txt", read)]


def test_a_mutant_follows_from_its_index_and_seed() -> None:
    reader = readers()[0]
    assert mutant(reader, 5, 0) == mutant(reader, 5, 0)
    assert mutant(reader, 5, 0) != mutant(reader, 5, 1)
    assert len({mutated(b"1 2 3\n4 5 6\n", np.random.default_rng(k)) for k in range(200)}) > 150


def test_what_became_of_the_inputs_is_counted(tmp_path: Path) -> None:
    def read(path: Path) -> str:
        if b"9" in path.read_bytes():
            raise InputError("a nine, expected none", file=path)
        return "fine"

    tally = fuzz(reader_that(read), range(300))
    assert not tally.failures
    assert tally.refused["some"] > 10
    assert tally.read["some"] + tally.refused["some"] == 300


@pytest.mark.parametrize(
    ("error", "what"),
    [
        (ValueError("a fault of ours"), "a fault of ours"),
        (MemoryError("too much"), "too much"),
        (InputError(""), "refused in 0 lines"),
    ],
)
def test_any_other_error_is_a_failure(error: Exception, what: str) -> None:
    def read(path: Path) -> None:
        raise error

    [failure] = fuzz(reader_that(read), [3]).failures
    assert what in failure.what
    assert failure.index == 3
    assert failure.content


def test_a_reader_that_hangs_is_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    def read(path: Path) -> None:
        begin = time.process_time()
        while time.process_time() - begin < 20:
            pass

    monkeypatch.setattr(fuzzing, "LONGEST", 0.1)
    [failure] = fuzz(reader_that(read), [0]).failures
    assert "over 0.1 s" in failure.what
