"""Learning curves over timesteps, of every method on every body of a study."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, MaxNLocator

from silem import bodies
from silem.report import results, style
from silem.report.figures import cells, sources

_QUANTITIES = {
    "return_mean": "return of an episode",
    "episode_length": "steps before a fall",
    "disc_reward": "discriminator reward",
    "speed_m_s": "forward speed (m/s)",
}
_DASHES = (0, (3, 2))
_N_POINTS = 120
_SMOOTHING = 9  # points of the running mean: a curve's row holds only a few episodes


def learning_curves(frame: pd.DataFrame) -> Figure:
    """Draw return, discriminator reward and forward speed over timesteps, for each body.

    A line is the mean over a cell's trials, its band their minimum and maximum, both after a
    running mean over 9 of the curve's at most 200 points. Trials are drawn up to where the
    shortest ends; runs of another number of iterations than planned are dashed. Where all
    runs are experts' there is no row for the discriminator. Humanoids' episodes end with a fall,
    and a row shows when.

    Args:
        frame: Runs of one study at one budget.
    """
    frame = sources.runs_of("learning_curves", frame)
    names = results.body_names(frame)
    drawn = [m for m in style.METHODS if (frame["method"] == m).any()]
    quantities = _rows(names[0], drawn)
    looks = [style.method(m, results.original_body(frame)) for m in drawn]
    with style.applied():
        figure, grid = style.new_figure(
            2.0 * len(quantities), nrows=len(quantities), ncols=len(names), sharex="col",
            sharey="row", squeeze=False,
        )  # fmt: skip
        for column, body in enumerate(names):
            curves = {m: _curves(results.cell(frame, m, body)) for m in drawn}
            others = {m: _curves(results.stand_ins(frame, m, body)) for m in drawn}
            grid[0, column].set_title(body)
            for row, quantity in enumerate(quantities):
                _draw_curves(grid[row, column], curves, others, quantity)
            grid[-1, column].set_xlabel("million timesteps")
        for row, label in enumerate(quantities.values()):
            grid[row, 0].set_ylabel(label)
        grid[0, 0].yaxis.set_major_formatter(FuncFormatter(lambda value, _: style.number(value)))
        handles = [Line2D([], [], color=k.color, lw=2.2, label=k.label) for k in looks]
        if frame["stand_in"].any():
            handles.append(Line2D([], [], color=style.MUTED, ls=_DASHES, label=cells.OTHER_LENGTH))
        if handles:
            figure.legend(handles=handles, loc="outside upper left", ncols=3)
        _hide_made_up_ticks(grid)
        figure.align_ylabels(grid[:, 0])
        figure.align_xlabels(grid[-1])
        sources.footer(figure, frame, f"trials per curve: {_counts(frame)}")
    return figure


def _rows(body: str, methods: list[str]) -> dict[str, str]:
    """Choose the quantities that the bodies of a study have, with their labels."""
    left_out = set()
    if methods == ["ppo"]:  # which has no discriminator: a row of empty panels would only say so
        left_out.add("disc_reward")
    if bodies.get(body).family != "humanoid":
        left_out.add("episode_length")
    return {name: label for name, label in _QUANTITIES.items() if name not in left_out}


def _curves(rows: pd.DataFrame) -> list[pd.DataFrame]:
    return [results.load_curve(run_id) for run_id in rows["run_id"]]


def _draw_curves(
    axes: Axes,
    curves: dict[str, list[pd.DataFrame]],
    others: dict[str, list[pd.DataFrame]],
    quantity: str,
) -> None:
    """Draw one quantity of one body: mean and range over trials of every method."""
    axes.margins(x=0.01)
    axes.xaxis.set_major_locator(MaxNLocator(4))
    for method, trials in curves.items():
        look = style.method(method)
        for curve in others[method]:
            x, values = _on_one_grid([curve], quantity)
            if len(values):
                axes.plot(x / 1e6, values[0], color=look.color, lw=1.2, ls=_DASHES)
        x, values = _on_one_grid(trials, quantity)
        if len(values) == 0:
            continue
        axes.plot(x / 1e6, values.mean(axis=0), color=look.color, lw=1.5)
        if len(values) > 1:
            span = values.min(axis=0), values.max(axis=0)
            axes.fill_between(x / 1e6, *span, color=look.color, alpha=0.16, lw=0)
    if not axes.lines:
        runs = [*curves.values(), *others.values()]
        word = "not recorded" if any(runs) else "no run"
        middle: dict[str, Any] = {"transform": axes.transAxes, "ha": "center", "va": "center"}
        axes.text(0.5, 0.5, word, color=style.MUTED, **middle)


def _hide_made_up_ticks(grid: np.ndarray) -> None:
    """Take the ticks off rows and columns of panels without a curve: their scale means nothing."""
    for row in grid:
        if not any(axes.lines for axes in row):
            row[0].set_yticks([])
    for column in grid.T:
        if not any(axes.lines for axes in column):
            column[-1].set_xticks([])


def _on_one_grid(trials: list[pd.DataFrame], quantity: str) -> tuple[np.ndarray, np.ndarray]:
    """Bring the trials' curves to the same timesteps.

    Returns:
        Timesteps (P,) and values (N, P) of the trials that know the quantity.
    """
    known = [curve[["timesteps", quantity]].dropna() for curve in trials]
    known = [curve for curve in known if len(curve)]
    if not known:
        return np.empty(0), np.empty((0, 0))
    first = max(curve["timesteps"].iloc[0] for curve in known)
    last = min(curve["timesteps"].iloc[-1] for curve in known)
    x = np.linspace(first, last, _N_POINTS)
    values = [
        np.interp(x, curve["timesteps"], curve[quantity].rolling(
            min(_SMOOTHING, len(curve)), center=True, min_periods=1).mean())
        for curve in known
    ]  # fmt: skip
    return x, np.stack(values)


def _counts(frame: pd.DataFrame) -> str:
    counts = frame[~frame["stand_in"]].groupby(["method", "body"]).size()
    low, high = (int(counts.min()), int(counts.max())) if len(counts) else (0, 0)
    return str(low) if low == high else f"{low} to {high}"
