"""Commands that have commands of their own."""

from __future__ import annotations

from typing import Any

from typer.core import TyperGroup

HELP = ("--help", "-h")


class RunByDefault(TyperGroup):
    """``sweep SPEC.toml`` is ``sweep run SPEC.toml``; without arguments it is ``run``, too, unless these give help."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put ``run`` before what is no command."""
        given = not self.no_args_is_help if not args else args[0] not in (*self.commands, *HELP)
        return super().parse_args(ctx, ["run", *args] if given else args)
