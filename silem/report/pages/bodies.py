"""The page of the bodies: all of a family at rest."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from silem import bodies
from silem.report import film, style

_SIZE = 480, 300  # pixels


def gallery(names: Sequence[str], span_m: float, n_columns: int = 3) -> Figure:
    """Draw bodies at rest, as in Figures 2a and 2c.

    Args:
        names: Registered runners.
        span_m: Width of what is seen at each body, metres: one scale for all.
        n_columns: Pictures per row.
    """
    n_rows = -(-len(names) // n_columns)
    height_in = style.WIDTH_IN / n_columns * _SIZE[1] / _SIZE[0] + 0.3
    with style.applied():
        figure, grid = style.new_figure(
            n_rows * height_in, nrows=n_rows, ncols=n_columns, squeeze=False
        )
        for axes in grid.flat[len(names) :]:
            axes.set_axis_off()
        for axes, name in zip(grid.flat, names, strict=False):
            film.portrait(axes, name, _SIZE, span_m)
            axes.set_title(f"{name}: {bodies.get(name).length[1]:g} m", pad=3)
    return figure
