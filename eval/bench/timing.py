"""How long calls take, measured in turns, since the speed of a machine wanders."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from statistics import median

import numpy as np

from moteslam.eval.bench.contest import Contender

SHORTEST = 2e-3
"""Wall time of a turn [s]: a shorter call is made several times in it, so that clocks and wake-ups weigh little."""
MOST_TURNS = 200

Turns = list[tuple[float, float]]
"""What a unit of work took, turn by turn: wall time and processor time of all threads [s]."""


def in_turns(contenders: Mapping[str, Contender], *, seconds: float, least: int) -> dict[str, Turns]:
    """What a unit of each one's work takes, turn by turn, after one turn that is not counted.

    The order of the contenders within a round is random, and with it whose data are in the caches.

    Args:
        contenders: by name.
        seconds: as many rounds as fit into this time together, but ...
        least: ... at least this many.
    """
    calls = {name: _calls_a_turn(one) for name, one in contenders.items()}
    found: dict[str, Turns] = {name: [] for name in contenders}
    order, names = np.random.default_rng(0), list(contenders)
    end = time.perf_counter() + seconds
    for count in range(MOST_TURNS):
        if count >= least and time.perf_counter() > end:
            break
        for index in order.permutation(len(names)):
            name = names[index]
            one, times = contenders[name], calls[name]
            wall, processor = time.perf_counter(), time.process_time()
            for _ in range(times):
                one.call()
            work = times * one.work
            found[name].append(((time.perf_counter() - wall) / work, (time.process_time() - processor) / work))
    return found


def medians(turns: Mapping[str, Turns]) -> dict[str, tuple[float, float]]:
    """Of each contender wall time and processor time of a unit [s], medians over its turns."""
    return {
        name: (median(wall for wall, _ in found), median(spent for _, spent in found)) for name, found in turns.items()
    }


def _calls_a_turn(contender: Contender) -> int:
    """How many calls make a turn of at least the shortest time."""
    for _ in range(2):  # the first one may load the kernel
        began = time.perf_counter()
        contender.call()
        taken = time.perf_counter() - began
        if taken > 50 * SHORTEST:
            break
    return max(1, math.ceil(SHORTEST / taken))
