"""The program ``moteslam``, and ``python -m moteslam``: the way in, which a Ctrl-C may meet before all is read."""

import os
import sys

from moteslam.eval.cli.interrupt import leave_at_once, leave_with


def main() -> None:
    """Run the program and leave with its exit code: 0, 2 for bad input, 130 for Ctrl-C, 1 for a fault of ours."""
    leave_at_once()
    # before NumPy is imported: all its matrices here are small, and threads that wait for larger ones cost time too
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from moteslam.eval.cli.main import run

    code = run(sys.argv[1:])
    leave_with(code)
    sys.exit(code)


if __name__ == "__main__":
    main()
