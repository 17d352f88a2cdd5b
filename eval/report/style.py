"""How every figure looks: white, colours that colour-blind eyes tell apart, legends outside the axes, units.

The functions ``draw_*`` of this folder write a PNG to ``path``, with ``title`` over the figure; an ``OutputError`` says
that it cannot be written.
"""

from __future__ import annotations

import io
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.files import write_atomically
from moteslam.robot.pictures import STYLE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SLAM, TRUTH, DEAD_RECKONING, PARTICLE = STYLE.slam, STYLE.truth, STYLE.dead_reckoning, STYLE.particle
ONLINE, FINAL = "SLAM (online)", "SLAM (final)"
"""The two trajectories of SLAM: each pose as it was known then, and all as they were known at the end."""
COLOURS = ("#0072B2", "#D55E00", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Of lines: the palette of Okabe and Ito without its green, which is the truth's; for more lines again, dashed."""
DASHES = ("-", "--", ":", "-.")
STEPS = tuple(step * 10.0**power for power in range(-9, 10) for step in (1, 2, 5))
"""Round numbers."""
GAP = 10
"""Median intervals, and at least a second: a curve is broken at a longer gap, in which nothing was measured."""


@contextmanager
def saved_figure(path: str | PathLike[str], *, size: tuple[float, float]) -> Iterator[Figure]:
    """A figure of this width and height [inch] to draw on, written as a PNG when the block ends.

    Raises:
        OutputError: it cannot be written.
    """
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # it reports font caches
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with matplotlib.rc_context(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing")  # a recording's name may be in any script
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(STYLE.rc_params())
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasAgg(figure)
        yield figure
        layout = figure.get_layout_engine()
        if layout is not None and figure.axes:  # once: saving would lay everything out a second time
            layout.execute(figure)
            figure.set_layout_engine("none")
        picture = io.BytesIO()
        figure.savefig(picture, format="png")
    write_atomically(path, picture.getvalue())


def heading(figure: Figure, text: str) -> None:
    """A title over the figure, with no character of it taken for markup."""
    figure.suptitle(shortened(text, 90)).set_parse_math(False)


def shortened(text: str, longest: int) -> str:
    """Printable text of at most this number of characters."""
    text = printable(text)
    return text if len(text) <= longest else f"{text[: longest - 1]}…"


def printable(text: str) -> str:
    """Text with the bytes of a file name that are no text as escapes."""
    return text.encode(errors="surrogateescape").decode(errors="backslashreplace")


def legend_below(figure: Figure, *panels: Axes, columns: int | None = None) -> None:
    """One legend for the figure, under its axes: what the panels show, each label once."""
    shown: dict[str, Any] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            shown.setdefault(label, handle)
    if shown:
        columns = columns or (5 if figure.get_figwidth() > 7 else 2)
        names = list(map(printable, shown))
        legend = figure.legend(list(shown.values()), names, loc="outside lower center", ncols=columns)
        for text in legend.get_texts():
            text.set_parse_math(False)


def map_greys(log_odds: NDArray[np.float32]) -> NDArray[np.float64]:
    """The greys of a map, 0 black to 1 white, of log-odds [H, W]: those of ``STYLE`` and in between."""
    belief = np.tanh(np.asarray(log_odds, np.float64) / 2)  # 2 p - 1: -1 free, 0 unknown, 1 occupied
    end = np.where(belief < 0, STYLE.map_free, STYLE.map_occupied)
    return np.asarray(STYLE.map_unknown + (end - STYLE.map_unknown) * np.abs(belief))


def show_unknown(axes: Axes) -> None:
    """The grey of unknown cells beyond the map, too."""
    axes.set_facecolor(str(STYLE.map_unknown))


def plan(axes: Axes, *, labels: bool = True) -> None:
    """Axes of a floor plan: metres, and equal in x and y; without labels, one of several that share their limits."""
    axes.set_aspect("equal", adjustable="box")
    if labels:
        axes.set_xlabel("x [m]")
        axes.set_ylabel("y [m]")


def plan_size(points: NDArray[np.float64], *, longest: float = 8.0) -> tuple[float, float]:
    """Width and height [inch] of a figure whose one floor plan shows points [n, 2] without empty bands."""
    extent = np.ptp(np.reshape(points, (-1, 2)), axis=0) + 2.0
    width, height = longest * extent / extent.max()
    return max(float(width), 4.5) + 0.6, max(float(height), 1.1) + 1.1


def mark_start(axes: Axes, path: NDArray[np.float64]) -> None:
    """Mark the first pose of a path [n, 2 or more], which all paths of a picture share, by a ring round it."""
    axes.plot(*path[0, :2], "o", mfc="none", mec="black", mew=1.5, ms=10, ls="", label="start", zorder=8)


def mark_ends(axes: Axes, *paths: tuple[NDArray[np.float64], str], label: str = "end") -> None:
    """Mark the last pose of each path [n, 2 or more], in the colour of its line."""
    for path, colour in paths:
        axes.plot(*path[-1, :2], "s", color=colour, mec="white", ms=6, ls="", zorder=7)
    colour = paths[0][1] if len(paths) == 1 else "0.4"
    axes.plot([], [], "s", color=colour, mec="white", ms=6, ls="", label=label)


def show_everything(axes: Axes, *paths: NDArray[np.float64], margin: float = 1.0) -> None:
    """Limits that hold all of the points [n, 2] [m] and a margin [m]."""
    points = np.concatenate([np.reshape(path, (-1, 2)) for path in paths if len(path)])
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])


def curve_axes(axes: Axes, label: str) -> None:
    """Axes of a figure over time: what is drawn, with its unit, and lines to read it by."""
    axes.set_ylabel(label)
    axes.margins(x=0.01)
    axes.grid(axis="y", color="0.9", lw=0.6)


def broken(time: NDArray[np.float64], values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A curve [n] over time [n] [s] with a NaN in each of its gaps, where it is not to be drawn."""
    steps = np.diff(time)
    if not len(steps):
        return time, values
    gaps = np.flatnonzero(steps > max(1.0, GAP * float(np.median(steps)))) + 1
    return np.insert(time, gaps, time[gaps]), np.insert(values, gaps, np.nan)


def line_look(index: int) -> dict[str, Any]:
    """Colour and dashes of the line of this index."""
    return {"color": COLOURS[index % len(COLOURS)], "ls": DASHES[index // len(COLOURS) % len(DASHES)]}
