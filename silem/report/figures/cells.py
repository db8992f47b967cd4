"""How one cell of a study, a method on a body, is drawn: its trials, their range or interval."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from silem.report import results, style
from silem.study.statistics import Summary

Draw = Callable[[Axes, float, np.ndarray, str, str], None]
"""Draws values (N,) of a method on a body at a place on the x axis."""

_DOTS = 0.085  # the single trials stand this far right of their cell's range


def draw_cells(
    axes: Axes,
    frame: pd.DataFrame,
    methods: Sequence[str],
    column: str,
    draw: Draw,
) -> None:
    """Draw every cell of a panel: bodies along the x axis, a slot for each method.

    Args:
        axes: The panel.
        frame: The runs.
        methods: The methods, left to right.
        column: The column of the table to draw.
        draw: Draws one cell that has values; a cell without becomes an empty slot with the reason.
    """
    for body_index, body in enumerate(results.body_names(frame)):
        for x, method in zip(_slots(body_index, len(methods)), methods, strict=True):
            values = results.scores(frame, method, body, column)
            if len(values):
                draw(axes, x, values, method, body)
            else:
                style.empty_slot(axes, x, _reason(frame, method, body))


def draw_range(axes: Axes, x: float, values: np.ndarray, method: str, body: str) -> None:
    """Draw minimum, mean and maximum over trials, and the trials; hollow for a single one."""
    look = style.method(method)
    if len(values) > 1:
        ends = values.min(), values.max()
        axes.plot([x, x], ends, color=look.color, lw=1.6)
        for end in ends:
            axes.plot([x - 0.045, x + 0.045], [end, end], color=look.color, lw=1.6)
        places = np.full(len(values), x + _DOTS)
        axes.plot(places, values, "o", ms=3, color=look.color, alpha=0.6, mec="none")
    draw_mark(axes, x, float(values.mean()), look, hollow=len(values) == 1)


def draw_interval(axes: Axes, x: float, summary: Summary, look: style.MethodStyle) -> None:
    """Draw the interquartile mean and its interval; hollow for a single trial."""
    if summary.n_trials > 1:
        axes.plot([x, x], summary.interval, color=look.color, lw=5, alpha=0.35)
    draw_mark(axes, x, summary.iqm, look, hollow=summary.n_trials == 1)


def draw_mark(axes: Axes, x: float, y: float, look: style.MethodStyle, *, hollow: bool) -> None:
    """Draw a method's mark."""
    face, edge = ("white", look.color) if hollow else (look.color, "white")
    width = 1.6 if hollow else 0.8
    line: dict[str, Any] = {"color": look.color, "marker": look.marker, "ms": 7.5, "zorder": 5}
    axes.plot([x], [y], mfc=face, mec=edge, mew=width, **line)


def body_ticks(axes: Axes, frame: pd.DataFrame, *, with_scale: bool = False) -> None:
    """Name each body under the axis and, if wanted, the return of its expert, its scale."""
    names = results.body_names(frame)
    labels = []
    for body in names:
        returns = results.scores(frame, "ppo", body, "return_mean")
        level = f"expert {style.number(returns.mean())}" if len(returns) else "no expert"
        labels.append(f"{body}\n{level}" if with_scale else body)
    axes.set_xticks(range(len(names)), labels)
    axes.set_xlim(-0.5, len(names) - 0.5)
    axes.tick_params(axis="x", length=0)


def trial_counts(axes: Axes, frame: pd.DataFrame, methods: Sequence[str], column: str) -> None:
    """Write each cell's number of trials under it; leave room with `room_for_counts`."""
    for body_index, body in enumerate(results.body_names(frame)):
        for x, method in zip(_slots(body_index, len(methods)), methods, strict=True):
            count = len(results.scores(frame, method, body, column))
            if count:
                axes.text(
                    x, 0.025, f"n={count}", transform=axes.get_xaxis_transform(), ha="center",
                    fontsize=7 if len(methods) > 3 else 7.5, color=style.MUTED,
                    bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8},
                )  # fmt: skip


def room_for_counts(axes: Axes, lowest: float, highest: float) -> None:
    """Show at least `lowest` to `highest`, and leave room below for the numbers of trials."""
    low, high = axes.get_ylim()
    low, high = min(low, lowest), max(high, highest)
    span = high - low
    axes.set_ylim(low - 0.12 * span, high + 0.02 * span)
    # A fixed number of ticks: else the layout changes them, and with them the labels' width.
    axes.yaxis.set_major_locator(MaxNLocator(7))


def handles(looks: Sequence[style.MethodStyle]) -> list[Line2D]:
    """Return legend entries for methods."""
    return [
        Line2D([], [], ls="none", marker=k.marker, color=k.color, mec="white", ms=8, label=k.label)
        for k in looks
    ]


def _slots(body_index: int, count: int) -> np.ndarray:
    """Places of `count` methods on the x axis, where bodies' centres are 1 apart."""
    width = 0.81 / count
    return body_index + (np.arange(count) - (count - 1) / 2) * width


def _reason(frame: pd.DataFrame, method: str, body: str) -> str:
    """Say why a cell has nothing to draw."""
    rows = results.cell(frame, method, body)
    if len(rows) == 0:
        return "no run" if results.is_planned(frame, method, body) else "not planned"
    return "no expert" if rows["expert_return"].isna().all() else "expert's return ≤ 0"
