"""Learning curves: of a study's methods by body, of whole runs beside each other, of one run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from silem import bodies
from silem.report import results, scores, style
from silem.study.record import CURVE, CURVE_COLUMNS, RunRecord
from silem.util import files
from silem.util.errors import choose

QUANTITIES = {
    "return_mean": ("return of an episode", 0),
    "episode_length": ("steps before a fall", 0),
    "disc_reward": ("discriminator reward", 0),
    "speed_m_s": ("forward speed (m/s)", 2),
}
"""Columns of a curve: what each is called, and how many digits it is written with."""

_DASHES: tuple[Any, ...] = ("-", (0, (3, 2)), (0, (1, 1.2)))
_N_POINTS = 120
_SMOOTHING = 9  # points of the running mean: a curve's row holds only a few episodes
_ACCURACY = "disc_acc_expert"
_ALWAYS = ("return_mean", "speed_m_s")
_TAIL = 0.1  # of a curve, whose mean is compared with that of as much before it
_ONE_RUN = {
    "return_mean": "return of an episode",
    "episode_length": "steps before a fall",
    "speed_m_s": "forward speed (m/s)",
    "disc_reward": "discriminator reward of an episode",
    _ACCURACY: "discriminator accuracy",
    "policy_std": "policy's standard deviation",
}
"""One run's panels."""


