"""How one cell of a study, a method on a body, is drawn: its trials, their range or interval.

A panel has its bodies along the x axis, 1 apart, and for each a slot per method, left to right.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import ScaledTranslation

from silem.report import results, statistics, style

LEVEL_DASHES = (0, (4, 3))
INTERVAL_TRIALS = 5
"""Trials below which no figure draws an interval."""

OTHER_LENGTH = "shorter or longer run"
_DOTS_IN = 0.1  # the single trials stand this far right of their cell's range


def draw_cells(
    axes: Axes,
    frame: pd.DataFrame,
    methods: Sequence[str],
    column: str,
    *,
    counts: bool = False,
    means: bool = False,
) -> None:
    """Draw a column of the table, every cell of a panel.

    A cell without values is an empty slot with the reason. Runs of another number of iterations
    than planned are crosses in either case.

    Args:
        axes: The panel.
        frame: Runs of one study at one budget.
        methods: The slots.
        column: What to draw.
        counts: Write under each cell its number of trials, and the iterations of its crosses;
            `room_for_counts` leaves the room.
        means: Write each mean, a whole number, above its cell.
    """
    for x, method, body in _places(frame, methods):
        values = results.scores(frame, method, body, column)
        others = results.stand_ins(frame, method, body).dropna(subset=column)
        if len(values):
            _draw_trials(axes, x, values, method)
        elif others.empty:
            style.empty_slot(axes, x, _reason(frame, method, body))
        cross: dict[str, Any] = {"ms": 6.5, "mew": 1.8, "color": style.method(method).color}
        axes.plot(np.full(len(others), x), others[column], "x", zorder=5, **cross)
        small: dict[str, Any] = {"ha": "center", "fontsize": 7 if len(methods) > 3 else 7.5}
        paper: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "pad": 0.7}
        lines = [f"n={len(values)}"] if len(values) else []
        if lengths := sorted(others["n_iterations"].unique()):
            lines.append("× " + ", ".join(f"{n:,}" for n in lengths))
        if counts and lines:
            place: dict[str, Any] = {"transform": axes.get_xaxis_transform(), "color": style.MUTED}
            axes.text(x, 0.025, "\n".join(lines), bbox=paper, **place, **small)
        if means and len(values):
            above = small | {
                "xytext": (0, 6),
                "textcoords": "offset points",
                "color": style.INK,
            }
            mean, top = style.number(values.mean()), values.max()
            axes.annotate(mean, (x, top), bbox=paper | {"alpha": 0.8}, **above)


def _places(frame: pd.DataFrame, methods: Sequence[str]) -> Iterator[tuple[float, str, str]]:
    """Yield every cell's place on the x axis, its method and its body."""
    width = 0.81 / len(methods)
    for body_index, body in enumerate(results.body_names(frame)):
        for index, method in enumerate(methods):
            yield body_index + (index - (len(methods) - 1) / 2) * width, method, body


def _draw_trials(axes: Axes, x: float, values: np.ndarray, method: str) -> None:
    """Draw minimum, mean and maximum over trials, and the trials; hollow for a single one.

    From `INTERVAL_TRIALS` on a pale bar behind them is Student's 95 % t interval of the mean.
    """
    look = style.method(method)
    if len(values) >= INTERVAL_TRIALS:
        interval = statistics.mean_interval(values)
        axes.plot([x, x], interval, color=look.color, lw=7, alpha=0.3, solid_capstyle="butt")
    if len(values) > 1:
        ends = values.min(), values.max()
        axes.plot([x, x], ends, color=look.color, lw=1.6)
        for end in ends:
            axes.plot([x - 0.045, x + 0.045], [end, end], color=look.color, lw=1.6)
        beside = axes.transData + ScaledTranslation(_DOTS_IN, 0, axes.figure.dpi_scale_trans)
        dots: dict[str, Any] = {"ms": 3, "color": look.color, "alpha": 0.6, "mec": "none"}
        axes.plot(np.full(len(values), x), values, "o", transform=beside, **dots)
    hollow = len(values) == 1 and method != "random"  # which is not trained
    mark: dict[str, Any] = {"mfc": look.color, "mec": "white", "mew": 0.8}
    if hollow:
        mark = {"mfc": "white", "mec": look.color, "mew": 1.6}
    axes.plot([x], [values.mean()], look.marker, color=look.color, ms=7.5, zorder=5, **mark)


