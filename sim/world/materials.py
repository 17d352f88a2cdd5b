"""What a material does to a beam: let it pass, mirror it, absorb it, or send it back."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from moteslam.robot.tables import Number, Positive, Section, Share

PLAIN = "plain"


class Material(Section):
    """A surface as a lidar at 905 nm sees it. A material without any key behaves like white paper.

    A beam that comes in at an angle to the surface's normal passes with a probability that falls from ``passes``
    to ``passes_square`` square on, as exp(-(angle / lobe)^2) rises: a pane's own reflection is a mirror's, so it comes
    back to the sensor only within a few degrees of square on (Foster, Sun, Park and Kuipers 2013 measured so).

    Attributes:
        passes: share of the beams that go through, far from square on.
        passes_square: the same square on.
        mirrors: share of the others that go on as from a mirror; their range is the length of the complete path.
            Within ``lobe`` of square on the mirror shows the sensor itself, and the beam counts as seen.
        lobe: width of the reflection that comes straight back [rad].
        reach: where the last echo of a square surface comes from [m]; it shrinks with the root of the cosine of the
            angle, as the power that comes back falls with the square of the range (Lambert's law).
        dropout: share of the beams seen that give no usable reading.
    """

    passes: Share = 0.0
    passes_square: Share = 0.0
    mirrors: Share = 0.0
    lobe: Annotated[Number, Field(gt=0, le=1.6)] = 0.1
    reach: Positive | None = None
    dropout: Share = 0.0


MATERIALS = {
    PLAIN: Material(),
    # a window reflects 8 % at its two faces, square on straight back into the sensor
    "glass": Material(passes=0.92, passes_square=0.2, lobe=0.1),
    # the 30 m of the data sheet are those of white paper (90 % diffuse); 5 % give 30 m * sqrt(0.05 / 0.9)
    "black": Material(reach=7.0, dropout=0.05),
    # polished metal
    "shiny": Material(mirrors=0.7, lobe=0.15, dropout=0.1),
}
"""The materials that need no table of their own."""
