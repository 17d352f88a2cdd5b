"""How right the colours of a floor are, against the true floor."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from moteslam.errors import InputError


@dataclass(frozen=True)
class TextureScore:
    """Colour errors over the cells that have a colour and a truth.

    Attributes:
        cells: how many those are.
        error: mean absolute difference of a colour level, over the three channels.
        best_single: the same of the best single colour: each channel's median of the true floor there.
        share: ``error / best_single``.
        grey_spread: standard deviation of the true grey values there.
    """

    cells: int
    error: float
    best_single: float
    share: float
    grey_spread: float

    def as_dict(self) -> dict[str, Any]:
        """The same as plain values, fit for JSON."""
        return asdict(self)


def score_texture(estimate: ArrayLike, truth: ArrayLike, where: ArrayLike) -> TextureScore:
    """Compare two pictures of the floor, cell by cell.

    Args:
        estimate: [H, W, 3] levels 0 to 255.
        truth: [H, W, 3], on the same cells.
        where: [H, W] which cells count.

    Raises:
        InputError: pictures of different sizes, or no cell that counts.
    """
    estimate, truth = np.asarray(estimate, np.float64), np.asarray(truth, np.float64)
    where = np.asarray(where, bool)
    if estimate.shape != truth.shape or where.shape != truth.shape[:2]:
        raise InputError(f"pictures of {estimate.shape} and {truth.shape}, expected the same cells", field="texture")
    if not where.any():
        raise InputError("no cell has a colour, expected some", field="texture")
    seen, true = estimate[where], truth[where]
    error = float(np.abs(seen - true).mean())
    single = float(np.abs(true - np.median(true, axis=0)).mean())
    grey = true @ np.array((0.299, 0.587, 0.114))
    return TextureScore(len(true), error, single, error / single if single else float("inf"), float(grey.std()))


def registration(estimate: ArrayLike, truth: ArrayLike, where: ArrayLike, *, reach: int = 4) -> tuple[int, int]:
    """By how many cells (columns, rows) the truth must be moved to fit the estimate best; (0, 0) is in place.

    The best fit has the smallest sum of squared differences.

    Args:
        estimate: [H, W, 3] levels 0 to 255.
        truth: [H, W, 3], on the same cells.
        where: [H, W] which cells count.
        reach: shifts up to this many cells are tried, each way; cells this close to an edge do not count.

    Raises:
        InputError: as ``score_texture``.
    """
    import cv2

    estimate, truth, where = np.asarray(estimate, np.float32), np.asarray(truth, np.float32), np.asarray(where, bool)
    score_texture(estimate, truth, where)
    inner = (slice(reach, max(len(where) - reach, reach)), slice(reach, max(where.shape[1] - reach, reach)))
    if not where[inner].any():
        return 0, 0
    differences = cv2.matchTemplate(truth, estimate[inner], cv2.TM_SQDIFF, mask=where[inner].astype(np.float32))
    row, column = np.unravel_index(np.argmin(differences), differences.shape)
    return reach - int(column), reach - int(row)
