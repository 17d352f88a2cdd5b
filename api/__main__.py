"""The program ``moteslam``, and ``python -m moteslam``: the way in, which a Ctrl-C may meet before all is read."""

from moteslam.eval.cli.interrupt import leave_at_once


def main() -> None:
    """Run the program and leave with its exit code."""
    leave_at_once()
    from moteslam.eval.cli.main import main as run

    run()


if __name__ == "__main__":
    main()
