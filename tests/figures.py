"""What a figure shows, for tests."""

from matplotlib.figure import Figure


def legend_of(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]
