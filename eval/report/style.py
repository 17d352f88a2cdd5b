"""How every figure looks: white, colours that colour-blind eyes tell apart, legends outside the axes, units."""

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

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SLAM, TRUTH, DEAD_RECKONING, PARTICLE = "#0072B2", "#009E73", "#D55E00", "#56B4E9"
"""From the palette of Okabe and Ito."""

ONLINE, FINAL = "SLAM (online)", "SLAM (final)"
"""The two trajectories of SLAM: each pose as it was known then, and all as they were known at the end."""

_SETTINGS: dict[Any, Any] = {
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.grid": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "lines.solid_capstyle": "round",
    "savefig.facecolor": "white",
}


@contextmanager
def saved_figure(path: str | PathLike[str], *, size: tuple[float, float], dpi: int = 150) -> Iterator[Figure]:
    """A figure to draw on, written as a PNG when the block ends.

    Args:
        path: of the PNG.
        size: width and height [inch].
        dpi: pixels an inch.

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
        matplotlib.rcParams.update(_SETTINGS)
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasAgg(figure)
        yield figure
        layout = figure.get_layout_engine()
        if layout is not None and figure.axes:  # once: saving would lay everything out a second time
            layout.execute(figure)
            figure.set_layout_engine("none")
        picture = io.BytesIO()
        figure.savefig(picture, format="png", dpi=dpi)
    write_atomically(path, picture.getvalue())


def heading(figure: Figure, text: str) -> None:
    """A title over the figure, with no character of it taken for markup, and bytes that are no text as escapes."""
    text = printable(text)
    figure.suptitle(text if len(text) <= 90 else f"{text[:89]}…", fontsize=10).set_parse_math(False)


def printable(text: str) -> str:
    """Text with the bytes of a file name that are no text as escapes."""
    return text.encode(errors="surrogateescape").decode(errors="backslashreplace")


def plan(axes: Axes, *, labels: bool = True) -> None:
    """Axes of a floor plan: metres, and equal in x and y; without labels, one of several that share their limits."""
    axes.set_aspect("equal", adjustable="datalim" if labels else "box")
    if labels:
        axes.set_xlabel("x [m]")
        axes.set_ylabel("y [m]")


def show_everything(axes: Axes, *paths: NDArray[np.float64], margin: float = 1.0) -> None:
    """Limits that hold all of the points [n, 2] [m] and a margin [m]."""
    points = np.concatenate([np.reshape(path, (-1, 2)) for path in paths if len(path)])
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])


def legend_below(figure: Figure, *panels: Axes, columns: int = 4) -> None:
    """One legend for the figure, under its axes: what the panels show, each label once."""
    shown: dict[str, Any] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            shown.setdefault(label, handle)
    if shown:
        legend = figure.legend(
            list(shown.values()), list(map(printable, shown)), loc="outside lower center", ncols=columns
        )
        for text in legend.get_texts():
            text.set_parse_math(False)


def plan_size(points: NDArray[np.float64], *, longest: float = 8.0) -> tuple[float, float]:
    """Width and height [inch] of a figure whose one floor plan shows points [n, 2] without empty bands."""
    extent = np.ptp(np.reshape(points, (-1, 2)), axis=0) + 2.0
    width, height = longest * extent / extent.max()
    return max(float(width), 4.5) + 0.6, max(float(height), 2.0) + 1.1