def interval_note(frame: pd.DataFrame, methods: Sequence[str], column: str) -> str:
    """Say what the marks and bars are, and what the intervals are worth, by simulation."""
    counts = [len(results.scores(frame, m, b, column)) for _, m, b in _places(frame, methods)]
    note = ["hollow: one trial"] if 1 in counts else []
    enough = min((count for count in counts if count >= INTERVAL_TRIALS), default=0)
    if not enough:
        return "; ".join([*note, f"no interval below {INTERVAL_TRIALS} trials"])
    normal, failing = (statistics.coverage(enough, failures=f) for f in (False, True))
    note.append(
        f"pale bars: Student's 95 % t interval of the mean over {enough} trials or more, which"
        f" in simulated studies holds the true mean in {100 * normal:.0f} % for normal scores and"
        f" in {100 * failing:.0f} % where one training in five fails"
    )
    if set(methods) - {"ppo", "random"}:
        note.append("they do not hold the variance of the demonstrator, which all imitators share")
    return "; ".join(note)


def body_ticks(axes: Axes, frame: pd.DataFrame, *, scale: str = "") -> None:
    """Name each body under the axis, and where PPO's return has a name, `scale`, that return."""
    names = results.body_names(frame)
    labels = []
    for body in names:
        returns = results.scores(frame, "ppo", body, "return_mean")
        level = f"{scale} {style.number(returns.mean())}" if len(returns) else f"no {scale}"
        labels.append(f"{body}\n{level}" if scale else body)
    axes.set_xticks(range(len(names)), labels)
    axes.set_xlim(-0.5, len(names) - 0.5)
    axes.tick_params(axis="x", length=0)


def levels(axes: Axes, frame: pd.DataFrame, method: str, column: str, top: float) -> None:
    """Draw a method's mean on each body, up to `top`, as a dashed level across the body's slots."""
    for index, body in enumerate(results.body_names(frame)):
        values = results.scores(frame, method, body, column)
        if len(values) and values.mean() <= top:
            look: dict[str, Any] = {"color": style.MUTED, "lw": 1.2, "ls": LEVEL_DASHES}
            axes.plot([index - 0.44, index + 0.44], [values.mean()] * 2, zorder=1.8, **look)


def room_for_counts(axes: Axes, lowest: float, highest: float, share: float = 0.12) -> None:
    """Show at least `lowest` to `highest`, and leave room below for the numbers of trials."""
    low, high = axes.get_ylim()
    low, high = min(low, lowest), max(high, highest)
    axes.set_ylim(low - share * (high - low), high + 0.02 * (high - low))
    # A fixed number of ticks: else the layout changes them, and with them the labels' width.
    axes.yaxis.set_major_locator(MaxNLocator(7))


def say(axes: Axes, word: str) -> None:
    """Write a word in the middle of an empty panel."""
    middle: dict[str, Any] = {"transform": axes.transAxes, "ha": "center", "va": "center"}
    axes.text(0.5, 0.5, word, color=style.MUTED, backgroundcolor="white", **middle)


def handles(looks: Sequence[style.MethodStyle]) -> list[Line2D]:
    """Return legend entries for methods."""
    mark: dict[str, Any] = {"ls": "none", "mec": "white", "ms": 8}
    return [style.handle(k.color, k.label, marker=k.marker, **mark) for k in looks]


def cross_handle() -> Line2D:
    """Return the legend entry for runs of another number of iterations than planned."""
    return style.handle(style.MUTED, OTHER_LENGTH, ls="none", marker="x", mew=1.8)


def _reason(frame: pd.DataFrame, method: str, body: str) -> str:
    """Say why a cell has nothing to draw."""
    rows = results.cell(frame, method, body)
    if rows.empty:
        return "no run" if results.is_planned(frame, method, body) else "not planned"
    return "no expert" if rows["expert_return"].isna().all() else "expert's return ≤ 0"
