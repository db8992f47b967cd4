"""Figures of the trials' scores: Figure 2b with its gaits, the experts, and Table 1 drawn."""

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


def normalised_scores(frame: pd.DataFrame) -> Figure:
    """Draw Figure 2b, and whether a score is a gait.

    Left, as in the paper, minimum, mean and maximum over trials of the normalised score, with the
    trials as dots and, at five trials and more, Student's interval of the mean. Right the forward
    speed of the same trials and of the experts: where the expert only stands, a score of 1 is
    standing. A single trial is hollow, a cell without runs an empty slot.

    Args:
        frame: Runs of one study at one budget, from `results.load_records`.
    """
    frame = sources.runs_of("normalised_scores", frame)
    methods = sources.imitators(frame)
    original = results.original_body(frame)
    with style.applied():
        figure, (left, right) = style.new_figure(3.9, ncols=2)
        left.set(title="Score: minimum, mean, maximum over trials")
        right.set(title="Forward speed (m/s)")
        level = paper.number("expert_level")
        left.axhline(level, color=style.MUTED, lw=1, ls=cells.LEVEL_DASHES)
        for index, body in enumerate(results.body_names(frame)):
            best = results.scores(frame, "ppo", body).max(initial=level)
            if best > level:
                left.plot([index - 0.44, index + 0.44], [best, best], **_BEST)
        for axes, column, shown in (
            (left, "normalised", methods), (right, "speed_m_s", [*methods, "ppo"]),
        ):  # fmt: skip
            cells.body_ticks(axes, frame, scale="experts" if axes is left else "")
            cells.draw_cells(axes, frame, shown, column)
            cells.room_for_counts(axes, 0.0, 1.05)
            cells.trial_counts(axes, frame, shown, column)
        handles = cells.handles([style.method(m, original) for m in [*methods, "ppo"]])
        mean: dict[str, Any] = {"color": style.MUTED, "lw": 1, "ls": cells.LEVEL_DASHES}
        handles.append(Line2D([], [], label="mean of the body's experts", **mean))
        handles.append(Line2D([], [], label="the best of them, the demonstrator", **_BEST))
        figure.legend(handles=handles, loc="outside upper left", ncols=3)
        sources.footer(figure, frame, cells.interval_note(frame, [*methods, "ppo"], "speed_m_s"))
    return figure


_BEST: dict[str, Any] = {"color": style.INK, "lw": 1, "ls": (0, (1, 2))}


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
        if label := _paper_marks(panels[0], frame):
            handles.append(Line2D([], [], color=style.PAPER, lw=2, label=label))
        figure.legend(handles=handles, loc="outside upper left", ncols=3)
        sources.footer(figure, frame, cells.interval_note(frame, methods[:1], "return_mean"))
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


def _thousands(axes: Axes) -> None:
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: style.number(value)))
    axes.yaxis.set_major_locator(MaxNLocator(6))
