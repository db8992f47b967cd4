"""Figures of the trials' scores: Figure 2b with its gaits, the experts, and Table 1 drawn."""

from __future__ import annotations

from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from silem import bodies, paper
from silem.report import results, style
from silem.report.figures import cells, sources

_MEAN: dict[str, Any] = {"lw": 1, "ls": cells.LEVEL_DASHES}
_BEST: dict[str, Any] = {"lw": 1, "ls": (0, (1, 2))}


def normalised_scores(frame: pd.DataFrame) -> Figure:
    """Draw Figure 2b, and whether a score is a gait.

    Left, as in the paper, minimum, mean and maximum over trials of the normalised score, with the
    trials as dots and, at five trials and more, Student's interval of the mean. Right the forward
    speed of the same trials and of the experts: where the expert only stands, a score of 1 is
    standing. A single trial is hollow, a cell without runs an empty slot.
    """
    frame = sources.runs_of("normalised_scores", frame)
    imitators, everyone = sources.IMITATORS, [*sources.IMITATORS, "ppo"]
    original = results.original_body(frame)
    with style.applied():
        figure, (left, right) = style.new_figure(3.9, ncols=2)
        left.set(title="Score: minimum, mean, maximum over trials")
        right.set(title="Forward speed (m/s)")
        level = paper.number("expert_level")
        left.axhline(level, color=style.MUTED, **_MEAN)
        for index, body in enumerate(results.body_names(frame)):
            best = results.scores(frame, "ppo", body).max(initial=level)
            if best > level:
                left.plot([index - 0.44, index + 0.44], [best, best], color=style.INK, **_BEST)
        cells.body_ticks(left, frame, scale="experts")
        cells.body_ticks(right, frame)
        panels = (left, "normalised", imitators), (right, "speed_m_s", everyone)
        for axes, column, shown in panels:
            cells.draw_cells(axes, frame, shown, column, counts=True)
            cells.room_for_counts(axes, 0.0, 1.05)
        handles = cells.handles([style.method(method, original) for method in everyone])
        handles.append(style.handle(style.MUTED, "mean of the body's experts", **_MEAN))
        handles.append(style.handle(style.INK, "the best of them, the demonstrator", **_BEST))
        figure.legend(handles=handles, loc="outside upper left", ncols=3)
        sources.footer(figure, frame, cells.interval_note(frame, everyone, "speed_m_s"))
    return figure


def experts(frame: pd.DataFrame) -> Figure:
    """Draw the PPO experts beside the random policy: return, forward speed and time upright.

    The speed tells what a return means: a body that only stands collects the alive bonus. Amber
    marks are the paper's: its two numbers for HC0, or the humanoids' highest possible return.
    """
    frame = sources.runs_of("experts", frame)
    methods = ("ppo", "random")
    titles = {
        "return_mean": "Return of an episode",
        "speed_m_s": "Forward speed (m/s)",
        "upright": results.upright_label(frame).capitalize(),
    }
    with style.applied():
        figure, panels = style.new_figure(3.1, ncols=3)
        for axes, (column, title) in zip(panels, titles.items(), strict=True):
            axes.set(title=title)
            cells.body_ticks(axes, frame)
            axes.tick_params(axis="x", labelsize=8)
            cells.draw_cells(axes, frame, methods, column)
            axes.margins(y=0.12)
            axes.update_datalim([(0.0, 0.0), (0.0, 1.0)])  # no zooming in on a lone run
            axes.autoscale_view(scalex=False)
        _thousands(panels[0])
        panels[2].set_ylim(-0.04, 1.08)
        handles = cells.handles([style.method(m, results.original_body(frame)) for m in methods])
        if label := _paper_marks(panels[0], results.body_names(frame)):
            handles.append(style.handle(style.PAPER, label, lw=2))
        figure.legend(handles=handles, loc="outside upper left", ncols=3)
        sources.footer(figure, frame, cells.interval_note(frame, methods[:1], "return_mean"))
    return figure


def affine_or_mlp(frame: pd.DataFrame) -> Figure:
    """Draw Table 1 trial by trial: the discriminator's reward against the true return on HC0.

    Where f is an MLP the paper finds a high discriminator reward with a poor return: the MLP
    makes bad states look like the expert's.
    """
    frame = sources.runs_of("affine_or_mlp", frame)
    mlp, affine = paper.table("tab1").rows
    with style.applied():
        figure, axes = style.new_figure(3.4, width_in=5.6)
        handles = []
        shown = ("silem", "affine transform", affine), ("silem-mlp", "MLP", mlp)
        for method, name, printed in shown:
            look, rows = style.method(method), results.cell(frame, method, "HC0")
            points: dict[str, Any] = {"ls": "none", "marker": look.marker, "color": look.color}
            axes.plot(rows["disc_reward"], rows["return_mean"], ms=6, mec="white", **points)
            at = [printed["discriminator_reward"]], [printed["ground_truth_reward"]]
            axes.plot(*at, ms=12, mfc="none", mew=1.8, zorder=3, gid=style.GHOST, **points)
            label = f"{name}, {style.trials(len(rows))}"
            handles.append(style.handle(label=label, ms=7, mec="white", **points))
        paper_mark: dict[str, Any] = {"marker": "o", "mfc": "white", "mec": style.MUTED, "mew": 1.8}
        paper_mark |= {"ls": "none", "ms": 9, "gid": style.GHOST}
        handles.append(style.handle(style.MUTED, "the paper's means", **paper_mark))
        for method in ("ppo", "random"):
            _level(axes, frame, method)
        axes.grid(axis="x")
        axes.set(xlabel="discriminator reward of an episode", ylabel="true return of an episode")
        low, high = paper.number("disc_reward_range")
        axes.set_xlim(low - 20, high + 20)
        axes.margins(y=0.12)
        _thousands(axes)
        figure.legend(handles=handles, loc="outside upper left", ncols=3)
        sources.footer(figure, frame)
    return figure


def _level(axes: Axes, frame: pd.DataFrame, method: str) -> None:
    """Mark a method's mean return on HC0 across the panel."""
    returns = results.scores(frame, method, "HC0", "return_mean")
    if len(returns):
        axes.axhline(returns.mean(), color=style.MUTED, **_MEAN)
        axes.annotate(
            style.method(method).label, (1, returns.mean()), xycoords=("axes fraction", "data"),
            xytext=(0, 3), textcoords="offset points", ha="right", fontsize=8, color=style.MUTED,
        )  # fmt: skip


def _paper_marks(axes: Axes, names: list[str]) -> str:
    """Mark the returns that the paper gives for a study's bodies; return what to call them."""
    look: dict[str, Any] = {"color": style.PAPER, "lw": 2, "zorder": 1.5}
    if "HC0" in names:
        ends = [names.index("HC0") - 0.42, names.index("HC0") + 0.42]
        for name in ("expert_return", "random_return"):
            axes.plot(ends, [paper.number(name)] * 2, **look)
        return "the paper's HC0"
    if bodies.get(names[0]).family == "humanoid":
        axes.axhline(paper.number("humanoid_max_return"), **look)
        return "highest possible return"
    return ""


def _thousands(axes: Axes) -> None:
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: style.number(value)))
    axes.yaxis.set_major_locator(MaxNLocator(6))
