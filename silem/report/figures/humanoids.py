"""Figure 3b: how well the humanoids learn to walk from a human's motion capture."""

from __future__ import annotations

from itertools import chain, zip_longest
from typing import Any

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter

from silem import paper
from silem.envs.walking import DEMONSTRATOR_SPEED_M_S
from silem.report import results, style
from silem.report.figures import cells, sources
from silem.report.figures.sources import COMPARED

_DEMONSTRATOR = (0, (1, 1.5))
_PANELS = {
    "return_mean": "True return of an episode: minimum, mean, maximum over trials",
    "upright": "Share of the 1,000 steps survived",
    "speed_m_s": "Speed (m/s)",
}


def humanoid_scores(frame: pd.DataFrame) -> Figure:
    """Draw Figure 3b: the true return of SILEM, SILEM⁻, TPIL and Peng20 on every humanoid.

    Above as in the paper: minimum, mean and maximum over trials of the walking reward, not
    normalised, at most 1000. Below what that number hides: how much of an episode passes before
    the body falls, and how fast it moves. Dashed levels are PPO on the true reward. A single trial
    is hollow, a cell without runs is an empty slot, and a run of another number of iterations than
    planned is a cross, with that number under its cell; crosses enter no mean.

    Args:
        frame: Runs of the study of the humanoids at one budget.

    Raises:
        SilemError: The runs are not of humanoids.
    """
    frame = sources.runs_of("humanoid_scores", frame)
    with style.applied():
        figure = Figure(figsize=(style.WIDTH_IN, 5.6), layout="constrained")
        panels = figure.subplot_mosaic(
            [["return_mean"] * 2, ["upright", "speed_m_s"]], height_ratios=[1.4, 1]
        )
        highest = paper.number("humanoid_max_return")
        tops = {"return_mean": highest, "upright": 1.0, "speed_m_s": DEMONSTRATOR_SPEED_M_S}
        for column, axes in panels.items():
            axes.set_title(_PANELS[column])
            cells.body_ticks(axes, frame, scale="PPO" if column == "return_mean" else "")
            cells.levels(axes, frame, "ppo", column)
            cells.draw_cells(axes, frame, COMPARED, column, cells.draw_range)
            share = 0.18 if column == "return_mean" else 0.04
            cells.room_for_counts(axes, 0.0, 1.04 * tops[column], share)
        score, speed = panels["return_mean"], panels["speed_m_s"]
        score.axhline(highest, color=style.PAPER, lw=1.5, zorder=1.5)
        score.yaxis.set_major_formatter(FuncFormatter(lambda value, _: style.number(value)))
        speed.axhline(DEMONSTRATOR_SPEED_M_S, color=style.INK, lw=1.5, ls=_DEMONSTRATOR)
        cells.write_means(score, frame, COMPARED, "return_mean")
        cells.trial_counts(score, frame, COMPARED, "return_mean")
        figure.legend(handles=_handles(frame), loc="outside upper left", ncols=4)
        note = "hollow: one trial, so no range"
        if frame["stand_in"].any():
            note += (
                "; ×: a run of another number of iterations, written below it; outside every mean"
            )
        sources.footer(figure, frame, note)
    return figure


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
