"""The plain C loops: compiled by whatever C compiler there is, and called as functions."""

from __future__ import annotations

import ctypes
import os
import re
import shlex
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from moteslam.errors import InputError
from moteslam.eval.sweep.program import first_line, run_program

SOURCES = tuple(Path(__file__).with_name(name) for name in ("loops.c", "maps.c"))
COMPILERS = ("gcc", "clang", "cc")
"""Looked for in this order, where the environment names none as ``CC``."""
FLAGS = ("-O3", "-ffast-math")
OPENMP, NATIVE = "-fopenmp", "-march=native"
"""Flags that some compilers do not know; they are left out then."""


@dataclass(frozen=True)
class Compiled:
    """What became of the C loops.

    Attributes:
        library: the compiled functions; None where there is no compiler that can make them.
        compiler: its name and version as it prints them.
        flags: that they were compiled with.
        absent: why there is no library, in one line.
    """

    library: Path | None
    compiler: str = ""
    flags: tuple[str, ...] = ()
    absent: str = ""

    @property
    def openmp(self) -> bool:
        """Whether the loops run on several threads."""
        return OPENMP in self.flags


def compile_loops(folder: Path) -> Compiled:
    """Compile the C functions into a folder, with every flag that the compiler knows."""
    command, absent = _compiler()
    if not command:
        return Compiled(None, absent=absent)
    library, problem = folder / "loops.so", ""
    for more in product((NATIVE, ""), (OPENMP, "")):
        flags = (*FLAGS, *filter(None, more))
        objects = [str(folder / f"{source.stem}.o") for source in SOURCES]
        # -ffast-math is left out of the link: the library, once loaded, would have the whole process take its smallest
        # numbers for 0
        link = [*command, *(flag for flag in flags if flag == OPENMP), "-shared", *objects, "-o", str(library), "-lm"]
        try:
            for source, target in zip(SOURCES, objects, strict=True):
                run_program([*command, *flags, "-fPIC", "-c", str(source), "-o", target])
            run_program(link)
            ctypes.CDLL(str(library))
        except (InputError, OSError) as error:  # OSError: it cannot be loaded from there
            problem = problem or without_folders(getattr(error, "problem", str(error)))
            continue
        return Compiled(library, _version(command), flags)
    return Compiled(None, absent=f"the C compiler {Path(command[0]).name} {problem}")


def _compiler() -> tuple[list[str], str]:
    """The words that call the C compiler; or none, and why."""
    given = os.environ.get("CC", "")
    try:
        words = shlex.split(given)
    except ValueError:
        words = [given]
    if words:
        found = shutil.which(words[0])
        return ([found, *words[1:]], "") if found else ([], f"no program of the name in CC, {Path(words[0]).name}")
    found = next(filter(None, map(shutil.which, COMPILERS)), None)
    return ([found], "") if found else ([], f"no C compiler: none of {', '.join(COMPILERS)} is there")


def _version(command: list[str]) -> str:
    try:
        return without_folders(first_line([*command, "--version"]))
    except InputError:
        return Path(command[0]).name


def without_folders(text: str) -> str:
    """A text with paths cut down to their last part: what is shared says nothing of where things lie."""
    return re.sub(r"(?<![\w.])(?:[A-Za-z]:)?[\\/](?:[^\s'\":,;\\/]+[\\/])+", "", text)


class Loops:
    """The C functions of a library.

    Args:
        library: as ``compile_loops`` made it.
        openmp: whether it runs on several threads.
    """

    def __init__(self, library: Path, *, openmp: bool) -> None:
        self._library = ctypes.CDLL(str(library))
        self.openmp = openmp

    def bind(self, name: str, *arguments: Any) -> Callable[[], int]:
        """A call of the function of that name: arrays are handed over as their addresses, floats as such."""
        for argument in arguments:
            assert not hasattr(argument, "flags") or argument.flags.c_contiguous, name
        function, converted = getattr(self._library, name), [_converted(argument) for argument in arguments]

        def call() -> int:
            result: int = function(*converted)
            return result

        call.__dict__["arguments"] = arguments  # the arrays live as long as the call
        return call


def _converted(argument: Any) -> Any:
    if isinstance(argument, float):
        return ctypes.c_float(argument)
    return ctypes.c_void_p(argument.ctypes.data) if hasattr(argument, "ctypes") else argument
