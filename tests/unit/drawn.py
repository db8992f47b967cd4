"""What tests read off a drawn figure."""

from __future__ import annotations

import itertools

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text

from silem.report import style


def texts(figure: Figure) -> list[str]:
    return [t.get_text() for t in figure.findobj(Text) if t.get_visible() and t.get_text()]


def footer(figure: Figure) -> str:
    """The small print, its line breaks taken out."""
    return figure.get_supxlabel().replace("\n", " ")


def boxes(figure: Figure) -> list[tuple[str, mpl.transforms.Bbox]]:
    """Every text as it is printed, with the pixels it covers."""
    canvas = FigureCanvasAgg(figure)
    with style.applied():
        canvas.draw()
    axes_axis = [axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)]
    ticks = [tick for axis in axes_axis for tick in axis.get_major_ticks()]
    of_ticks = {id(text) for tick in ticks for text in tick.findobj(Text)}
    # matplotlib keeps labels for ticks just outside the axis, which it does not print.
    printed = [
        tick.label1
        for axis in axes_axis
        for tick in axis.get_major_ticks()
        if min(axis.get_view_interval()) <= tick.get_loc() <= max(axis.get_view_interval())
    ]
    printed += [text for text in figure.findobj(Text) if id(text) not in of_ticks]
    shown = [text for text in printed if text.get_visible() and text.get_text().strip()]
    return [(text.get_text(), text.get_window_extent(canvas.get_renderer())) for text in shown]


def assert_readable(figure: Figure) -> None:
    """Fail where a text overlaps another or leaves the figure."""
    page = figure.bbox.padded(1)
    printed = boxes(figure)
    assert len(printed) > 5
    for text, box in printed:
        inside = page.x0 <= box.x0 and box.x1 <= page.x1 and page.y0 <= box.y0 and box.y1 <= page.y1
        assert inside, f"{text!r} leaves the figure"
    for (one, a), (two, b) in itertools.combinations(printed, 2):
        width = min(a.x1, b.x1) - max(a.x0, b.x0)
        height = min(a.y1, b.y1) - max(a.y0, b.y0)
        assert width < 1 or height < 1, f"{one!r} overlaps {two!r}"


def lines_at(axes: Axes, color: str) -> list[Line2D]:
    return [line for line in axes.lines if line.get_color() == color]
