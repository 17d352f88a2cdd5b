"""How every figure looks: white, colours that colour-blind eyes tell apart, legends outside the axes, units.

The functions ``draw_*`` of this folder write to ``path``, as it ends, PNG, PDF or SVG, with ``title`` over the figure;
points [m], times [s].
"""

from __future__ import annotations

import io
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from moteslam.errors import File, InputError, OutputError
from moteslam.eval.tables import literal, shortened
from moteslam.files import write_atomically
from moteslam.robot.se2 import Array

if TYPE_CHECKING:
    import matplotlib.axes
    from matplotlib.figure import Figure

    Axes = matplotlib.axes.Axes  # of annotations here and in the files beside this one


@dataclass(frozen=True)
class PictureStyle:
    """The look of the project's pictures.

    In a picture of one's own: ``with matplotlib.rc_context(moteslam.PictureStyle().rc_params()): ...``

    Its four colours are from the palette of Okabe and Ito, made for colour-blind readers; greys of the map from 0,
    black, to 1, white; the size of all text is in pt, a figure's title 1 pt larger; ``dpi`` are pixels an inch.
    """

    slam: str = "#0072B2"
    truth: str = "#009E73"
    dead_reckoning: str = "#D55E00"
    particle: str = "#56B4E9"
    map_free: float = 1.0
    map_unknown: float = 0.88
    map_occupied: float = 0.15
    font_size: float = 9.0
    dpi: float = 150.0

    def rc_params(self) -> dict[Any, Any]:  # Matplotlib's stubs list its 300 keys as literals
        """The style as settings of Matplotlib, over its defaults: white, no frames, lines in the colours above."""
        colours = [self.slam, self.truth, self.dead_reckoning, self.particle]
        return {
            "font.size": self.font_size,
            "axes.titlesize": self.font_size,
            "figure.titlesize": self.font_size + 1,
            "axes.grid": False,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "axes.prop_cycle": f"cycler('color', {colours})",
            "legend.frameon": False,
            "lines.solid_capstyle": "round",
            "figure.dpi": self.dpi,
            "savefig.dpi": self.dpi,
            "savefig.facecolor": "white",
            "pdf.fonttype": 42,  # journals refuse those of type 3
            "svg.hashsalt": "moteslam",
        }


STYLE = PictureStyle()
SLAM, TRUTH, DEAD_RECKONING, PARTICLE = STYLE.slam, STYLE.truth, STYLE.dead_reckoning, STYLE.particle
UNKNOWN = str(STYLE.map_unknown)  # The grey of cells that the map does not know, and beyond it
ONLINE_COLOUR = "#CC79A7"
"""Of the online trajectory where the final one is drawn, too."""
ONLINE, FINAL = "SLAM (online)", "SLAM (final)"
"""The two trajectories of SLAM: each pose as it was known then, and all as they were known at the end."""
COLOURS = ("#0072B2", "#D55E00", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Of lines: the palette of Okabe and Ito without its green, which is the truth's; for more lines again, dashed."""
DASHES = ("-", "--", ":", "-.", (0, (5, 1, 1, 1, 1, 1)), (0, (8, 3)), (0, (3, 4)))
STEPS = tuple(step * 10.0**power for power in range(4) for step in (1, 2, 5))  # Round numbers up to 5000
TRUTH_BAND: dict[str, Any] = {"color": TRUTH, "lw": 4.0, "alpha": 0.55}
"""The path of the truth, under the others."""
SINGLE_VALUES, WINDOWS, MEDIANS = 300, 240, 60
"""A curve of more values is unreadable: their range in windows and their running median are drawn, so many a run."""
MEDIANS_AND_RANGES = "lines: running medians, bands: ranges"
GAP = 10
"""Median intervals, and at least a second: a curve is broken at a longer gap, in which nothing was measured."""
UNDATED: dict[str, Any] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
"""What keeps the time out of files of lines, so that the same figure has the same bytes."""
FORMS = "png", *UNDATED


@contextmanager
def saved_figure(
    path: File, *, size: tuple[float, float], title: str = "", columns: tuple[int, int] = (5, 2)
) -> Iterator[Figure]:
    """A figure of this width and height [inch] to draw on, written when the block ends.

    Under it is one legend for all panels without one, of that many columns where it is wider than 7 inch, and else.
    """
    if not isinstance(path, str | PathLike):
        raise InputError(f"{type(path).__name__}, expected a file to write", field="path")
    form = Path(path).suffix.lower()[1:]
    if form not in FORMS:
        raise OutputError(f"expected a name that ends in .{' or .'.join(FORMS)}", file=path)
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
        figure.suptitle(shortened(title, 90)).set_parse_math(False)
        shared = [axes.get_legend_handles_labels() for axes in figure.axes if axes.get_legend() is None]
        shown: dict[str, Any] = {}
        for handle, label in (pair for each in shared for pair in zip(*each, strict=True)):
            shown.setdefault(literal(label), handle)
        shown = dict(sorted(shown.items(), key=lambda one: one[0] == MEDIANS_AND_RANGES))  # which is about all lines
        if shown:
            ncols = columns[0] if size[0] > 7 else columns[1]
            legend = figure.legend(list(shown.values()), list(shown), loc="outside lower center", ncols=ncols)
            for text in legend.get_texts():
                text.set_parse_math(False)
        layout = figure.get_layout_engine()
        if layout is not None and figure.axes:  # once: saving would lay everything out a second time
            layout.execute(figure)
            figure.set_layout_engine("none")
        picture = io.BytesIO()
        figure.savefig(picture, format=form, metadata=UNDATED.get(form))
    write_atomically(path, picture.getvalue())


@contextmanager
def saved_plan(
    path: File, points: Array, *, margin: float = 0.5, longest: float = 8.0, **figure_options: Any
) -> Iterator[Axes]:
    """The axes of a ``saved_figure`` of one floor plan that shows points [n, 2] and a margin [m], without empty bands.

    Its longer side is about ``longest`` [inch].
    """
    extent = np.ptp(points, axis=0) + 2.0
    width, height = longest * extent / extent.max()
    size = max(float(width), 4.5) + 0.6, max(float(height), 1.1) + 1.1
    with saved_figure(path, size=size, **figure_options) as figure:
        axes = figure.subplots()
        plan(axes)
        show_everything(axes, points, margin=margin)
        yield axes


def plan(axes: Axes) -> None:
    """Axes of a floor plan: metres, and equal in x and y."""
    axes.set_aspect("equal", adjustable="box")
    axes.set(xlabel="x [m]", ylabel="y [m]")


def draw_paths(axes: Axes, *paths: tuple[Array, dict[str, Any]], start: Array, end: str = "end") -> None:
    """Paths [n, 2 or more], each with its look, on a plan; where one of them starts, and where each ends."""
    for path, look in paths:
        axes.plot(*path[:, :2].T, **look)
    mark_start(axes, start)
    mark_ends(axes, *((path, look["color"]) for path, look in paths), label=end)


def mark_start(axes: Axes, path: Array) -> None:
    """Mark the first pose of a path [n, 2 or more], which all paths of a picture share, by a ring round it."""
    axes.plot(*path[0, :2], "o", mfc="none", mec="black", mew=1.5, ms=10, ls="", label="start", zorder=8)


def mark_ends(axes: Axes, *paths: tuple[Array, str], label: str = "end") -> None:
    """Mark the last pose of each path [n, 2 or more], in the colour of its line."""
    look: dict[str, Any] = {"marker": "s", "mec": "white", "ms": 6, "ls": ""}
    for path, colour in paths:
        axes.plot(*path[-1, :2], color=colour, zorder=7, **look)
    axes.plot([], [], color=paths[0][1] if len(paths) == 1 else "0.4", label=label, **look)


def show_everything(axes: Axes, *paths: Array, margin: float = 0.5) -> None:
    """Limits that hold all of the points [n, 2] [m] and a margin [m]."""
    points = np.concatenate([np.reshape(path, (-1, 2)) for path in paths if len(path)])
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))


