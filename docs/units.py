"""How `make docs` reads the docstrings of the package."""

from typing import Any

import griffe


class Units(griffe.Extension):
    """A shape and a unit after each other, `[n, 3] [m]`, are no link of Markdown."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Escape the unit."""
        if obj.docstring is not None:
            obj.docstring.value = obj.docstring.value.replace("] [", "] \\[")
