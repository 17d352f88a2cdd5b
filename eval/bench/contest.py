"""A task of the bench: who does the same work, how it is checked that it is the same, and what is known of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from moteslam.eval.bench.loops import Loops

OURS, C = "moteslam", "c"
"""The names of the two contenders that ratios are taken of; others are named after their package."""


class Disagreement(Exception):  # noqa: N818 - it is a finding, no fault of the program
    """Two contenders of a task do not give the same result: their times are of different work."""


class Contender(NamedTuple):
    """Who does the work.

    Attributes:
        call: does it once.
        work: how much of it, in the task's unit.
    """

    call: Callable[[], Any]
    work: float


@dataclass(frozen=True)
class Contest:
    """A task in one process, ready to be timed.

    Attributes:
        contenders: by name.
        check: raises ``Disagreement`` where they do not give the same; called once before any is timed.
        facts: what is known of the work: ``lookups`` and ``bytes`` (read and written, in whole cache lines) a unit,
            and figures of the task's own. Those that follow from the result are computed by ``after``.
        after: facts that are known once it was run, computed when all is timed.
    """

    contenders: Mapping[str, Contender]
    check: Callable[[], None] = lambda: None
    facts: Mapping[str, float] = field(default_factory=dict)
    after: Callable[[], Mapping[str, float]] = dict


@dataclass(frozen=True)
class Task:
    """What is measured.

    Attributes:
        title: for people, a few words.
        unit: of work: ``scan``, ``ray``, of which one takes so long.
        prepare: makes the contest of a number of threads; ``Loops`` are the C functions, None without.
        serial: uses one thread on purpose, so no gain is asked of a second.
    """

    title: str
    unit: str
    prepare: Callable[[Loops | None, int], Contest]
    serial: bool = False


def same(what: str, share: float, most: float) -> None:
    """Refuse results of which too large a share differs.

    Args:
        what: was compared.
        share: of it that differs.
        most: that may.

    Raises:
        Disagreement: more does.
    """
    if not share <= most:
        raise Disagreement(f"{what} of kernel and C differ in a share of {share:.2g}, expected at most {most:g}")
