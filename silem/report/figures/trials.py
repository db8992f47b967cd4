"""Figures of the trials' scores: Figure 2b, the experts, the gaits, and Table 1 as a picture."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, MaxNLocator

from silem import bodies, paper
from silem.report import results, style
from silem.report.figures import cells, sources
from silem.study import statistics
from silem.util import seeding

_HOLLOW = "hollow: one trial, so no range"


def normalised_scores(frame: pd.DataFrame, bootstrap_seed: int = 0) -> Figure:
    """Draw Figure 2b: normalised scores of SILEM, SILEM⁻ and their rivals on every body.

    Left as in the paper, minimum, mean and maximum over trials, with the trials themselves as
    dots; right the interquartile mean with its 95 % bootstrap interval. A cell with one trial has
    neither range nor interval and is drawn hollow; a cell without runs is an empty slot.

    Args:
        frame: Runs of one study at one budget, from `results.load_records`.
        bootstrap_seed: Seed of the resampling.
    """
    frame = sources.runs_of("normalised_scores", frame)
    methods = sources.imitators(frame)
    looks = [style.method(m, results.original_body(frame)) for m in methods]

    def interval(axes: Axes, x: float, values: np.ndarray, method: str, body: str) -> None:
        generator = seeding.generator(bootstrap_seed, "bootstrap", method, body)
        summary = statistics.summarise(values, generator)
        cells.draw_interval(axes, x, summary, style.method(method))

    with style.applied():
        figure, (left, right) = style.new_figure(3.7, ncols=2, sharey=True)
        left.set(title="Minimum, mean, maximum", ylabel="score (1: the body's own PPO expert)")
        right.set(title="Interquartile mean, 95 % interval")
        for axes, draw in ((left, cells.draw_range), (right, interval)):
            level = paper.number("expert_level")
            axes.axhline(level, color=style.MUTED, lw=1, ls=cells.LEVEL_DASHES)
            cells.body_ticks(axes, frame, scale="expert")
            cells.draw_cells(axes, frame, methods, "normalised", draw)
        cells.room_for_counts(left, 0.0, 1.05)
        for axes in (left, right):
            cells.trial_counts(axes, frame, methods, "normalised")
        figure.legend(handles=cells.handles(looks), loc="outside upper left", ncols=4)
        sources.footer(figure, frame, f"{_HOLLOW} and no interval")
    return figure


def gaits(frame: pd.DataFrame) -> Figure:
    """Draw how the bodies move: forward speed and share of time upright, imitators and experts.

    A normalised score hides whether a body runs or stands: where the expert itself only stands, a
    score of 1 is standing.

    Args:
        frame: Runs of one study at one budget.
    """
    frame = sources.runs_of("gaits", frame)
    methods = [*sources.imitators(frame), "ppo"]
    looks = [style.method(m, results.original_body(frame)) for m in methods]
    with style.applied():
        figure, panels = style.new_figure(3.4, ncols=2)
        titles = {"speed_m_s": "Forward speed (m/s)", "upright": _upright_title(frame)}
        for axes, (column, title) in zip(panels, titles.items(), strict=True):
            axes.set(title=title)
            cells.body_ticks(axes, frame)
            cells.draw_cells(axes, frame, methods, column, cells.draw_range)
            cells.room_for_counts(axes, 0.0, 1.0)
            cells.trial_counts(axes, frame, methods, column)
        figure.legend(handles=cells.handles(looks), loc="outside upper left", ncols=5)
        note = f"minimum, mean, maximum over trials, whose number stands below; {_HOLLOW}"
        sources.footer(figure, frame, note)
    return figure


def experts(frame: pd.DataFrame) -> Figure:
    """Draw the PPO experts beside the random policy: return, forward speed and time upright.

    The speed tells what a return means: a body that only stands collects the alive bonus. Amber
    marks are the paper's: its two numbers for HC0, or the humanoids' highest possible return.

    Args:
        frame: Runs of one study at one budget.
    """
    frame = sources.runs_of("experts", frame)
    methods = ("ppo", "random")
    titles = {
        "return_mean": "Return of an episode",
        "speed_m_s": "Forward speed (m/s)",
        "upright": _upright_title(frame),
    }
    with style.applied():
        figure, panels = style.new_figure(3.1, ncols=3)
        for axes, (column, title) in zip(panels, titles.items(), strict=True):
            axes.set(title=title)
            cells.body_ticks(axes, frame)
            axes.tick_params(axis="x", labelsize=8)
            cells.draw_cells(axes, frame, methods, column, _solid)
            axes.margins(y=0.12)
            axes.update_datalim([(0.0, 0.0), (0.0, 1.0)])  # no zooming in on a lone run
            axes.autoscale_view(scalex=False)
        _thousands(panels[0])
        panels[2].set_ylim(-0.04, 1.08)
        handles = cells.handles([style.method(m, results.original_body(frame)) for m in methods])
        if label := _paper_marks(panels[0], frame):
            handles.append(Line2D([], [], color=style.PAPER, lw=2, label=label))
        figure.legend(handles=handles, loc="outside upper left", ncols=3)
        counts = [
            f"{body} {len(results.cell(frame, 'ppo', body))}" for body in results.body_names(frame)
        ]
        sources.footer(figure, frame, f"trials of the experts: {', '.join(counts)}")
    return figure


def affine_or_mlp(frame: pd.DataFrame) -> Figure:
    """Draw Table 1 trial by trial: the discriminator's reward against the true return on HC0.

    Where f is an MLP the paper finds a high discriminator reward with a poor return: the MLP
    makes bad states look like the expert's.

    Args:
        frame: Runs of one study at one budget.
    """
    frame = sources.runs_of("affine_or_mlp", frame)
    paper_rows = dict(zip(("silem-mlp", "silem"), paper.table("tab1").rows, strict=True))
    with style.applied():
        figure, axes = style.new_figure(3.4, width_in=5.6)
        handles = []
        for method, name in (("silem", "affine transform"), ("silem-mlp", "MLP")):
            look, row = style.method(method), paper_rows[method]
            rows = results.cell(frame, method, "HC0")
            points: dict[str, Any] = {"ls": "none", "marker": look.marker, "color": look.color}
            axes.plot(rows["disc_reward"], rows["return_mean"], ms=6, mec="white", **points)
            at = [row["discriminator_reward"]], [row["ground_truth_reward"]]
            axes.plot(*at, ms=12, mfc="none", mew=1.8, zorder=3, **points)
            label = f"{name}, {style.trials(len(rows))}"
            handles.append(Line2D([], [], label=label, ms=7, mec="white", **points))
        paper_mark: dict[str, Any] = {"marker": "o", "mfc": "white", "mec": style.MUTED, "mew": 1.8}
        handles.append(Line2D([], [], ls="none", ms=9, label="the paper's means", **paper_mark))
        for level in ("ppo", "random"):
            _level(axes, results.scores(frame, level, "HC0", "return_mean"), level)
        axes.grid(axis="x")
        axes.set(xlabel="discriminator reward of an episode", ylabel="true return of an episode")
        low, high = paper.number("disc_reward_range")
        axes.set_xlim(low - 20, high + 20)
        axes.margins(y=0.12)
        _thousands(axes)
        figure.legend(handles=handles, loc="outside upper left", ncols=3)
        sources.footer(figure, frame)
    return figure


def _solid(axes: Axes, x: float, values: np.ndarray, method: str, body: str) -> None:
    """Draw a cell's mean, and its trials beside it."""
    look = style.method(method)
    if len(values) > 1:
        places = np.full(len(values), x + 0.14)
        axes.plot(places, values, "o", ms=3.5, color=look.color, alpha=0.6, mec="none")
    cells.draw_mark(axes, x, float(values.mean()), look, hollow=False)


