"""Empty images in place of figures, for tests that look at the text of a report."""

from __future__ import annotations

from pkm_reports.blocks import Picture
from pkm_reports.style import Image


class Sketches:
    """Images of a figure's size: of each name the first figure is drawn, none is written.

    Drawing and writing all figures takes half of the time of a report.
    """

    def __init__(self) -> None:
        self._sizes: dict[str, tuple[float, float]] = {}

    def __call__(self, picture: Picture) -> Image:
        if picture.name not in self._sizes:
            width, height = picture.draw().get_size_inches()
            self._sizes[picture.name] = float(width), float(height)
        width, height = self._sizes[picture.name]
        size = f'width="{72.0 * width:.1f}" height="{72.0 * height:.1f}"'
        empty = f'<svg xmlns="http://www.w3.org/2000/svg" {size}/>'
        return Image(empty.encode(), "svg", width, height)
