"""Learning curves: of a study's methods by body, of whole runs beside each other, of one run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import EngFormatter, MaxNLocator

from silem import bodies
from silem.report import results, scores, style
from silem.study.record import CURVE, RunRecord
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
# One run's panels: title, the columns, and each line's label.
_ONE_RUN: tuple[tuple[str, dict[str, str]], ...] = (
    ("return of an episode", {"return_mean": ""}),
    ("steps before a fall", {"episode_length": ""}),
    ("forward speed (m/s)", {"speed_m_s": ""}),
    ("discriminator reward of an episode", {"disc_reward": ""}),
    (
        "discriminator accuracy",
        {"disc_acc_expert": "on expert windows", "disc_acc_learner": "on learner windows"},
    ),
    ("policy's standard deviation", {"policy_std": ""}),
)
_ALWAYS = ("return of an episode", "forward speed (m/s)")


@style.applied()
def learning_curves(frame: pd.DataFrame) -> Figure:
    """Draw return, discriminator reward and forward speed over timesteps, for each body.

    A line is the mean over a cell's trials, its band their minimum and maximum, both after a
    running mean, up to where the shortest ends; runs of another number of iterations than planned
    are dashed. Experts have no row for the discriminator, humanoids one for steps before a fall.
    """
    frame = scores.runs_of("learning_curves", frame)
    names = results.body_names(frame)
    drawn = [m for m in style.METHODS if (frame["method"] == m).any()]
    left_out = {"disc_reward"} if drawn == ["ppo"] else set()  # whose panels would all be empty
    left_out |= {"episode_length"} if bodies.get(names[0]).family != "humanoid" else set()
    quantities = [name for name in QUANTITIES if name not in left_out]
    figure, grid = style.new_figure(
        2.0 * len(quantities), nrows=len(quantities), ncols=len(names), sharex="col",
        sharey="row", squeeze=False,
    )  # fmt: skip
    for column, body in zip(grid.T, names, strict=True):
        _draw_body(dict(zip(quantities, column, strict=True)), frame, drawn, body)
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


@style.applied()
def compared_curves(groups: Mapping[str, pd.DataFrame]) -> Figure:
    """Draw runs of some tables over iterations: a colour per method, a dash per table.

    Every run is a line of its own, whatever its number of iterations; nothing is smoothed. There
    are one to three tables of one body, by what to call them.
    """
    first = next(iter(groups.values()))
    methods = {name for frame in groups.values() for name in frame["method"]}
    figure, grid = style.new_figure(4.6, nrows=2, ncols=2, sharex=True)
    for axes, (quantity, (title, _)) in zip(grid.flat, QUANTITIES.items(), strict=True):
        axes.set_title(title.capitalize())
        for dashes, frame in zip(_DASHES, groups.values(), strict=False):
            for run in frame[frame["n_steps"] > 0].itertuples():
                curve = results.load_curve(run.run_id)[["iteration", quantity]].dropna()
                look: dict[str, Any] = {"color": style.method(run.method).color, "ls": dashes}
                axes.plot(curve["iteration"], curve[quantity], lw=1.6, **look)
        if not axes.lines:
            axes.set(xticks=[], yticks=[])
            style.say(axes, "no run")
    for axes in grid[1]:
        axes.set_xlabel("iteration")
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
    titles = [QUANTITIES[choose("quantity", name, QUANTITIES)][0] for name in quantities]
    height_in = 3.0 + 0.1 * len(frame)
    figure, panels = style.new_figure(height_in, ncols=len(quantities), squeeze=False)
    for axes, quantity, title in zip(panels[0], quantities, titles, strict=True):
        for index, run in enumerate(frame.itertuples()):
            known = run.curve[["iteration", quantity]].dropna()
            look = {"color": f"C{index % 10}", "ls": ("-", (0, (5, 2)))[index // 10 % 2]}
            axes.plot(known["iteration"], known[quantity], lw=1.3, label=run.name, **look)
        axes.set(title=title, xlabel="iteration")
    handles, labels = panels[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=3, fontsize=8)
    style.footer(figure, f"{len(frame)} exploratory runs, one seed each; not evidence")
    return figure


@style.applied()
def of_run(record: RunRecord) -> Figure:
    """Draw the learning curve of one run, a panel for each of the first quantities it knows.

    There are four at most, and six for a humanoid, whose episodes end with a fall.
    """
    table = pd.DataFrame(files.read_csv(record.file(CURVE)))
    # an older curve lacks the newest columns
    known = {name for name in table if table[name].notna().any()}
    if bodies.get(record.config["body"]).engine == "bullet":  # nobody falls
        known.discard("episode_length")
    panels = [panel for panel in _ONE_RUN if panel[0] in _ALWAYS or known & panel[1].keys()]
    panels = panels[: 6 if "episode_length" in known else 4]
    n_columns = 3 if len(panels) == 3 else 2
    n_rows = -(-len(panels) // n_columns)
    figure, grid = style.new_figure(
        2.0 * n_rows + 0.4, nrows=n_rows, ncols=n_columns, sharex=True, squeeze=False
    )
    for axes in grid.flat[len(panels) :]:
        axes.set_axis_off()
    for axes, (title, lines) in zip(grid.flat, panels, strict=False):
        axes.set_title(title)
        _draw_lines(axes, table, lines)
    for axes in grid.flat[len(panels) - n_columns : len(panels)]:
        axes.set_xlabel("timesteps")
        axes.tick_params(labelbottom=True)
    style.footer(figure, record.run_id)
    return figure


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
    last.set_xlabel("million timesteps")
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


def _draw_lines(axes: Axes, table: pd.DataFrame, lines: dict[str, str]) -> None:
    colors = style.INK, style.method("silem").color
    for color, (column, label) in zip(colors, lines.items(), strict=False):
        known = table.reindex(columns=["timesteps", column]).dropna()
        if known.empty:
            words: dict[str, Any] = {"ha": "center", "va": "center", "color": style.MUTED}
            place = axes.transAxes
            axes.text(0.5, 0.5, "no episode ended during training", transform=place, **words)
            axes.set_yticks([])
            continue
        marker = "o" if len(known) < 12 else ""
        look: dict[str, Any] = {"marker": marker, "ms": 3.5, "color": color, "label": label}
        axes.plot(known["timesteps"], known[column], **look)
        axes.ticklabel_format(axis="y", useOffset=False)
        axes.yaxis.set_major_locator(MaxNLocator(5))
    if any(lines.values()):
        axes.set_ylim(0, 1.05)
        axes.legend(loc="lower right")
    axes.set_xlim(0, table["timesteps"].iloc[-1] * 1.03)
    axes.xaxis.set_major_formatter(EngFormatter())
    axes.xaxis.set_major_locator(MaxNLocator(5))
