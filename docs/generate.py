"""Writes docs/reference/configuration.md from the configuration models: ``.venv/bin/python docs/generate.py``.

The text stands in the attribute docstrings of the models. A test compares the page with what this makes of them.
"""

from __future__ import annotations

import ast
import inspect
import json
import re
import sys
import textwrap
from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from moteslam.robot.values import LARGEST, SMALLEST
from moteslam.slam.backend.kinds import BACKENDS
from moteslam.slam.config import METHODS, ParticleFilterConfig, SlamConfig

PAGE = Path(__file__).parent / "reference" / "configuration.md"
BUNDLED = ("tsdf", "paper")
"""The methods whose keys are listed, that of the preset ``default`` first."""

HEAD = """# Configuration of a SLAM run

Generated from the models by `.venv/bin/python docs/generate.py`; [how to set keys](../guide/configure.md). Each key has
its default, the interval of its values, and what it is; `paper` is the default of that method where it differs. A run
takes the keys of its own method alone and refuses all others.
"""


def configuration() -> str:
    """Every key of a SLAM run: those of all methods, of the back end, of each method."""
    defaults = {name: METHODS[name].config.model_validate({}) for name in BUNDLED}
    default, paper = defaults.values()
    graph = BACKENDS["graph"].config.model_validate({})
    shared = {**SlamConfig.model_fields, **ParticleFilterConfig.model_fields}.keys() - {"backend"}
    lines = [
        HEAD,
        "## Of both methods",
        "",
        *_block(default, "", [k for k in type(default).model_fields if k in shared], paper),
    ]
    for name, config in defaults.items():
        lines += [f"## Of the method `{name}`", ""]
        lines += _block(config, "", [k for k in type(config).model_fields if k not in shared | {"backend"}])
    lines += ["## Of the method `known_map`", "", "The keys of `tsdf`, some with other defaults, and:", ""]
    known = METHODS["known_map"].config.model_validate({})
    lines += _block(known, "", [k for k in type(known).model_fields if k not in type(default).model_fields])
    lines += ["## Of the back end", ""]
    lines += [
        f"`backend.method` is `{graph.method}` with `tsdf`, `{paper.backend.method}` with `paper`. Of `graph`:",
        "",
    ]
    same = [name for name, value in graph if value == getattr(default, name, None)]
    lines += _block(graph, "backend", [key for key in type(graph).model_fields if key not in {*same, "method"}])
    lines += [
        f"{', '.join(f'`[backend.{name}]`' for name in same)}: the keys and defaults of the same sections of `tsdf`."
    ]
    return "\n".join(lines) + "\n"


def _block(config: BaseModel, section: str, keys: list[str], other: BaseModel | None = None) -> list[str]:
    """A TOML block a section, first of the keys that lie in none."""
    values = {key: getattr(config, key) for key in keys}
    lines = [_line(config, key, other) for key, value in values.items() if not isinstance(value, BaseModel)]
    if lines:
        lines = ["```toml", *([f"[{section}]"] if section else []), *lines, "```", ""]
    for key, value in values.items():
        if isinstance(value, BaseModel):
            inner = list(type(value).model_fields)
            lines += _block(value, f"{section}.{key}".lstrip("."), inner, getattr(other, key, None))
    return lines


def _line(config: BaseModel, key: str, other: BaseModel | None) -> str:
    """``key = default  # interval  what it is``, with the default of the other method where it differs."""
    value, field = getattr(config, key), type(config).model_fields[key]
    comment = [_allowed(field), _short(_meanings(type(config))[key])]
    if other is not None and getattr(other, key) != value:
        comment.insert(1, f"(`paper`: {_shown(getattr(other, key))})")
    return f"{key} = {_shown(value)}  # {'  '.join(filter(None, comment))}"


def _short(text: str) -> str:
    """A text up to its first full stop or colon, and its unit where that comes later."""
    text = " ".join(text.replace("``", "`").split())
    short = re.split(r"(?<!\.)[.:](?: |$)", text)[0]
    unit = re.search(r"\[[^\]]+\]", text)
    return short if unit is None or unit[0] in short else f"{short} {unit[0]}"


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
    """The words that a key takes, or the interval of its numbers; nothing where any number will do."""
    kind = field.annotation
    if get_origin(kind) is Literal:
        words = get_args(kind)
        return " | ".join(json.dumps(word) for word in words) if len(words) > 1 else ""
    if kind not in (int, float):
        return ""
    bounds = dict(_bounds(field))
    if bounds.get("ge") == SMALLEST:
        bounds["gt"] = 0
    low, high = bounds.get("gt", bounds.get("ge")), bounds.get("lt", bounds.get("le"))
    if low is None and high is None:
        return ""
    left = "(-inf" if low is None else f"{'(' if 'gt' in bounds else '['}{low:g}"
    right = "inf)" if high is None else f"{high:g}{')' if 'lt' in bounds else ']'}"
    return f"{left}, {right}"


def _bounds(field: FieldInfo) -> Iterator[tuple[str, float]]:
    for part in field.metadata:
        for name in ("ge", "gt", "le", "lt"):
            bound = getattr(part, name, None)
            if bound is not None and abs(bound) != LARGEST:  # every number's own
                yield name, bound


def _shown(value: Any) -> str:
    """A value as TOML."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(_shown, value))}]"
    if isinstance(value, float):
        return f"{value:.6g}" if value != round(value) or value >= 1e6 else f"{value:.1f}"
    return json.dumps(value)


def main() -> None:
    """Write the page."""
    PAGE.write_text(configuration(), encoding="utf-8")
    sys.stdout.write(f"{PAGE}\n")


if __name__ == "__main__":
    main()
