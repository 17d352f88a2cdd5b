"""How pictures look: colours, fonts and resolution, for the figures of a run and for a user's own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class PictureStyle:
    """The look of the project's pictures.

    In a picture of one's own: ``with matplotlib.rc_context(moteslam.PictureStyle().rc_params()): ...``

    Attributes:
        slam: colour of SLAM's paths; all four are from the palette of Okabe and Ito, made for colour-blind readers.
        truth: colour of the truth.
        dead_reckoning: colour of dead reckoning.
        particle: colour of particles.
        map_free, map_unknown, map_occupied: greys of the map, 0 black to 1 white.
        font_size: of all text [pt]; a figure's title is 1 pt larger.
        dpi: pixels an inch.
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
        }


STYLE = PictureStyle()
"""Of every picture that is written."""
