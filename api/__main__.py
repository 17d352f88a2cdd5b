"""``python -m moteslam`` is the program ``moteslam``."""

from moteslam.eval.cli.main import main

if __name__ == "__main__":
    main()
