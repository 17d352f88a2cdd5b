"""The style of pictures as Matplotlib takes it."""

import matplotlib
from matplotlib.figure import Figure

from moteslam import PictureStyle


def test_matplotlib_takes_the_settings() -> None:
    style = PictureStyle(slam="#123456", font_size=14.0, dpi=72.0)
    with matplotlib.rc_context(style.rc_params()):
        figure = Figure()
        axes = figure.subplots()
        (line,) = axes.plot([0, 1], [1, 0])
    assert line.get_color() == "#123456"
    assert figure.dpi == 72
    assert axes.xaxis.label.get_fontsize() == 14
    assert not axes.spines["top"].get_visible()
