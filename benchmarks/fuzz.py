"""Mutated inputs for every reader: each is read, or refused in one line, within bounds of time and memory.

    python benchmarks/fuzz.py --inputs 100000 --out fuzz.csv
    python benchmarks/fuzz.py --readers carmen ucsd --inputs 5000 --seeds 3-3

An input is a file that the project has written itself, with bits, bytes, words, lines or members of an archive changed,
dropped or repeated. Whatever raises anything but the project's own error of one line, takes more than 10 s, or more
than 1 GB, is a failure.
"""

import sys

from parts.fuzzing import fuzz, limit_memory
from parts.harness import Bar, Row, arguments, benchmark, count, status
from parts.readers import readers


def measure(name: str, inputs: int, seed: int) -> Row:
    """What became of the inputs of one reader."""
    chosen = [reader for reader in readers() if reader.name == name]
    fuzz(chosen, range(2), seed=2**40)  # so that modules are loaded
    limit_memory()
    tally = fuzz(chosen, range(inputs), seed=seed)
    for failure in tally.failures:
        print(f"{name}, input {failure.number}, in {failure.file}:\n{failure.what}", file=sys.stderr)
    return {"read": tally.read[name], "refused": tally.refused[name], "failed": len(tally.failures)}


def main() -> int:
    """Read, and print how many inputs were read, refused and failed; 1 where one failed."""
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
