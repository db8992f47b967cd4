"""Figures of learning: curves over timesteps, and the affine transforms that were learned."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, MaxNLocator

from silem.errors import SilemError
from silem.report import results, style
from silem.report.features import feature_names
from silem.report.figures import sources

_QUANTITIES = {
    "return_mean": "return of an episode",
    "disc_reward": "discriminator reward",
    "speed_m_s": "forward speed (m/s)",
}
_N_POINTS = 120
_SMOOTHING = 9  # points of the running mean: a curve's row holds only a few episodes
_BODY_MARKERS = ("o", "s", "^", "D", "v", "P", "X")


def learning_curves(frame: pd.DataFrame) -> Figure:
    """Draw return, discriminator reward and forward speed over timesteps, for each body.

    A line is the mean over a cell's trials, its band their minimum and maximum, both after a
    running mean over 9 of the curve's at most 200 points. Trials are drawn up to where the
    shortest ends. Where all runs are experts' there is no row for the discriminator.

    Args:
        frame: Runs of one study at one budget.
    """
    frame = sources.runs_of("learning_curves", frame)
    names = results.body_names(frame)
    drawn = [m for m in style.METHODS if (frame["method"] == m).any()]
    # experts have no discriminator, and a row of empty panels would only say so
    only_experts = drawn == ["ppo"]
    quantities = {k: v for k, v in _QUANTITIES.items() if not (only_experts and k == "disc_reward")}
    looks = [style.method(m, results.original_body(frame)) for m in drawn]
    with style.applied():
        figure, grid = style.new_figure(
            2.0 * len(quantities), nrows=len(quantities), ncols=len(names), sharex="col",
            sharey="row", squeeze=False,
        )  # fmt: skip
        for column, body in enumerate(names):
            curves = {m: _curves(results.cell(frame, m, body)) for m in drawn}
            grid[0, column].set_title(body)
            for row, quantity in enumerate(quantities):
                _draw_curves(grid[row, column], curves, quantity)
            grid[-1, column].set_xlabel("million timesteps")
        for row, label in enumerate(quantities.values()):
            grid[row, 0].set_ylabel(label)
        grid[0, 0].yaxis.set_major_formatter(FuncFormatter(lambda value, _: style.number(value)))
        handles = [Line2D([], [], color=k.color, lw=2.2, label=k.label) for k in looks]
        if handles:
            figure.legend(handles=handles, loc="outside upper left", ncols=3)
        _hide_made_up_ticks(grid)
        figure.align_ylabels(grid[:, 0])
        figure.align_xlabels(grid[-1])
        sources.footer(figure, frame, f"trials per curve: {_counts(frame)}")
    return figure


def transforms(frame: pd.DataFrame) -> Figure:
    """Draw the affine transforms that were learned: A's diagonal and b, for each feature.

    As Figures 4a and 4b of the paper, with one row per named feature: a small mark per trial, a
    large one for the trials' mean. An untrained transform has A = 1 and b = 0.

    Args:
        frame: Runs of one study at one budget.

    Raises:
        SilemError: Some transform has not as many entries as its body has features.
    """
    frame = sources.runs_of("transforms", frame)
    names = results.body_names(frame)
    features = feature_names(names[0])
    with style.applied():
        figure, (left, right) = style.new_figure(6.4, ncols=2, sharey=True)
        left.set(title="A, diagonal (1: unchanged)", ylim=(len(features) - 0.4, -0.6))
        right.set(title="b, offset (0: unchanged)")
        left.set_yticks(range(len(features)), features)
        _feature_lines(left, features, neutral=1.0)
        _feature_lines(right, features, neutral=0.0)
        handles = []
        for index, body in enumerate(names):
            run_ids = results.cell(frame, "silem", body)["run_id"]
            handles.append(_body_handle(body, index, len(names), len(run_ids)))
            if len(run_ids) == 0:
                continue
            loaded = [results.load_transform(run_id) for run_id in run_ids]
            for axes, key in ((left, "A"), (right, "b")):
                values = np.stack([arrays[key] for arrays in loaded])
                if values.shape[1:] != (len(features),):
                    raise SilemError(
                        f"transforms of {body}: {values.shape[1:]} for {len(features)} features"
                    )
                _draw_transform(axes, values, index, len(names))
        figure.legend(handles=handles, loc="outside upper left", ncols=len(names))
        sources.footer(figure, frame)
    return figure


def _curves(rows: pd.DataFrame) -> list[pd.DataFrame]:
    return [results.load_curve(run_id) for run_id in rows["run_id"]]


def _draw_curves(axes: Axes, curves: dict[str, list[pd.DataFrame]], quantity: str) -> None:
    """Draw one quantity of one body: mean and range over trials of every method."""
    axes.margins(x=0.01)
    axes.xaxis.set_major_locator(MaxNLocator(4))
    anything = False
    for method, trials in curves.items():
        x, values = _on_one_grid(trials, quantity)
        if len(values) == 0:
            continue
        anything = True
        look = style.method(method)
        axes.plot(x / 1e6, values.mean(axis=0), color=look.color, lw=1.5)
        if len(values) > 1:
            span = values.min(axis=0), values.max(axis=0)
            axes.fill_between(x / 1e6, *span, color=look.color, alpha=0.16, lw=0)
    if not anything:
        word = "not recorded" if any(curves.values()) else "no run"
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
    counts = frame.groupby(["method", "body"]).size()
    low, high = (int(counts.min()), int(counts.max())) if len(counts) else (0, 0)
    return str(low) if low == high else f"{low} to {high}"


def _feature_lines(axes: Axes, features: list[str], neutral: float) -> None:
    """Draw what lies behind the marks: a line per feature, and where nothing is changed."""
    axes.grid(axis="y", visible=True)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.axvline(neutral, color=style.MUTED, lw=1, ls=(0, (4, 3)))
    axes.update_datalim([(neutral - 0.1, 0), (neutral + 0.1, 0)])  # shown at least
    axes.autoscale_view(scaley=False)
    # Bands tell the torso's features, the joints' and the contacts' apart.
    joints = [i for i, name in enumerate(features) if name.endswith(("angle", "velocity"))]
    joints = [i for i in joints if i > features.index("pitch")]
    axes.axhspan(joints[0] - 0.5, joints[-1] + 0.5, color="#f6f6f6", lw=0, zorder=0)


def _draw_transform(axes: Axes, values: np.ndarray, index: int, count: int) -> None:
    """Draw one body's transforms, values (N, F)."""
    rows = np.arange(values.shape[1]) + (index - (count - 1) / 2) * 0.26
    color, marker = style.body_color(index, count), _BODY_MARKERS[index]
    if len(values) > 1:
        for trial in values:
            axes.plot(trial, rows, marker, ms=2.5, color=color, alpha=0.45, mec="none")
    axes.plot(values.mean(axis=0), rows, marker, ms=5, color=color, mec="white", mew=0.5)


def _body_handle(body: str, index: int, count: int, n_trials: int) -> Line2D:
    return Line2D(
        [], [], ls="none", marker=_BODY_MARKERS[index], ms=7, mec="white",
        color=style.body_color(index, count), label=f"{body}, {style.trials(n_trials)}",
    )  # fmt: skip
