"""What the command lines of the benchmarks take: numbers within their bounds, seeds, and where results go."""

from __future__ import annotations

import argparse
import math
import os
import re
from contextlib import suppress
from pathlib import Path


def seeds(text: str) -> range:
    """``5`` is the seeds 0 to 4, ``5-9`` those from 5 to 9."""
    match = re.fullmatch(r"(?:(\d+)-)?(\d+)", text)
    first, last = match.groups() if match else (None, "0")
    asked = range(int(last)) if first is None else range(int(first), int(last) + 1)
    if not asked:
        raise argparse.ArgumentTypeError(f"{text!r}, expected a number of seeds, or the first and the last: 10-19")
    return asked


def count(text: str) -> int:
    """A number of one or more."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r}, expected 1 or more")
    return int(text)


def factor(text: str) -> float:
    """A finite number that is not negative."""
    with suppress(ValueError):
        if 0 <= float(text) < math.inf:
            return float(text)
    raise argparse.ArgumentTypeError(f"{text!r}, expected a number from 0")


def result_file(text: str) -> Path:
    """A file that can be written, checked before anything is measured; the folders above it are made."""
    path = Path(text)
    if path.is_dir():
        raise argparse.ArgumentTypeError(f"{text!r} is a folder, expected a file")
    folder(str(path.parent))
    return path


def folder(text: str) -> Path:
    """A folder that can be written to, made where it is missing."""
    path = Path(text)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise argparse.ArgumentTypeError(f"{text!r}: {error.strerror}, expected a folder to write to") from error
    if not os.access(path, os.W_OK):
        raise argparse.ArgumentTypeError(f"{text!r}: not to be written to")
    return path
