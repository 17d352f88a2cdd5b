"""Mutated inputs for every reader: each is read, or refused in one line, within bounds of time and memory.

    python benchmarks/fuzz.py --inputs 100000 --out result.json
    python benchmarks/fuzz.py --readers carmen ucsd --inputs 5000 --seed 3 --keep failures

An input is a file that the project has written itself, with bits, bytes, words, lines or members of an archive changed,
dropped or repeated. Whatever raises anything but the project's own error of one line, takes more than 10 s, or more
than 1 GB, is a failure; --keep writes these inputs into a folder.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from parts.fuzzing import Failure, Tally, fuzz, limit_memory
from parts.machine import save, stamp
from parts.options import count, folder, result_file
from parts.readers import Reader, readers

BATCH = 500


def chosen(names: list[str] | None) -> tuple[Reader, ...]:
    """The readers of these names, all where none is named."""
    return tuple(reader for reader in readers() if not names or reader.name in names)


def batch(names: list[str] | None, first: int, last: int, seed: int) -> Tally:
    """The inputs from one index to another, in a process of a pool."""
    return fuzz(chosen(names), range(first, last), seed=seed)


def start(names: list[str] | None) -> None:
    """Read what can be read once, so that modules are loaded, then limit the memory."""
    fuzz(chosen(names), range(2 * len(chosen(names))), seed=2**40)
    limit_memory()


def main() -> None:
    known = [reader.name for reader in readers()]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=count, default=2000)
    parser.add_argument("--readers", nargs="+", choices=known, metavar="NAME", help=", ".join(known))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=count, default=2, help="processes; 2")
    parser.add_argument("--keep", type=folder, help="folder for the inputs that fail")
    parser.add_argument("--out", type=result_file)
    options = parser.parse_args()
    total = Tally()
    with ProcessPoolExecutor(
        options.workers, mp_context=get_context("spawn"), initializer=start, initargs=(options.readers,)
    ) as pool:
        batches = range(0, options.inputs, BATCH)
        jobs = [
            pool.submit(batch, options.readers, first, min(first + BATCH, options.inputs), options.seed)
            for first in batches
        ]
        for done, job in enumerate(jobs, start=1):
            total.add(job.result())
            print(f"\r{min(done * BATCH, options.inputs)} inputs, {len(total.failures)} failures", end="", flush=True)
    print()
    failed = Counter(failure.reader for failure in total.failures)
    for name in options.readers or known:
        print(f"{name:<16}  read {total.read[name]:6d}  refused {total.refused[name]:6d}  failed {failed[name]:6d}")
    for failure in total.failures:
        if options.keep is not None:
            kept = options.keep / f"{failure.reader}-{failure.index}-{Path(failure.file).name}"
            kept.write_bytes(failure.content)
    for what, (failure, *more) in grouped(total).items():
        print(f"\n{failure.reader}, input {failure.index} of {len(more) + 1}, in {failure.file}:\n{what}")
    save(
        options.out,
        {
            **stamp(),
            "inputs": options.inputs,
            "seed": options.seed,
            "readers": {
                name: {"read": total.read[name], "refused": total.refused[name], "failed": failed[name]}
                for name in options.readers or known
            },
        },
    )
    sys.exit(1 if total.failures else 0)


def grouped(tally: Tally) -> dict[str, list[Failure]]:
    """The failures by the place that they fail at."""
    groups: dict[str, list[Failure]] = {}
    for failure in tally.failures:
        groups.setdefault(failure.what, []).append(failure)
    return groups


if __name__ == "__main__":
    main()
