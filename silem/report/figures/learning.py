"""Learning curves: of every method on every body of a study, and of one body in several studies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
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
_DASHES: tuple[Any, ...] = ("-", (0, (3, 2)), (0, (1, 1.2)))
_N_POINTS = 120
_SMOOTHING = 9  # points of the running mean: a curve's row holds only a few episodes


def learning_curves(frame: pd.DataFrame) -> Figure:
    """Draw return, discriminator reward and forward speed over timesteps, for each body.

    A line is the mean over a cell's trials, its band their minimum and maximum, both after a
    running mean over 9 of the curve's at most 200 points. Trials are drawn up to where the
    shortest ends; runs of another number of iterations than planned are dashed. Where all
    runs are experts' there is no row for the discriminator. Humanoids' episodes end with a fall,
    and a row shows when.
    """
    frame = sources.runs_of("learning_curves", frame)
    names = results.body_names(frame)
    drawn = [m for m in style.METHODS if (frame["method"] == m).any()]
    left_out = {"disc_reward"} if drawn == ["ppo"] else set()  # whose panels would all be empty
    left_out |= {"episode_length"} if bodies.get(names[0]).family != "humanoid" else set()
    quantities = [name for name in _QUANTITIES if name not in left_out]
    with style.applied():
        figure, grid = style.new_figure(
            2.0 * len(quantities), nrows=len(quantities), ncols=len(names), sharex="col",
            sharey="row", squeeze=False,
        )  # fmt: skip
        for column, body in zip(grid.T, names, strict=True):
            column[0].set_title(body)
            for method in drawn:
                curves = _curves(results.cell(frame, method, body))
                others = _curves(results.stand_ins(frame, method, body))
                for axes, quantity in zip(column, quantities, strict=True):
                    for curve in others:
                        _draw_mean(axes, [curve], quantity, method, lw=1.2, ls=_DASHES[1])
                    _draw_mean(axes, curves, quantity, method, lw=1.5)
            word = "not recorded" if (frame["body"] == body).any() else "no run"
            for axes in column:
                axes.margins(x=0.01)
                axes.xaxis.set_major_locator(MaxNLocator(4))
                if not axes.lines:
                    cells.say(axes, word)
            column[-1].set_xlabel("million timesteps")
            if not any(axes.lines for axes in column):
                column[-1].set_xticks([])  # a scale without a curve means nothing
        for row, quantity in zip(grid, quantities, strict=True):
            row[0].set_ylabel(_QUANTITIES[quantity])
            if not any(axes.lines for axes in row):
                row[0].set_yticks([])
        grid[0, 0].yaxis.set_major_formatter(FuncFormatter(lambda value, _: style.number(value)))
        dashes = [(cells.OTHER_LENGTH, _DASHES[1])] if frame["stand_in"].any() else []
        _legend(figure, drawn, results.original_body(frame), dashes, ncols=3)
        figure.align_ylabels(grid[:, 0])
        figure.align_xlabels(grid[-1])
        counts = frame[~frame["stand_in"]].groupby(["method", "body"]).size()
        low, high = (counts.min(), counts.max()) if len(counts) else (0, 0)
        several = str(low) if low == high else f"{low} to {high}"
        sources.footer(figure, frame, f"trials per curve: {several}")
    return figure


def compared_curves(groups: Mapping[str, pd.DataFrame]) -> Figure:
    """Draw runs of some tables over iterations: a colour per method, a dash per table.

    Every run is a line of its own, whatever its number of iterations; nothing is smoothed. An
    iteration's value is the mean over the episodes that ended in it.

    Args:
        groups: One to three tables of `results.load_records` by what to call them, all of one body.
    """
    first = next(iter(groups.values()))
    methods = {name for frame in groups.values() for name in frame["method"]}
    drawn = [name for name in style.METHODS if name in methods]
    with style.applied():
        figure, grid = style.new_figure(4.6, nrows=2, ncols=2, sharex=True)
        for axes, (quantity, title) in zip(grid.flat, _QUANTITIES.items(), strict=True):
            axes.set_title(title.capitalize())
            for dashes, frame in zip(_DASHES, groups.values(), strict=False):
                for run in frame[frame["n_steps"] > 0].itertuples():
                    curve = results.load_curve(run.run_id)[["iteration", quantity]].dropna()
                    color = style.method(run.method).color
                    axes.plot(curve["iteration"], curve[quantity], color=color, ls=dashes, lw=1.6)
            if not axes.lines:
                axes.set(xticks=[], yticks=[])
                cells.say(axes, "no run")
        for axes in grid[1]:
            axes.set_xlabel("iteration")
        named = [f"{name}: {style.trials(len(frame))}" for name, frame in groups.items()]
        others = list(zip(named, _DASHES, strict=False))
        _legend(figure, drawn, results.original_body(first), others, ncols=2)
        sources.footer(figure, first, "every run is a line of its own, unsmoothed", runs=False)
    return figure


def _legend(
    figure: Figure,
    methods: Sequence[str],
    original: str,
    dashes: Sequence[tuple[str, Any]],
    ncols: int,
) -> None:
    """Name the methods' colours, and then what dashes mean."""
    looks = [style.method(name, original) for name in methods]
    handles = [style.handle(look.color, look.label, lw=2.2) for look in looks]
    handles += [style.handle(style.MUTED, label, ls=ls) for label, ls in dashes]
    if handles:
        figure.legend(handles=handles, loc="outside upper left", ncols=ncols)


def _curves(rows: pd.DataFrame) -> list[pd.DataFrame]:
    return [results.load_curve(run_id) for run_id in rows["run_id"]]


def _draw_mean(
    axes: Axes, trials: Sequence[pd.DataFrame], quantity: str, method: str, **look: Any
) -> None:
    """Draw the mean of those trials that know a quantity, and their range, on one grid of steps."""
    known = [curve[["timesteps", quantity]].dropna() for curve in trials]
    known = [curve for curve in known if len(curve)]
    if not known:
        return
    first = max(curve["timesteps"].iloc[0] for curve in known)
    last = min(curve["timesteps"].iloc[-1] for curve in known)
    x, color = np.linspace(first, last, _N_POINTS), style.method(method).color
    smooth = [c.rolling(min(_SMOOTHING, len(c)), center=True, min_periods=1).mean() for c in known]
    values = [
        np.interp(x, curve["timesteps"], means[quantity])
        for curve, means in zip(known, smooth, strict=True)
    ]
    axes.plot(x / 1e6, np.mean(values, axis=0), color=color, **look)
    if len(values) > 1:
        span = np.min(values, axis=0), np.max(values, axis=0)
        axes.fill_between(x / 1e6, *span, color=color, alpha=0.16, lw=0)