@style.applied()
def learning_curves(frame: pd.DataFrame) -> Figure:
    """Draw return, discriminator reward and forward speed over timesteps, for each body.

    A line is the mean over a cell's trials, its band their minimum and maximum, both after a
    running mean, up to where the shortest ends; runs of another number of iterations than planned
    are dashed. Experts have no row for the discriminator; bodies that fall have one for when.
    """
    frame = scores.runs_of("learning_curves", frame)
    names = results.body_names(frame)
    drawn = [m for m in style.METHODS if (frame["method"] == m).any()]
    left_out = {"disc_reward"} if drawn == ["ppo"] else set()  # whose panels would all be empty
    left_out |= set() if results.can_fall(frame) else {"episode_length"}
    quantities = [name for name in QUANTITIES if name not in left_out]
    figure, grid = style.new_figure(
        2.0 * len(quantities), nrows=len(quantities), ncols=len(names), sharex="col",
        sharey="row", squeeze=False,
    )  # fmt: skip
    for column, body in zip(grid.T, names, strict=True):
        _draw_body(dict(zip(quantities, column, strict=True)), frame, drawn, body)
    for axes in grid[-1] if len(names) < 5 else grid[-1, len(names) // 2 :][:1]:
        axes.set_xlabel("million timesteps")
    for row, quantity in zip(grid, quantities, strict=True):
        row[0].set_ylabel(QUANTITIES[quantity][0])
        if not any(axes.lines for axes in row):
            row[0].set_yticks([])
    grid[0, 0].yaxis.set_major_formatter("{x:,.0f}")
    handles = _handles(drawn, frame)
    if frame["stand_in"].any():
        handles.append(style.handle(style.MUTED, scores.OTHER_LENGTH, ls=_DASHES[1]))
    if handles:
        figure.legend(handles=handles, loc="outside upper left", ncols=3)
    figure.align_labels()
    counts = frame[~frame["stand_in"]].groupby(["method", "body"]).size()
    several = " to ".join(dict.fromkeys(str(n) for n in (counts.min(), counts.max())))
    scores.footer(figure, frame, f"trials per curve: {several if len(counts) else 0}")
    return figure


def rises(frame: pd.DataFrame) -> list[bool]:
    """Tell of each run whether its return rose: the last tenth of its curve over the one before."""
    found = []
    for run_id in frame.loc[frame["n_steps"] > 0, "run_id"]:
        values = results.load_curve(run_id)["return_mean"].dropna().to_numpy()
        n = max(1, round(_TAIL * len(values)))
        if len(values) >= 2 * n:
            found.append(bool(values[-n:].mean() > values[-2 * n : -n].mean()))
    return found


@style.applied()
def compared_curves(groups: Mapping[str, pd.DataFrame]) -> Figure:
    """Draw every run of one to three tables, by name, over iterations: a dash per table."""
    first, lines = next(iter(groups.values())), []
    for dashes, frame in zip(_DASHES, groups.values(), strict=False):
        for run in frame[frame["n_steps"] > 0].itertuples():
            look = {"color": style.method(run.method).color, "ls": dashes, "lw": 1.6}
            lines.append((results.load_curve(run.run_id), look))
    panels = {name: title.capitalize() for name, (title, _) in QUANTITIES.items()}
    figure, _ = _draw_panels(panels, lines, height_in=4.6, n_columns=2)
    methods = {name for frame in groups.values() for name in frame["method"]}
    handles = _handles([name for name in style.METHODS if name in methods], first)
    for (name, frame), dashes in zip(groups.items(), _DASHES, strict=False):
        label = f"{name}: {style.trials(len(frame))}"
        handles.append(style.handle(style.MUTED, label, ls=dashes))
    figure.legend(handles=handles, loc="outside upper left", ncols=2)
    scores.footer(figure, first, "every run is a line of its own, unsmoothed", runs=False)
    return figure


@style.applied()
def exploratory(frame: pd.DataFrame, quantities: Sequence[str]) -> Figure:
    """Draw exploratory runs (`pages.open_settings.load`) over iterations, a panel per quantity."""
    panels = {name: QUANTITIES[choose("quantity", name, QUANTITIES)][0] for name in quantities}
    lines = []
    for index, run in enumerate(frame.itertuples()):
        look = {"color": f"C{index % 10}", "ls": ("-", (0, (5, 2)))[index // 10 % 2], "lw": 1.3}
        lines.append((run.curve, look | {"label": run.name}))
    height_in = 3.0 + 0.1 * len(frame)
    figure, grid = _draw_panels(panels, lines, height_in=height_in, n_columns=len(panels))
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=3, fontsize=8)
    style.footer(figure, f"{len(frame)} exploratory runs, one seed each; not evidence")
    return figure


@style.applied()
def of_run(record: RunRecord) -> Figure:
    """Draw one run's curve: the first four quantities that it knows, of a humanoid six."""
    curve = pd.DataFrame(files.read_csv(record.file(CURVE))).reindex(columns=CURVE_COLUMNS)
    known = {name for name in curve if curve[name].notna().any()}
    if not bodies.get(record.config["body"]).can_fall:
        known.discard("episode_length")
    shown = [name for name in _ONE_RUN if name in _ALWAYS or name in known]
    panels = {name: _ONE_RUN[name] for name in shown[: 6 if "episode_length" in known else 4]}
    marker = "o" if len(curve) < 12 else ""
    lines = [(curve, {"color": style.INK, "marker": marker, "ms": 3.5})]
    n_columns = 3 if len(panels) == 3 else 2
    figure, grid = _draw_panels(
        panels, lines, height_in=2.0 * -(-len(panels) // n_columns) + 0.4, n_columns=n_columns,
        word="no episode ended during training",
    )  # fmt: skip
    if _ACCURACY in panels:
        axes, color = grid[list(panels).index(_ACCURACY)], style.method("silem").color
        axes.plot(curve["iteration"], curve["disc_acc_learner"], color=color)
        axes.set_ylim(0, 1.05)
        axes.legend(axes.lines, ["on expert windows", "on learner windows"], loc="lower right")
    style.footer(figure, record.run_id)
    return figure


def _draw_panels(
    panels: Mapping[str, str],
    lines: Sequence[tuple[pd.DataFrame, dict[str, Any]]],
    *,
    height_in: float,
    n_columns: int,
    word: str = "no run",
) -> tuple[Figure, list[Axes]]:
    """Draw columns of some curves over iterations, each in a panel with its title."""
    size: dict[str, Any] = {"nrows": -(-len(panels) // n_columns), "ncols": n_columns}
    figure, grid = style.new_figure(height_in, sharex=True, squeeze=False, **size)
    shown, empty = list(grid.flat)[: len(panels)], list(grid.flat)[len(panels) :]
    for axes, (column, title) in zip(shown, panels.items(), strict=True):
        axes.set_title(title)
        for curve, look in lines:
            known = curve[["iteration", column]].dropna()
            if len(known):
                axes.plot(known["iteration"], known[column], **look)
        axes.ticklabel_format(axis="y", useOffset=False)
        if not axes.lines:
            axes.set_yticks([])
            style.say(axes, word)
    for axes in shown[-n_columns:]:
        axes.set_xlabel("iteration")
        axes.tick_params(labelbottom=True)
    for axes in empty:
        axes.set_axis_off()
    if not any(axes.lines for axes in shown):
        shown[0].set_xticks([])  # a scale without a curve means nothing
    return figure, shown


def _handles(methods: Sequence[str], frame: pd.DataFrame) -> list[Line2D]:
    """Name the methods' colours."""
    looks = [style.method(name, results.original_body(frame)) for name in methods]
    return [style.handle(look.color, look.label, lw=2.2) for look in looks]


def _draw_body(
    panels: Mapping[str, Axes], frame: pd.DataFrame, methods: Sequence[str], body: str
) -> None:
    """Draw a body's column of learning curves, a panel per quantity."""
    for method in methods:
        planned, others = (
            [results.load_curve(run_id) for run_id in of(frame, method, body)["run_id"]]
            for of in (results.cell, results.stand_ins)
        )
        for quantity, axes in panels.items():
            for curve in others:
                _draw_mean(axes, [curve], quantity, method, lw=1.2, ls=_DASHES[1])
            _draw_mean(axes, planned, quantity, method, lw=1.5)
    first, *_, last = panels.values()
    first.set_title(body)
    for axes in panels.values():
        axes.margins(x=0.01)
        axes.xaxis.set_major_locator(MaxNLocator(4))
        if not axes.lines:
            style.say(axes, "not recorded" if (frame["body"] == body).any() else "no run")
    if not any(axes.lines for axes in panels.values()):
        last.set_xticks([])  # a scale without a curve means nothing


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