def curve_axes(axes: Axes, label: str) -> None:
    """Axes of a figure over time: what is drawn, with its unit, and lines to read it by."""
    axes.set_ylabel(label)
    axes.margins(x=0.01)
    axes.grid(axis="y", color="0.9", lw=0.6)


def log_axis(axes: Axes, low: float, high: float, which: Literal["x", "y"] = "y") -> None:
    """A logarithmic axis with a tick at each 1, 2 and 5 times a power of ten."""
    from matplotlib.ticker import LogLocator

    axes.set(**{f"{which}scale": "log", f"{which}lim": (low, high)})
    axis = axes.yaxis if which == "y" else axes.xaxis
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter("{x:g}")
    axes.minorticks_off()


def broken(time: Array, values: Array) -> tuple[Array, Array]:
    """A curve [n] over time [n] [s] with a NaN in each of its gaps, where it is not to be drawn."""
    steps = np.diff(time)
    if not len(steps):
        return time, values
    gaps = np.flatnonzero(steps > max(1.0, GAP * float(np.median(steps)))) + 1
    return np.insert(time, gaps, time[gaps]), np.insert(values, gaps, np.nan)


def draw_curve(axes: Axes, time: Array, values: Array, *, label: str = "", **look: Any) -> None:
    """Values [n] over time [n] [s], broken at gaps; of many the range in windows, and the running median over it."""
    n = len(time)
    if n <= SINGLE_VALUES:
        axes.plot(*broken(time, values), lw=1.0, label=label, **look)
        return
    begins, half = np.arange(WINDOWS) * n // WINDOWS, n // MEDIANS // 2
    middle = begins + n // WINDOWS // 2
    at, low = broken(time[middle], np.minimum.reduceat(values, begins))
    _, high = broken(time[middle], np.maximum.reduceat(values, begins))
    axes.fill_between(at, low, high, color=look["color"], alpha=0.3, lw=0)
    trend = np.array([np.median(values[max(k - half, 0) : k + half + 1]) for k in middle])
    axes.plot(*broken(time[middle], trend), lw=1.4, label=label, **look)
    if label:
        axes.plot([], [], " ", label=MEDIANS_AND_RANGES)


def line_look(index: int) -> dict[str, Any]:
    """Colour and dashes of the line of this index."""
    return {"color": COLOURS[index % len(COLOURS)], "ls": DASHES[index // len(COLOURS) % len(DASHES)]}
