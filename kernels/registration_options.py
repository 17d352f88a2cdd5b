"""What a registration of scans is made with: lengths of the maps, noise, costs, bounds."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.kernels.tiles import MAX_WEIGHT, STEPS


class RegistrationOptions(NamedTuple):
    """Of ``register_scans``.

    Attributes:
        cell_size: of the fine level [m].
        truncation, coarse_truncation: of each level [m].
        residual: standard deviation of the distances on the fine level [m].
        coarse_residual_factor: by what it is multiplied on the coarse level.
        iterations: at most, on each level.
        unknown: cost of an endpoint where neither level was seen.
        outlier: largest cost of an endpoint where one was; below it the cost is half the squared residual.
        likelihood_width: standard deviation of a residual r in an endpoint's likelihood, exp(-(r / width)^2 / 2).
        ray_clearance: a ray crosses a surface of the map if it meets one this far from its endpoint [truncations], ...
        ray_weight: ... in a cell that weighs more than this, ...
        ray_distance: ... nearer to the surface than this [truncations].
        far: an endpoint at least this far from the surface on the coarse level is far [m]; at most three quarters of
            its truncation count.
    """

    cell_size: float
    truncation: float
    coarse_truncation: float
    residual: float
    coarse_residual_factor: float
    iterations: int
    unknown: float
    outlier: float
    likelihood_width: float
    ray_clearance: float
    ray_weight: int
    ray_distance: float
    far: float


@lru_cache(maxsize=64)
def settings_of(options: RegistrationOptions) -> NDArray[np.float32]:
    """The options as the kernel reads them; equal ones are checked once.

    Returns:
        cell size, truncations of both levels and standard deviations of both [m], iterations, the costs ``unknown`` and
        ``outlier``, the exponent of an endpoint's likelihood, exp(exponent * residual^2), and of rays the clearance
        [m], weight and distance [steps]; what is far [steps of the coarse level].

    Raises:
        InputError: one that is not finite or out of bounds.
    """
    o = options
    for name in ("cell_size", "truncation", "coarse_truncation", "residual", "far"):
        length = getattr(o, name)
        if not (math.isfinite(length) and length > 0):
            raise InputError(f"{length:g} m, expected above 0", field=name)
    for name in ("coarse_residual_factor", "likelihood_width"):
        factor = getattr(o, name)
        if not (math.isfinite(factor) and factor > 0):
            raise InputError(f"{factor:g}, expected above 0", field=name)
    if not (math.isfinite(o.ray_clearance) and o.ray_clearance >= 0):
        raise InputError(f"{o.ray_clearance:g} truncations, expected 0 or more", field="ray_clearance")
    if not 0 <= o.ray_distance <= 1:
        raise InputError(f"{o.ray_distance:g} truncations, expected 0 to 1", field="ray_distance")
    if not 0 <= o.ray_weight <= MAX_WEIGHT:
        raise InputError(f"{o.ray_weight}, expected 0 to {MAX_WEIGHT}", field="ray_weight")
    if o.iterations < 0 or not (math.isfinite(o.unknown) and math.isfinite(o.outlier)):
        problem = f"{o.iterations}, {o.unknown:g}, {o.outlier:g}, expected finite numbers"
        raise InputError(problem, field="iterations")
    coarse_residual, exponent = o.coarse_residual_factor * o.residual, -0.5 / o.likelihood_width**2
    settings = np.array(
        (o.cell_size, o.truncation, o.coarse_truncation, o.residual, coarse_residual, o.iterations, o.unknown,
         o.outlier, exponent, o.ray_clearance * o.truncation, o.ray_weight, round(o.ray_distance * STEPS),
         round(min(o.far / o.coarse_truncation, 0.75) * STEPS)),
        np.float32,
    )  # fmt: skip
    settings.setflags(write=False)
    return settings
