"""YAML from elsewhere: plain values alone, of a bounded text, without aliases."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from moteslam.errors import InputError
from moteslam.robot.reading import read_text


def read_yaml(path: Path, expected: str, *, limit: int) -> Any:
    """What a YAML file holds: tables, lists, texts and numbers, no objects.

    An alias repeats what an anchor names; ten lines of them stand for a list of a thousand million values, and no
    program that writes maps or bags uses them: they are refused.

    Args:
        path: of the file.
        expected: what it should be, for messages: ``a map_server .yaml file``.
        limit: of its size [bytes].

    Raises:
        InputError: it cannot be read, is larger, is not YAML, or has an alias.
    """
    import yaml

    class Loader(yaml.SafeLoader):
        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                raise yaml.YAMLError(f"an alias, *{self.peek_event().anchor[:20]}; expected the value itself")  # type: ignore[no-untyped-call]
            return super().compose_node(parent, index)

    text = read_text(path, expected, limit=limit)
    try:
        return yaml.load(text, Loader)
    except RecursionError as error:
        raise InputError("not YAML: nested too deep", file=path) from error
    except (yaml.YAMLError, ValueError) as error:
        problem = " ".join(str(error).splitlines()[:1])
        raise InputError(f"not YAML: {problem[:200]}", file=path) from error
