"""The particles of a run as ``particles.npz``: the paths that end in the last ones, and how far all of them spread."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.files import write_atomically
from moteslam.robot.formats.npz import Shape, read_arrays
from moteslam.robot.values import Summarised
from moteslam.slam.estimate import Estimate

SHAPES: dict[str, Shape] = {"stamps": ("updates",), "paths": ("particles", "updates", 3), "spread": ("updates", 3)}
"""Of the arrays; what they mean: ``Estimate``. Metres, radians and seconds."""


@dataclass(frozen=True, eq=False, repr=False)
class Particles(Summarised):
    """What ``particles.npz`` holds.

    Attributes:
        stamps: [u] float64, of the updates of the filter [s].
        paths: [K, u, 3] float32, paths that end in the particles of the last update.
        spread: [u, 3] float32, standard deviation of all particles after every update: along and across their mean
            heading [m], and of the heading [rad].
    """

    stamps: NDArray[np.float64]
    paths: NDArray[np.float32]
    spread: NDArray[np.float32]


def write_particles(path: str | PathLike[str], estimate: Estimate) -> None:
    """Write ``particles.npz``; the same run writes the same bytes.

    Raises:
        OutputError: it cannot be written.
    """
    stamps, paths, spread = estimate.particle_stamps, estimate.particle_paths, estimate.particle_spread

    def write(file: IO[bytes]) -> None:
        np.savez_compressed(file, stamps=stamps, paths=paths.astype(np.float32), spread=spread.astype(np.float32))

    write_atomically(path, write)


def read_particles(path: str | PathLike[str]) -> Particles:
    """Read ``particles.npz``.

    Raises:
        InputError: no archive of these arrays, or one with values that are not finite.
    """
    path = Path(path)
    arrays = read_arrays(path, SHAPES)
    for name, values in arrays.items():
        if not np.isfinite(values).all():
            raise InputError("expected finite numbers", file=path, field=name)
    stamps = arrays["stamps"].astype(np.float64)
    if (np.diff(stamps) < 0).any():
        raise InputError("stamps go back, expected rising seconds", file=path, field="stamps")
    return Particles(stamps, arrays["paths"].astype(np.float32), arrays["spread"].astype(np.float32))
