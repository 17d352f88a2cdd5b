"""Mutated inputs for every reader; ``benchmarks/fuzz.py`` makes a hundred thousand of them."""

from pathlib import Path

import pytest
from fuzz import fuzz
from parts.readers import Reader, readers

from moteslam.errors import InputError

CORPUS = Path(__file__).parent / "fuzz_corpus"
"""Inputs that a reader once failed on, in a folder of the reader's name, by the name of the mutated file."""


@pytest.mark.slow
@pytest.mark.parametrize("part", range(4))
def test_mutated_inputs_are_read_or_refused_in_one_line(part: int):
    assert not fuzz(readers(), range(500 * part, 500 * (part + 1))).failures


@pytest.mark.parametrize("reader", readers(), ids=lambda reader: reader.name)
def test_the_inputs_are_read_before_they_are_mutated(reader: Reader, tmp_path: Path):
    with reader.written(tmp_path, {}) as path:
        assert reader.read(path) is not None


@pytest.mark.parametrize("file", sorted(CORPUS.glob("*/*")), ids=lambda file: file.name)
def test_inputs_that_once_failed_are_refused(file: Path, tmp_path: Path):
    reader = next(reader for reader in readers() if reader.name == file.parent.name)
    name = next(name for name in reader.files if file.name.endswith(Path(name).name))
    with reader.written(tmp_path, {name: file.read_bytes()}) as path, pytest.raises(InputError) as refused:
        reader.read(path)
    assert len(str(refused.value).splitlines()) == 1
