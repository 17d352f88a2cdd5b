"""What a figure shows, for tests."""

from matplotlib.figure import Figure


def legend_of(figure: Figure) -> list[str]:
    """The texts of a figure's legend."""
    return [text.get_text() for text in figure.legends[0].get_texts()]
