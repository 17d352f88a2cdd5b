"""What scans are integrated into signed-distance maps with: lengths of the maps, and the weights of their averages."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.kernels.tiles import MAX_WEIGHT


class IntegrationOptions(NamedTuple):
    """Of ``integrate_scans``.

    Attributes:
        cell_size: of the fine level [m].
        truncation, coarse_truncation: up to this distance from a segment cells are updated, on each level [m].
        coarse_chord: on the coarse level segments are joined until their chord is this long [coarse cells].
        near: distances below it weigh ``near_weight`` in a cell's average, the others 1 [m].
        near_weight: 1 to ``MAX_WEIGHT``.
        max_weight: of the average itself, 1 to ``MAX_WEIGHT``.
    """

    cell_size: float
    truncation: float
    coarse_truncation: float
    coarse_chord: float
    near: float
    near_weight: int
    max_weight: int


@lru_cache(maxsize=64)
def settings_of(options: IntegrationOptions) -> NDArray[np.float32]:
    """The options as the kernel reads them; equal ones are checked once.

    Returns:
        truncation [fine cells], that of the coarse level [coarse cells], chord and ``near`` [fine cells], and the two
        weights.

    Raises:
        InputError: one that is not finite or out of bounds.
    """
    o = options
    for name in ("cell_size", "truncation", "coarse_truncation", "near"):
        length = getattr(o, name)
        if not (math.isfinite(length) and length > 0):
            raise InputError(f"{length:g} m, expected above 0", field=name)
    if not (math.isfinite(o.coarse_chord) and o.coarse_chord >= 0):
        raise InputError(f"{o.coarse_chord:g} coarse cells, expected 0 or more", field="coarse_chord")
    for name in ("near_weight", "max_weight"):
        weight = getattr(o, name)
        if not 1 <= weight <= MAX_WEIGHT:
            raise InputError(f"{weight}, expected 1 to {MAX_WEIGHT}", field=name)
    cell = o.cell_size
    settings = np.array(
        (o.truncation / cell, o.coarse_truncation / (2 * cell), 2 * o.coarse_chord, o.near / cell, o.near_weight,
         o.max_weight),
        np.float32,
    )  # fmt: skip
    settings.setflags(write=False)
    return settings
