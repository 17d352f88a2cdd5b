"""Mutated inputs for every reader: each is read, or refused in one line, within bounds of time and memory.

    python benchmarks/fuzz.py --inputs 100000 --out fuzz.csv
    python benchmarks/fuzz.py --readers carmen ucsd --inputs 5000 --seeds 3-3

An input is a file that the project has written itself, with bits, bytes, words, lines or members of an archive changed,
dropped or repeated. Whatever raises anything but the project's own error of one line, takes more than 10 s, or more
than 1 GB, is a failure.
"""

import resource
import signal
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import NamedTuple

import numpy as np
from parts.harness import Bar, Row, arguments, benchmark, count, memory, status
from parts.mutations import mutated
from parts.readers import Reader, readers

from moteslam.errors import MoteslamError

LONGEST = 10.0  # A reader that takes longer hangs [s of processor time]
MEMORY = 1_000_000_000  # What reading may take beyond what the process has before [bytes]


class Failure(NamedTuple):
    """An input that was neither read nor refused in one line; ``what`` is the end of the traceback."""

    reader: str
    number: int
    file: str
    what: str


@dataclass
class Tally:
    """How many inputs of each reader were read and refused, and the others."""

    read: Counter[str] = field(default_factory=Counter)
    refused: Counter[str] = field(default_factory=Counter)
    failures: list[Failure] = field(default_factory=list)


class TooLong(BaseException):
    """A reader that hangs; no reader may catch it."""


def limit_memory() -> None:
    """From here on this process gets no more than `MEMORY` beyond what it has; beyond it is a ``MemoryError``."""
    resource.setrlimit(resource.RLIMIT_DATA, (round(1e6 * memory("VmData")) + MEMORY, resource.RLIM_INFINITY))


def fuzz(readers: Sequence[Reader], indices: Sequence[int], *, seed: int = 0) -> Tally:
    """Read mutated inputs, and tally what became of them.

    Args:
        readers: which take turns.
        indices: of the inputs; with the seed an index says what is mutated, and how.
        seed: of all of them.
    """
    tally = Tally()
    before = signal.signal(signal.SIGVTALRM, _too_long)
    try:
        with tempfile.TemporaryDirectory(prefix="fuzz-") as scratch:
            for index in indices:
                _try(index, seed, Path(scratch), readers[index % len(readers)], tally)
    finally:
        signal.signal(signal.SIGVTALRM, before)
    return tally


def _try(index: int, seed: int, folder: Path, reader: Reader, tally: Tally) -> None:
    rng = np.random.default_rng((seed, index))
    names = sorted(reader.files)
    name = names[int(rng.integers(len(names)))]
    content, problem = mutated(reader.files[name], rng), ""
    with reader.written(folder, {name: content}) as path, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        signal.setitimer(signal.ITIMER_VIRTUAL, LONGEST)
        try:
            reader.read(path)
            tally.read[reader.name] += 1
        except MoteslamError as error:
            tally.refused[reader.name] += 1
            if len(str(error).splitlines()) != 1:
                problem = f"refused in {len(str(error).splitlines())} lines"
        except (Exception, TooLong) as error:
            problem = "".join(traceback.format_exception(error)[-4:])
        finally:
            signal.setitimer(signal.ITIMER_VIRTUAL, 0)
    if problem:
        tally.failures.append(Failure(reader.name, index, name, problem))


def _too_long(_number: int, _frame: FrameType | None) -> None:
    raise TooLong(f"over {LONGEST:g} s")


def measure(name: str, inputs: int, seed: int) -> Row:
    chosen = [reader for reader in readers() if reader.name == name]
    fuzz(chosen, range(2), seed=2**40)  # so that modules are loaded
    limit_memory()
    tally = fuzz(chosen, range(inputs), seed=seed)
    for failure in tally.failures:
        print(f"{name}, input {failure.number}, in {failure.file}:\n{failure.what}", file=sys.stderr)
    return {"read": tally.read[name], "refused": tally.refused[name], "failed": len(tally.failures)}


def main() -> int:
    known = [reader.name for reader in readers()]
    parser = arguments(__doc__)
    parser.add_argument("--inputs", type=count, default=2000, help="of all readers together")
    parser.add_argument("--readers", nargs="+", choices=known, default=known, metavar="NAME", help=", ".join(known))
    options = parser.parse_args()
    each = -(-options.inputs // len(options.readers))
    cases = [
        ({"run": name, "seed": seed, "inputs": str(each)}, (name, each, seed))
        for seed in options.seeds or range(1)
        for name in options.readers
    ]
    bars = dict.fromkeys(options.readers, (Bar("failed", "worst", 0.0),))
    return status(benchmark(measure, cases, options, bars=bars, fresh=True), bars)


if __name__ == "__main__":
    sys.exit(main())