def _level(axes: Axes, returns: np.ndarray, method: str) -> None:
    """Mark a method's mean return across the panel."""
    if len(returns):
        mean = float(returns.mean())
        axes.axhline(mean, color=style.MUTED, lw=1, ls=cells.LEVEL_DASHES)
        axes.annotate(
            style.method(method).label, (1, mean), xycoords=("axes fraction", "data"),
            xytext=(0, 3), textcoords="offset points", ha="right", fontsize=8, color=style.MUTED,
        )  # fmt: skip


def _paper_marks(axes: Axes, frame: pd.DataFrame) -> str:
    """Mark the returns that the paper gives for a study's bodies; return what to call them."""
    names = results.body_names(frame)
    if "HC0" in names:
        place = names.index("HC0")
        for name in ("expert_return", "random_return"):
            value = paper.number(name)
            axes.plot(
                [place - 0.42, place + 0.42], [value, value], color=style.PAPER, lw=2, zorder=1.5
            )
        return "the paper's HC0"
    if bodies.get(names[0]).family == "humanoid":
        axes.axhline(paper.number("humanoid_max_return"), color=style.PAPER, lw=2, zorder=1.5)
        return "highest possible return"
    return ""


def _upright_title(frame: pd.DataFrame) -> str:
    return results.upright_label(frame).capitalize()


def _thousands(axes: Axes) -> None:
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: style.number(value)))
    axes.yaxis.set_major_locator(MaxNLocator(6))
