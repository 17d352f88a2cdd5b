"""The exceptions of moteslam: each names the file, the field and what was expected.

The command line prints ``str(error)`` as one line and exits with code 2; no traceback reaches a user.
"""

import inspect
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from difflib import get_close_matches
from os import PathLike
from typing import Any, get_args

File = str | PathLike[str]

MOST_KEYS, NEAREST, LONGEST = 24, 3, 60
"""Of a table with more keys than the first so many are named; characters of a list that is shown."""


BOUNDS = {"greater_than": "more than", "greater_than_equal": "at least"}
BOUNDS |= {"less_than": "less than", "less_than_equal": "at most"}
PLAIN = {
    r"^Field required$": "missing",
    r"^(Input should be|\w+ should have) ": "expected ",
    r" after validation, not .*": "",
    "a valid integer": "a whole number",
    "a valid boolean": "true or false",
    "a valid (tuple|list)": "a list",
    "a valid dictionary.*": "a table",
    "a valid ": "a ",
}
"""What pydantic says, in words of tables."""
LEAST = 1e-9  # A bound as small stands for 0
UNIT = r"\[((?:m|s|rad|Hz|deg|kg|N)\b[^\]]*)\]"


class MoteslamError(Exception):
    """What is wrong with an input, in one line: ``problem``, what was found and expected, without a full stop.

    ``field`` is the array, key or option within the file or folder, ``line`` that of a text file from 1 on.
    """

    def __init__(
        self, problem: str, *, file: File | None = None, field: str | None = None, line: int | None = None
    ) -> None:
        self.problem = problem
        self.file = None if file is None else str(file)
        self.field = field
        self.line = line
        place = self.file or ""
        if line is not None:
            place += f":{line}" if place else f"line {line}"
        message = ": ".join(part for part in (place, field, problem) if part)
        super().__init__("\\n".join(message.splitlines()))  # names from files may hold line breaks


class InputError(MoteslamError):
    """A recording, map, trajectory or folder that cannot be read as what it should be."""


class ConfigError(MoteslamError):
    """A configuration, scenario or platform with an unknown key or a value out of bounds."""


class OutputError(MoteslamError):
    """A result that cannot be written: the folder exists, is read-only, or the disk is full."""


class ExistsError(OutputError):
    """A target that exists already, where it was not asked to replace it."""


class MoteslamWarning(UserWarning):
    """Something that a user should know of and that stops nothing, in one line; the command line prints it."""


class BackendError(MoteslamError):
    """Taichi cannot run on the backend asked for."""


@contextmanager
def in_file(file: File) -> Iterator[None]:
    """Errors of the block that name neither file nor option name this file, as the user wrote it."""
    try:
        yield
    except MoteslamError as error:
        if error.file is not None or (error.field or "").startswith("--"):
            raise
        raise type(error)(error.problem, file=file, field=error.field) from error


def explained(complaint: Mapping[str, Any], model: Any) -> str:
    """A complaint of pydantic about a model, or one that is not known: with the keys of the table, or as a list."""
    kind, place, value = complaint["type"], complaint["loc"], complaint["input"]
    if kind == "extra_forbidden":
        return "unknown key" + ("" if model is None else f", expected one of {_keys(model, place)}")
    if kind == "model_type" and model is not None:
        return f"expected a table of {_keys(model, (*place, ''))}"
    if kind == "tuple_type":
        listed = repr(value.split() if isinstance(value, str) else [value])
        return f"expected a list{f': {listed}' if len(listed) <= LONGEST else ''}"
    if kind in BOUNDS:
        (bound,) = complaint["ctx"].values()
        least = "more than 0" if 0 < bound <= LEAST else f"{BOUNDS[kind]} {bound:.6g}"
        return f"expected {least}{'' if model is None else unit_of(model, place)}"
    if kind == "string_pattern_mismatch":
        return re.sub(r"[\^$\\]", "", f"expected {complaint['ctx']['pattern']}").replace(".+", "NAME")
    text = str(complaint["msg"]).removeprefix("Value error, ")
    for theirs, ours in PLAIN.items():
        text = re.sub(theirs, ours, text)
    return text


def unit_of(model: Any, place: Sequence[str | int]) -> str:
    """The unit of a key, ``" m"``, which the comment beside or above it in the source of its model has in brackets."""
    names = [part for part in place if isinstance(part, str)]
    if not names:
        return ""
    line = re.compile(rf"((?:^    #.*\n)*)^    {re.escape(names[-1])}: [^#\n]*(.*)", re.MULTILINE)
    for base in (base for one in _models(model, names) for base in one.__mro__):
        with suppress(OSError, TypeError):  # no source
            if found := line.search(inspect.getsource(base)):
                unit = re.search(UNIT, found[2] or found[1])
                return f" {unit[1]}" if unit else ""
    return ""


def _keys(model: Any, place: Sequence[str | int]) -> str:
    """The keys of the table in which a place of a pydantic model lies, those most like its last part first."""
    keys = list(dict.fromkeys(key for one in _models(model, place) for key in one.model_fields))
    near = get_close_matches(str(place[-1]), keys, n=max(len(keys), 1), cutoff=0.0)
    return ", ".join(near if len(near) <= MOST_KEYS else [*near[:NEAREST], "..."])


def _models(model: Any, place: Sequence[str | int]) -> list[Any]:
    """The models of the table in which a place of a pydantic model lies."""
    models = [model]
    for part in place[:-1]:
        below = [
            each for one in models if part in one.model_fields for each in _within(one.model_fields[part].annotation)
        ]
        of_kind = [one for one in models if any(field.default == part for field in one.model_fields.values())]
        models = below or of_kind or models
    return models


def _within(kind: Any) -> list[Any]:
    """The models in an annotation."""
    return (
        [kind]
        if isinstance(kind, type) and hasattr(kind, "model_fields")
        else [each for one in get_args(kind) for each in _within(one)]
    )
