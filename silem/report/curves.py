"""Learning curves: of a study's methods by body, of whole runs beside each other, of one run."""

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from silem import bodies
from silem.report import results, scores, statistics, style
from silem.report.style import QUANTITIES
from silem.study.runs import CURVE, CURVE_COLUMNS, RunRecord
from silem.util import files
from silem.util.errors import choose

DRAWN = ("return_mean", "episode_length", "disc_reward", "speed_m_s")
"""The columns of a curve that figures of several runs show."""

_DASHES: tuple[Any, ...] = ("-", (0, (3, 2)), (0, (1, 1.2)), (0, (5, 1.5, 1, 1.5)))
_SMOOTHING = 9  # points of the running mean: a curve's row holds only a few episodes
_TAIL = 0.1  # of a curve, whose mean is compared with that of as much before it


@style.applied()
def learning_curves(frame: pd.DataFrame) -> Figure:
    """Draw return, discriminator reward and forward speed over timesteps, for each body.

    A line is the mean over a cell's trials, its band from `scores.INTERVAL_TRIALS` on Student's
    95 % interval of it at each step, else their minimum and maximum, all after a running mean, up
    to where the shortest ends. Experts have no row for the discriminator; bodies that fall have one
    for when.
    """
    frame = scores.runs_of("learning_curves", frame)
    names = results.body_names(frame)
    drawn = [m for m in style.METHODS if (frame["method"] == m).any()]
    left_out = {"disc_reward"} if drawn == ["ppo"] else set()  # whose panels would all be empty
    left_out |= set() if results.can_fall(frame) else {"episode_length"}
    quantities = [name for name in DRAWN if name not in left_out]
    size: dict[str, Any] = {"nrows": len(quantities), "ncols": len(names), "squeeze": False}
    figure, grid = style.new_figure(2.0 * len(quantities), sharex="col", sharey="row", **size)
    curves = {run: results.load_curve(run) for run in frame["run_id"]}
    for (row, quantity), (column, body) in product(enumerate(quantities), enumerate(names)):
        axes = grid[row, column]
        for method in drawn:
            trials = [curves[run] for run in results.cell(frame, method, body)["run_id"]]
            _draw_mean(axes, trials, quantity, method)
        axes.margins(x=0.01)
        axes.xaxis.set_major_locator(MaxNLocator(4 if len(names) < 5 else 2))
        if not axes.lines and (frame["body"] == body).any():
            style.say(axes, "not recorded")
    for row, quantity in zip(grid, quantities, strict=True):
        row[0].set_ylabel(QUANTITIES[quantity].heading)
    for column, body in zip(grid.T, names, strict=True):
        column[0].set_title(body)
        if len(names) < 5 or body == names[len(names) // 2]:
            column[-1].set_xlabel("million timesteps")
    grid[0, 0].yaxis.set_major_formatter("{x:,.0f}")
    figure.align_labels()
    counts = frame.groupby(["method", "body"]).size()
    bands = f"bands: minimum to maximum, from {scores.INTERVAL_TRIALS} trials on a 95 % t interval"
    note = f"trials per curve: {style.span(counts) if len(counts) else 0}; {bands}"
    return scores.finish(figure, frame, _handles(drawn, frame), note)


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
    """Draw every run of one to four tables, by name, over iterations: a dash per table."""
    first, lines, dashes = next(iter(groups.values())), [], {}
    for ls, (name, frame) in zip(_DASHES, groups.items(), strict=False):
        if len(frame):
            dashes[f"{name}: {style.trials(len(frame))}"] = ls
        for run in frame[frame["n_steps"] > 0].itertuples():
            look = {"color": style.method(run.method).color, "ls": ls, "lw": 1.6}
            lines.append((results.load_curve(run.run_id), look))
    figure, _ = draw(DRAWN, lines)
    methods = {name for frame in groups.values() for name in frame["method"]}
    handles = _handles([name for name in style.METHODS if name in methods], first)
    handles += [style.handle(style.MUTED, label, ls=ls) for label, ls in dashes.items()]
    note = "every run is a line of its own, unsmoothed"
    return scores.finish(figure, first, handles, note, ncols=2, runs=False)


@style.applied()
def exploratory(frame: pd.DataFrame, quantities: Sequence[str]) -> Figure:
    """Draw exploratory runs (`pages.open_settings.load`) over iterations, a panel per quantity."""
    panels = [choose("quantity", name, DRAWN) for name in quantities]
    looks = product(("-", (0, (5, 2))), (f"C{index}" for index in range(10)))
    lines = [
        (run.curve, {"label": run.name, "color": color, "ls": ls, "lw": 1.3})
        for run, (ls, color) in zip(frame.itertuples(), looks, strict=False)
    ]
    figure, grid = draw(panels, lines, 2.6 + 0.1 * len(frame), len(panels))
    note = f"{len(frame)} exploratory runs, one seed each; not evidence"
    return style.finish(figure, grid[0].get_legend_handles_labels()[0], note)


@style.applied()
def of_run(record: RunRecord) -> Figure:
    """Draw one run's curve: the first four quantities that it knows, of a humanoid six."""
    curve = pd.DataFrame(files.read_csv(record.file(CURVE))).reindex(columns=CURVE_COLUMNS)
    known = {name for name in curve if curve[name].notna().any()} | {"return_mean", "speed_m_s"}
    if not bodies.get(record.config["body"]).can_fall:
        known.discard("episode_length")
    shown = [name for name in (*DRAWN, "disc_acc_expert", "policy_std") if name in known]
    shown = shown[: 6 if "episode_length" in known else 4]
    look: dict[str, Any] = {"color": style.INK, "marker": "o" if len(curve) < 12 else "", "ms": 3.5}
    figure, grid = draw(shown, [(curve, look)], 2.0, 3 if len(shown) == 3 else 2)
    for axes in (axes for axes, name in zip(grid, shown, strict=True) if "acc" in name):
        look["color"] = style.method("silem").color
        axes.plot(curve["iteration"], curve["disc_acc_learner"], **look)
        axes.set_ylim(0, 1.05)
        axes.legend(axes.lines, ["on expert windows", "on learner windows"], loc="lower right")
    return style.finish(figure, note=record.run_id, word="no episode ended during training")


def draw(
    panels: Sequence[str],
    lines: Sequence[tuple[pd.DataFrame, dict[str, Any]]],
    row_in: float = 2.1,
    n_columns: int = 2,
) -> tuple[Figure, list[Axes]]:
    """Draw curves, each with its look, over iterations: a panel for each of `QUANTITIES`."""
    titles = (QUANTITIES[name].heading for name in panels)
    figure, grid = style.panels(titles, row_in, n_columns, sharex=True)
    for axes, column in zip(grid, panels, strict=True):
        for curve, look in lines:
            known = curve[["iteration", column]].dropna()
            if len(known):
                axes.plot(known["iteration"], known[column], **look)
        axes.ticklabel_format(axis="y", useOffset=False)
    for axes in grid[-n_columns:]:
        axes.set_xlabel("iteration")
    return figure, grid


def _handles(methods: Sequence[str], frame: pd.DataFrame) -> list[Line2D]:
    """Name the methods' colours."""
    looks = [style.method(name, results.original_body(frame)) for name in methods]
    return [style.handle(look.color, look.label, lw=2.2) for look in looks]


def _draw_mean(axes: Axes, trials: Sequence[pd.DataFrame], quantity: str, method: str) -> None:
    """Draw the mean of those trials that know a quantity, and their range, where all have begun."""
    known = [curve.set_index("timesteps")[quantity].dropna() for curve in trials]
    smooth = [c.rolling(min(_SMOOTHING, len(c)), 1, True).mean() for c in known if len(c)]
    if not smooth:
        return
    values = pd.concat(smooth, axis="columns").sort_index()
    values = values.interpolate("index", limit_area="inside").dropna()
    x, color = values.index / 1e6, style.method(method).color
    axes.plot(x, values.mean(axis="columns"), color=color, lw=1.5)
    if len(smooth) > 1:
        span: Any = values.min(axis="columns"), values.max(axis="columns")
        if len(smooth) >= scores.INTERVAL_TRIALS:
            span = np.transpose([statistics.interval(step) for step in values.to_numpy()])
        axes.fill_between(x, *span, color=color, alpha=0.16, lw=0)
