"""The lines that issues print."""

from collections.abc import Iterable

from moteslam.robot.values import Issue


def messages(issues: Iterable[Issue]) -> tuple[str, ...]:
    """The line of each."""
    return tuple(map(str, issues))
