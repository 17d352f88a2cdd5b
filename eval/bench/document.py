"""The result of a bench as a JSON document to share: no name of a host, a user or a folder is in it."""

from __future__ import annotations

import json
from os import PathLike
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import AllowInfNan, Field, Strict, ValidationError

from moteslam.errors import InputError
from moteslam.robot.files import write_atomically
from moteslam.robot.reading import read_text
from moteslam.robot.section import LARGEST, NotNegative, Number, Section, Truth, Whole
from moteslam.robot.wording import Place, first_complaint, known_keys

FORMAT: Final = "moteslam bench"
"""What a document calls itself."""
VERSION: Final = 1
"""Of its keys."""
MAX_BYTES = 4_000_000
EXPECTED = "a result of `moteslam bench`"

Count = Annotated[Whole, Field(ge=1)]
Seconds = Annotated[float, Strict(), AllowInfNan(False), Field(gt=0, le=LARGEST)]
Threads = Annotated[str, Field(pattern=r"^[1-9][0-9]{0,3}$")]
"""A number of threads, which JSON has as a text where it is a key."""


class Spread(Section):
    """What a unit of work takes [s], over all turns of all processes."""

    median: Seconds
    """Of the medians of the processes."""
    low_quartile: Seconds
    high_quartile: Seconds
    least: Seconds
    most: Seconds
    rounds: Annotated[tuple[Seconds, ...], Field(min_length=1)]
    """The median of each process."""


class Figure(Section):
    """What a unit of a contender's work takes."""

    wall: Spread
    """By the clock [s]."""
    processor: Spread
    """Of all threads together [s]."""


class Ratio(Section):
    """A ratio of two times that were taken in turns: median, least and most of the rounds."""

    median: Seconds
    least: Seconds
    most: Seconds


class TaskResult(Section):
    """A task: its times, or why there are none."""

    title: str
    """For people."""
    unit: str
    """What one of takes so long."""
    serial: Truth = False
    """Whether it uses one thread on purpose."""
    facts: dict[str, Number] = Field(default_factory=dict)
    """What is known of the work: `lookups` and `bytes` a unit, `recorded` seconds of a drive, `ate` [m]."""
    times: dict[Threads, dict[str, Figure]] = Field(default_factory=dict)
    """By number of threads, then by contender: `moteslam`, `c`, and those of others."""
    speed: dict[Threads, Ratio] = Field(default_factory=dict)
    """By number of threads: the time of the C loop over that of moteslam, above 1 where moteslam is faster."""
    gain: dict[Threads, Ratio] = Field(default_factory=dict)
    """By number of threads: moteslam's time on the least number of threads over that on the larger."""
    error: str = ""


class PeerResult(Section):
    """A SLAM as a command over the drive of the runs: the whole process, its start included."""

    version: str = ""
    """Of the command, as its specification gives it."""
    processor: Spread | None = None
    """Of the process and those that it began, a scan [s]."""
    ate: NotNegative | None = None
    """ATE RMSE of its trajectory, aligned [m]."""
    error: str = ""


class Compiler(Section):
    """What compiled the C loops, or why there are none."""

    name: str = ""
    flags: tuple[str, ...] = ()
    absent: str = ""


class BenchResult(Section):
    """The whole document."""

    format: Literal["moteslam bench"] = FORMAT
    format_version: Literal[1] = VERSION
    workload: Count
    """The version of the tasks; those of different versions are not compared."""
    quick: Truth
    """Whether it was a trial with few turns."""
    date: str
    versions: dict[str, str]
    hardware: dict[str, str]
    compiler: Compiler
    load: NotNegative | None
    """Processors that other programs kept busy before the start."""
    threads: Annotated[tuple[Count, ...], Field(min_length=1)]
    rounds: Count
    """Processes for each number of threads."""
    tasks: dict[str, TaskResult]
    peers: dict[str, PeerResult] = Field(default_factory=dict)
    warnings: tuple[str, ...] = ()


def write_result(path: str | PathLike[str], result: BenchResult) -> None:
    """Write a document.

    Raises:
        OutputError: it cannot be written.
    """
    write_atomically(path, json.dumps(result.model_dump(mode="json"), indent=1) + "\n")


def read_result(path: str | PathLike[str]) -> BenchResult:
    """Read a document.

    Raises:
        InputError: it cannot be read, is none, or of another version, or has times on other threads than it says; file
            and field are named.
    """
    path = Path(path)
    text = read_text(path, EXPECTED, limit=MAX_BYTES)
    try:
        table = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"not JSON, expected {EXPECTED}", file=path) from error
    if not isinstance(table, dict) or table.get("format") != FORMAT:
        raise InputError(f"no such document, expected {EXPECTED}", file=path)
    if table.get("format_version") != VERSION:
        problem = f"{table.get('format_version')!r}, expected {VERSION}: it is of another version of moteslam"
        raise InputError(problem, file=path, field="format_version")
    try:
        result = BenchResult.model_validate(table)
    except ValidationError as error:
        field, problem = first_complaint(error, "result", _expected)
        raise InputError(problem, file=path, field=field) from error
    for name, task in result.tasks.items():
        for key in ("times", "speed", "gain"):
            for count in getattr(task, key):
                if int(count) not in result.threads:
                    problem = f"{count}, expected one of {', '.join(map(str, result.threads))} as in threads"
                    raise InputError(problem, file=path, field=f"tasks.{name}.{key}")
    return result


def _expected(place: Place) -> str:
    return f"expected one of {', '.join(known_keys(BenchResult, place))}"
