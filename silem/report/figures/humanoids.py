"""Figure 3b: how well the humanoids learn to walk from a human's motion capture."""

from __future__ import annotations

from itertools import chain, zip_longest
from typing import Any, NamedTuple

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter

from silem import paper
from silem.bodies.humanoid import DEMONSTRATOR_SPEED_M_S
from silem.report import results, style
from silem.report.figures import cells, sources
from silem.report.figures.sources import COMPARED

_DEMONSTRATOR = (0, (1, 1.5))
_MAX_RETURN = paper.number("humanoid_max_return")
_SMALL = 0.25  # what stays below this share of its scale is shown enlarged


class _Panel(NamedTuple):
    """A panel's column of the table, its title, and the highest value on its scale."""

    column: str
    title: str
    top: float


_SCORE = _Panel(
    "return_mean", "True return of an episode: minimum, mean, maximum over trials", _MAX_RETURN
)
_ENLARGED = _Panel("return_mean", "True return", _MAX_RETURN)
_SURVIVED = _Panel("upright", "Share of steps survived", 1.0)
_SPEED = _Panel("speed_m_s", "Speed (m/s)", DEMONSTRATOR_SPEED_M_S)


def humanoid_scores(frame: pd.DataFrame) -> Figure:
    """Draw Figure 3b: the true return of SILEM, SILEM⁻, TPIL and Peng20 on every humanoid.

    Above as in the paper: minimum, mean and maximum over trials of the walking reward, not
    normalised, at most 1000. Below what that number hides: how much of an episode passes before
    the body falls, and how fast it moves. A return or share that stays below a quarter of its
    scale is shown enlarged. Dashed levels are PPO on the true reward. A single trial is hollow, a
    cell without runs is an empty slot, and a run of another number of iterations than planned is
    a cross, with that number under its cell; crosses enter no mean.

    Args:
        frame: Runs of the study of the humanoids at one budget.

    Raises:
        SilemError: The runs are not of humanoids.
    """
    frame = sources.runs_of("humanoid_scores", frame)
    with style.applied():
        lower = [_enlarged(frame, _SURVIVED), _SPEED]
        if _is_small(frame, _ENLARGED):
            lower.insert(0, _enlarged(frame, _ENLARGED))
        figure = Figure(figsize=(style.WIDTH_IN, 5.6), layout="constrained")
        rows = figure.add_gridspec(2, 1, height_ratios=[1.4, 1])
        score = figure.add_subplot(rows[0])
        _draw(score, frame, _SCORE, room=0.18)
        score.axhline(_MAX_RETURN, color=style.PAPER, lw=1.5, zorder=1.5)
        score.yaxis.set_major_formatter(FuncFormatter(lambda value, _: style.number(value)))
        cells.write_means(score, frame, COMPARED, "return_mean")
        cells.trial_counts(score, frame, COMPARED, "return_mean")
        columns = rows[1].subgridspec(1, len(lower))
        for place, panel in enumerate(lower):
            axes = figure.add_subplot(columns[place])
            _draw(axes, frame, panel, room=0.04)
            axes.tick_params(axis="x", labelsize=8)
            if panel is _SPEED:
                speed = DEMONSTRATOR_SPEED_M_S
                axes.axhline(speed, color=style.INK, lw=1.5, ls=_DEMONSTRATOR)
        figure.legend(handles=_handles(frame), loc="outside upper left", ncols=4)
        note = cells.interval_note(frame, COMPARED, "return_mean")
        if frame["stand_in"].any():
            note += (
                "; ×: a run of another number of iterations, written below it; outside every mean"
            )
        sources.footer(figure, frame, note)
    return figure


def _draw(axes: Axes, frame: pd.DataFrame, panel: _Panel, room: float) -> None:
    """Draw every cell of a panel, PPO's levels, and leave a share of room below."""
    axes.set_title(panel.title)
    cells.body_ticks(axes, frame, scale="PPO" if panel is _SCORE else "")
    cells.levels(axes, frame, "ppo", panel.column, 1.05 * panel.top)
    cells.draw_cells(axes, frame, COMPARED, panel.column)
    cells.room_for_counts(axes, 0.0, 1.04 * panel.top, room)


def _is_small(frame: pd.DataFrame, panel: _Panel) -> bool:
    """Tell whether everything that the methods reached would lie at a panel's foot."""
    reached = frame.loc[frame["method"].isin(COMPARED), panel.column]
    return bool(len(reached) and reached.max() < _SMALL * panel.top)


def _enlarged(frame: pd.DataFrame, panel: _Panel) -> _Panel:
    """Return a panel with a scale for what the methods reached, where that is small."""
    if not _is_small(frame, panel):
        return panel
    reached = frame.loc[frame["method"].isin(COMPARED), panel.column]
    title = f"{panel.title.replace('of steps ', '')}, enlarged"
    return panel._replace(title=title, top=1.1 * float(reached.max()))


def _handles(frame: pd.DataFrame) -> list[Line2D]:
    """Return the legend's entries, the methods in its first row and the levels in its second."""
    original = results.original_body(frame)
    ppo = style.method("ppo", original).label
    speed = f"demonstrator, {DEMONSTRATOR_SPEED_M_S:g} m/s"
    lines: list[dict[str, Any]] = [
        {"color": style.MUTED, "lw": 1.2, "ls": cells.LEVEL_DASHES, "label": ppo},
        {"color": style.PAPER, "lw": 1.5, "label": "highest possible return"},
        {"color": style.INK, "lw": 1.5, "ls": _DEMONSTRATOR, "label": speed},
    ]
    marks = cells.handles([style.method(method, original) for method in COMPARED])
    levels = [Line2D([], [], **line) for line in lines]
    levels += [cells.cross_handle()] if frame["stand_in"].any() else []
    # a legend fills its columns first
    pairs = zip_longest(marks, levels)
    return [handle for handle in chain.from_iterable(pairs) if handle is not None]
