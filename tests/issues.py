"""What issues say: the lines that they print, or their codes and counts."""

from collections.abc import Iterable

from moteslam.robot.values import Issue


def messages(issues: Iterable[Issue]) -> tuple[str, ...]:
    return tuple(map(str, issues))


def counted(issues: Iterable[Issue]) -> list[tuple[str, int]]:
    """The code of each, and how often."""
    return [(issue.code, issue.count) for issue in issues]
