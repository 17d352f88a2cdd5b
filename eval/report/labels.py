"""Text on a floor plan, put where it covers no other text, and as little of what is drawn as may be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from moteslam.eval.report.arrows import along

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FONT_SIZE = 8.0
"""Of the labels [pt]."""
CHARACTER = (0.62, 1.3)
"""Width and height of a character, as shares of the size of the font."""
GAPS = (4.0, 9.0, 16.0, 26.0)
"""Between a place and its label, in x and in y [pt]: the nearest of these that is free."""
SIDES = ((1, 1), (1, -1), (-1, 1), (-1, -1), (1, 0), (-1, 0), (0, 1), (0, -1))
"""Of a place, where its label may be; those on a slant come first, since routes and walls are mostly straight."""
DETOUR = 2.0
"""What the next larger gap costs, in points of lines that a label would cover."""
POINTS_PER_INCH = 72.0


@dataclass(frozen=True)
class Label:
    """A text that belongs to a place.

    Attributes:
        text: short, one line.
        place: x, y [m].
        colour: of the text.
    """

    text: str
    place: tuple[float, float]
    colour: str = "black"

    def size(self, scale: float) -> NDArray[np.float64]:
        """Width and height [2] [m] on a plan of this scale [inch/m]."""
        width, height = CHARACTER
        return np.array((width * len(self.text), height)) * FONT_SIZE / POINTS_PER_INCH / scale


def place_labels(
    labels: Sequence[Label],
    scale: float,
    *,
    lines: Sequence[NDArray[np.float64]] = (),
    limits: tuple[float, float, float, float] = (-np.inf, -np.inf, np.inf, np.inf),
) -> NDArray[np.float64]:
    """The centres [n, 2] [m] of labels, each beside its place.

    A label covers no label before it and stays inside the limits where there is room. Of such places it takes the one
    that covers the least of the lines, and is nearest.

    Args:
        labels: in the order of their importance.
        scale: of the plan [inch/m].
        lines: corners [k, 2] [m] of what is drawn.
        limits: lowest x and y, highest x and y [m].
    """
    drawn = _sampled(lines, FONT_SIZE / 3 / POINTS_PER_INCH / scale)
    centres, sizes = np.zeros((0, 2)), np.zeros((0, 2))
    for label in labels:
        size = label.size(scale)
        reaches = np.array([size / 2 + gap / POINTS_PER_INCH / scale for gap in GAPS])
        candidates = label.place + (reaches[:, None] * np.array(SIDES)).reshape(-1, 2)
        cost = np.repeat(DETOUR * np.arange(len(GAPS)), len(SIDES))
        apart = abs(candidates[:, None] - centres) - (sizes + size) / 2
        cost = cost + 1e6 * ~(apart > 0).any(axis=2).all(axis=1)
        outside = (candidates - size / 2 < limits[:2]) | (candidates + size / 2 > limits[2:])
        cost += 1e3 * outside.any(axis=1)
        near = drawn[(abs(drawn - label.place) < size + reaches[-1]).all(axis=1)]
        cost += (abs(candidates[:, None] - near) < size / 2).all(axis=2).sum(axis=1)
        chosen = candidates[np.argmin(cost)]
        centres, sizes = np.vstack((centres, chosen)), np.vstack((sizes, size))
    return centres


def draw_labels(axes: Axes, labels: Sequence[Label], scale: float) -> None:
    """Write labels beside their places, with a white rim that keeps them legible on lines.

    Args:
        axes: of the plan, with all lines drawn and its limits set.
        labels: in the order of their importance.
        scale: of the plan [inch/m].
    """
    from matplotlib.patheffects import withStroke

    (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    rim = [withStroke(linewidth=2.5, foreground="white")]
    centres = place_labels(labels, scale, lines=_lines(axes), limits=(x0, y0, x1, y1))
    for label, (x, y) in zip(labels, centres.tolist(), strict=True):
        axes.text(
            *(x, y, label.text), fontsize=FONT_SIZE, color=label.colour, ha="center", va="center", zorder=9,
            path_effects=rim, parse_math=False,
        )  # fmt: skip


def _lines(axes: Axes) -> list[NDArray[np.float64]]:
    """The corners [k, 2] of every line and outline in axes."""
    lines = [np.asarray(line.get_xydata()) for line in axes.lines]
    return lines + [np.asarray(path.vertices) for collection in axes.collections for path in collection.get_paths()]


def _sampled(lines: Sequence[NDArray[np.float64]], spacing: float) -> NDArray[np.float64]:
    """Points [n, 2] on lines, at even distances."""
    return np.concatenate([np.zeros((0, 2)), *(along(line, spacing)[0] for line in lines if len(line) > 1)])
