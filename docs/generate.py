"""Writes docs/reference/configuration.md from the configuration models: ``.venv/bin/python docs/generate.py``.

The text stands in the attribute docstrings of the models. A test compares the page with what this makes of them.
"""

from __future__ import annotations

import ast
import inspect
import sys
import textwrap
from collections.abc import Iterable, Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from moteslam.robot.tables import LARGEST, SMALLEST
from moteslam.slam.backend.kinds import BACKENDS
from moteslam.slam.backend.protocol import BackendConfig
from moteslam.slam.config import METHODS, ParticleFilterConfig, SlamConfig

PAGE = Path(__file__).parent / "reference" / "configuration.md"
BUNDLED = ("tsdf", "paper")
"""The methods whose keys are listed."""


def configuration() -> str:
    """Every key of a SLAM run, by method."""
    models = {name: METHODS[name].config for name in BUNDLED}
    defaults = {name: model.model_validate({}) for name, model in models.items()}
    lines = [
        "# Configuration of a SLAM run",
        "",
        "Generated from the models by `.venv/bin/python docs/generate.py`. How to set keys: "
        "[the guide](../guide/configure.md). A run's `config.toml` holds the keys of its own method; every other key "
        "is refused. Columns named by a method give its default, which is the value of its preset.",
        "",
    ]
    shared = {**SlamConfig.model_fields, **ParticleFilterConfig.model_fields}
    del shared["backend"]
    lines += ["## Keys of both methods", ""]
    lines += _table(
        ["key", *(f"`{name}`" for name in BUNDLED), "allowed", "meaning"],
        _rows(ParticleFilterConfig, shared, defaults.values()),
    )
    lines += ["", "## The back end", "", "Another back end than a preset's has keys of its own alone.", ""]
    lines += _table(
        ["key", *(f"`{name}`" for name in BUNDLED), "allowed", "meaning"],
        [
            [
                "`backend.method`",
                *(f"`{config.backend.method}`" for config in defaults.values()),
                ", ".join(f"`{kind}`" for kind in BACKENDS.names()),
                _paragraph(_meanings(BackendConfig)["method"]),
            ]
        ],
    )
    graph = BACKENDS["graph"].config
    lines += ["", "### Keys of the back end `graph`", "", _paragraph(graph.__doc__), ""]
    fields = {key: field for key, field in graph.model_fields.items() if key != "method"}
    rows = _rows(graph, fields, [graph.model_validate({})])
    lines += _table(
        ["key", "default", "allowed", "meaning"], [[f"`backend.{row[0].strip('`')}`", *row[1:]] for row in rows]
    )
    for name in BUNDLED:
        own = {key: field for key, field in models[name].model_fields.items() if key not in shared and key != "backend"}
        lines += ["", f"## Keys of the method `{name}`", ""]
        for key, field in own.items():
            section = field.annotation
            assert isinstance(section, type)
            assert issubclass(section, BaseModel)
            lines += [f"### `{key}`", "", _paragraph(section.__doc__), ""]
            lines += _table(
                ["key", "default", "allowed", "meaning"], _rows(models[name], {key: field}, [defaults[name]])
            )
            lines.append("")
    return "\n".join(lines).rstrip() + "\n"


def _rows(model: type, fields: dict[str, FieldInfo], configs: Iterable[BaseModel]) -> Iterator[list[str]]:
    """A row a key: its dotted name, the values in the configurations, what is allowed, what it means."""
    configs = list(configs)
    for key, field in fields.items():
        values = [getattr(config, key) for config in configs]
        if all(isinstance(value, BaseModel) for value in values):
            inner = type(values[0]).model_fields
            for row in _rows(type(values[0]), inner, values):
                yield [f"`{key}.{row[0].strip('`')}`", *row[1:]]
        else:
            if type(configs[0]).model_fields[key].annotation != field.annotation:
                allowed = ", ".join(f"`{value}`" for value in values)
            else:
                allowed = _allowed(field)
            yield [
                f"`{key}`",
                *(_shown(value) for value in values),
                allowed,
                _paragraph(_meanings(model)[key]),
            ]


@cache
def _meanings(model: type) -> dict[str, str]:
    """The docstrings below a model's attributes, and those of its bases."""
    meanings: dict[str, str] = {}
    for base in reversed(model.__mro__):
        if not base.__module__.startswith("moteslam."):
            continue
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(base))).body
        assert isinstance(tree, ast.ClassDef)
        for attribute, text in pairwise(tree.body):
            match attribute, text:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(meaning))):
                    meanings[name] = inspect.cleandoc(meaning)
    return meanings


def _allowed(field: FieldInfo) -> str:
    """What values a key takes, in words."""
    kind = field.annotation
    if get_origin(kind) is Literal:
        return ", ".join(f"`{choice}`" for choice in get_args(kind))
    if kind is bool:
        return "`true`, `false`"
    bounds = {
        name: getattr(part, name)
        for part in field.metadata
        for name in ("ge", "gt", "le", "lt")
        if getattr(part, name, None) is not None
    }
    if bounds.get("ge") == SMALLEST:
        bounds = {"gt": 0, **{name: bound for name, bound in bounds.items() if name != "ge"}}
    bounds = {name: bound for name, bound in bounds.items() if abs(bound) != LARGEST}  # every number's own
    words = []
    if "ge" in bounds and "le" in bounds:
        words.append(f"{_shown(bounds['ge'])} to {_shown(bounds['le'])}")
    else:
        for name, text in (("gt", "above"), ("ge", "at least"), ("lt", "below"), ("le", "at most")):
            if name in bounds:
                words.append(f"{text} {_shown(bounds[name])}")
    number = {int: "whole number", float: "number", str: "text"}.get(kind, "numbers")  # type: ignore[arg-type]
    return " ".join([number, ", ".join(words)]).strip()


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, tuple):
        return ", ".join(f"{item:g}" for item in value)
    if isinstance(value, float):
        return f"{value:g}".replace("e+0", "e").replace("e-0", "e-")
    return f"{value}" if isinstance(value, int) else f"`{value}`"


def _table(head: list[str], rows: Iterable[list[str]]) -> list[str]:
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    return lines + [f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |" for row in rows]


def _paragraph(text: str | None) -> str:
    """Text in one line, Markdown's backticks for those of reStructuredText."""
    return " ".join((text or "").replace("``", "`").split())


def main() -> None:
    """Write the page."""
    PAGE.write_text(configuration(), encoding="utf-8")
    sys.stdout.write(f"{PAGE}\n")


if __name__ == "__main__":
    main()
