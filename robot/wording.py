"""The words of messages: what is wrong with a table or a type, as what was found and what was expected; and plurals."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from os import PathLike
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from moteslam.errors import InputError

Place = tuple[int | str, ...]
"""Where in a table something stands: keys, and indices of lists."""

_LONGEST = 40
"""Characters of a value that are shown."""
_SPANS = 3
"""As many times are given, others counted."""


def counted(count: int, what: str) -> str:
    """A number of things, ``1 frame`` and ``2 frames``."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def interval(first: str, last: str) -> str:
    """From the first to the last, ``2 to 3``; once where they are the same."""
    return first if first == last else f"{first} to {last}"


def when(spans: list[tuple[float, float]]) -> str:
    """Times [s] in words, ``from 2.00 to 3.00 s``; spans less than a second apart are one, and some are given."""
    joined = spans[:1]
    for begin, end in spans[1:]:
        if begin - joined[-1][1] < 1.0:
            joined[-1] = joined[-1][0], end
        else:
            joined.append((begin, end))
    first = ", ".join(f"{begin:.2f} to {end:.2f} s" for begin, end in joined[:_SPANS])
    return f"from {first}" + (f" and {len(joined) - _SPANS} times more" if len(joined) > _SPANS else "")


def expect_type(value: object, kind: type, field: str, hint: str = "") -> None:
    """Refuse a value of another type in words, where a mistake of the caller would end deep in NumPy.

    Args:
        value: what was given.
        kind: what it must be an instance of.
        field: name of the parameter.
        hint: how to come by one, for the message: ``open_recording(path) reads one``.

    Raises:
        InputError: it is of another type.
    """
    if not isinstance(value, kind):
        shown = f" {shortened(value)}" if isinstance(value, str | int | float) else ""
        kinds = f"{'an' if kind.__name__[0] in 'AEIO' else 'a'} {kind.__name__}"
        raise InputError(f"{type(value).__name__}{shown}, expected {kinds}{f': {hint}' if hint else ''}", field=field)


def expect_path(value: object, field: str, expected: str) -> None:
    """Refuse what is no path of a file.

    Raises:
        InputError: it is neither a text nor a path.
    """
    if not isinstance(value, str | PathLike):
        raise InputError(f"{type(value).__name__} {shortened(value)}, expected the path of {expected}", field=field)


def shortened(value: object) -> str:
    """A value as Python writes it, its middle left out where it is long."""
    text = repr(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


def first_complaint(
    error: ValidationError, whole: str, expected: Callable[[Place], str], *, kinds: Collection[str] = ()
) -> tuple[str, str]:
    """The field, with dots, and the problem of the first thing that is wrong.

    A key that is missing where another is unknown is most likely misspelt: the unknown one is named first.

    Args:
        error: of a model that the table was validated by.
        whole: what the table is, ``scenario``.
        expected: the keys that there are at a place.
        kinds: of the items of lists that may be one of several models (see `known_keys`); they are left out of fields.
    """

    def named(place: Place) -> str:
        shown = (part for i, part in enumerate(place) if not (part in kinds and i and isinstance(place[i - 1], int)))
        return ".".join(map(str, shown))

    errors = error.errors(include_url=False)
    first = errors[0]
    if first["type"].startswith("union_tag"):
        key = first["ctx"]["discriminator"].strip("'")
        given = first["input"].get(key) if isinstance(first["input"], dict) else None
        found = "missing" if given is None else shortened(given)
        return named((*first["loc"], key)), f"{found}, expected one of {', '.join(kinds)}"
    *parent, last = first["loc"] or ("",)
    beside = [other for other in errors if list(other["loc"][:-1]) == parent]
    if first["type"] == "missing" and isinstance(last, int):
        count = len(first["input"])
        return named(tuple(parent)), f"{counted(count, 'item')}, expected {count + len(beside)}"
    unknown = next((other for other in beside if other["type"] == "extra_forbidden"), None)
    if first["type"] == "missing" and unknown is not None:
        return named(unknown["loc"]), f"unknown key, {expected(tuple(parent))}; {named(first['loc'])} is missing"
    if first["type"] == "extra_forbidden":
        return named(first["loc"]), f"unknown key, {expected(tuple(parent))}"
    if first["type"] == "missing":
        table = ".".join(str(part) for part in parent if not isinstance(part, int))
        return named(first["loc"]), f"missing, expected in every {table or whole}"
    return named(first["loc"]), in_words(first)


def known_keys(model: type[BaseModel], place: Place) -> list[str]:
    """The keys of the table at a place in a model: within tables, lists of tables, and tables by name.

    An item of a list may be one of several models, each with a ``kind``: the place names it after the index.
    """
    named, models = 0, [model]
    for part in place:
        if isinstance(part, int) or named:  # an item of a list, or of a table by name
            named = max(0, named - 1)
            continue
        if len(models) > 1 and (chosen := [one for one in models if part in _kinds(one)]):
            models = chosen
            continue
        annotation: Any = models[0].model_fields[part].annotation
        named = _names(annotation)
        models = list(_models(annotation))
    return list(models[0].model_fields)


def _kinds(model: type[BaseModel]) -> tuple[str, ...]:
    """What the ``kind`` of a model may be; nothing where it has none."""
    kind = model.model_fields.get("kind")
    return get_args(kind.annotation) if kind is not None and get_origin(kind.annotation) is Literal else ()


def _names(kind: Any) -> int:
    """How many names lead to a model: 2 in a table by name of tables by name."""
    return 1 + _names(get_args(kind)[1]) if get_origin(kind) is dict else 0


def _models(kind: Any) -> Iterator[type[BaseModel]]:
    """The models within a type."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        yield kind
    for part in get_args(kind):
        yield from _models(part)


_PLAIN = {
    "bool_type": "true or false",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "string_type": "a text",
    "model_type": "a table",
    "model_attributes_type": "a table",
    "dict_type": "a table",
    "tuple_type": "a list",
    "list_type": "a list",
}
"""What was expected, by pydantic's kind of an error."""
_BOUNDS = {
    "greater_than_equal": "at least",
    "greater_than": "above",
    "less_than_equal": "at most",
    "less_than": "below",
}
"""The same of bounds."""


def in_words(error: ErrorDetails) -> str:
    """An error of pydantic as what was found and what was expected."""
    kind, context = error["type"], error.get("ctx", {})
    found = shortened(error["input"])
    if kind in _PLAIN:
        return f"{found}, expected {_PLAIN[kind]}"
    if kind in _BOUNDS:
        return f"{found}, expected {_BOUNDS[kind]} {_number(next(iter(context.values())))}"
    if kind in ("too_short", "too_long"):
        return f"{counted(context['actual_length'], 'item')}, expected {_bound(context)}"
    if kind in ("string_too_short", "string_too_long"):
        return f"{counted(len(error['input']), 'character')}, expected {_bound(context)}"
    said = error["msg"].removeprefix("Value error, ")
    if said.startswith("Input should "):
        return f"{found}, expected {said.removeprefix('Input should ').removeprefix('be ')}"
    return said


def _number(value: float) -> str:
    """A bound as it is written: whole numbers in full."""
    return str(value) if isinstance(value, int) else f"{value:g}"


def _bound(context: dict[str, Any]) -> str:
    return f"at least {context['min_length']}" if "min_length" in context else f"at most {context['max_length']}"
