"""``moteslam scenarios``: what can be simulated."""

from __future__ import annotations

from moteslam.eval.cli import options
from moteslam.eval.cli.text import literal, say, say_json, table


def scenarios(as_json: options.Json = False) -> None:
    """List the bundled scenarios.

    \b
    Examples:
      moteslam scenarios
      moteslam scenarios --json
    """  # noqa: D301
    from moteslam.sim.scenario import bundled_scenarios

    bundled = bundled_scenarios()
    if as_json:
        say_json(bundled)
        return
    say(table([(name, literal(description)) for name, description in bundled.items()]))
