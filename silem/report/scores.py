"""Figures of the trials' scores: Figure 2b with its gaits, Figure 3b, the experts, Table 1 drawn.

A panel has its bodies along the x axis, 1 apart, and for each a slot per method, left to right: a
cell of a study, with its trials, their minimum, mean and maximum, and their interval.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain, zip_longest
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import ScaledTranslation

from silem import bodies, paper
from silem.bodies.humanoid import DEMONSTRATOR_SPEED_M_S
from silem.report import results, statistics, style
from silem.study.settings import BUDGETS, METHODS
from silem.util.errors import SilemError, choose

INTERVAL_TRIALS = 5
"""Trials below which no figure draws an interval."""

OTHER_LENGTH = "shorter or longer run"
IMITATORS = ("silem", "silem-minus", "silem-minus-own")
"""The groups of Figures 2b and 2d, in the paper's order."""

COMPARED = ("silem", "silem-minus", "tpil", "peng20")
"""The methods of Figure 3b."""

# Figure -> methods, bodies (None: all). Experts belong to Figure 2b: they set its scale.
_SHOWN: dict[str, tuple[tuple[str, ...], tuple[str, ...] | None]] = {
    "normalised_scores": (("ppo", *IMITATORS), None),
    "figure_2d": (("ppo", *IMITATORS, "random"), None),
    "experts": (("ppo", "random"), None),
    "affine_or_mlp": (("ppo", "random", "silem", "silem-mlp"), ("HC0",)),
    "learning_curves": (tuple(m for m in METHODS if m != "random"), None),
    "by_feature": (("silem",), None),
    "humanoid_scores": (("ppo", *COMPARED), ("Atlas", "Humanoid", "HumanoidR")),
    "figure_4": (("silem",), ("Humanoid", "HumanoidR")),
}
# The figures that mark runs of another number of iterations; the others leave them out.
_WITH_STAND_INS = ("learning_curves", "humanoid_scores", "figure_4")
_MEAN: dict[str, Any] = {"color": style.MUTED, "lw": 1, "ls": style.DASHED}
_BEST: dict[str, Any] = {"color": style.INK, "lw": 1, "ls": (0, (1, 2))}
_DOTTED: dict[str, Any] = {"color": style.INK, "lw": 1.5, "ls": (0, (1, 1.5))}
_LEVEL: dict[str, Any] = {"color": style.MUTED, "lw": 1.2, "ls": style.DASHED}
_MAX_RETURN = paper.number("humanoid_max_return")
_HUMANOID_PANELS = {
    "return_mean": ("True return of an episode: minimum, mean, maximum over trials", _MAX_RETURN),
    "upright": ("Share of steps survived", 1.0),
    "speed_m_s": ("Speed (m/s)", DEMONSTRATOR_SPEED_M_S),
}
"""Columns of the table, each with its panel's title and the highest value on its scale."""


def runs_of(figure: str, frame: pd.DataFrame) -> pd.DataFrame:
    """Return the runs that a figure, named by its function, shows: those and no others."""
    methods, names = _SHOWN[choose("figure", figure, _SHOWN)]
    study, _ = results.context(frame)
    if names and not set(names) <= (known := set(results.body_names(frame))):
        raise SilemError(
            f"{figure} shows {', '.join(names)}; the runs of study {study!r} are of"
            f" {', '.join(sorted(known))}"
        )
    shown = results.select(frame, methods, names, with_stand_ins=figure in _WITH_STAND_INS)
    shown.attrs["figure"] = figure
    return shown


def footer(figure: Figure, frame: pd.DataFrame, note: str = "", *, runs: bool = True) -> None:
    """Write under a figure which budget and how many runs it shows, and warn of toy budgets."""
    budget = results.context(frame)[1]
    shown = results.describe(frame) if runs else f"budget {budget}"
    text = "; ".join(part for part in (shown, note) if part)
    evidence = BUDGETS[budget].is_evidence
    style.footer(figure, text if evidence else f"not evidence: {text}", warn=not evidence)


@style.applied()
def normalised_scores(frame: pd.DataFrame) -> Figure:
    """Draw Figure 2b, and whether a score is a gait.

    Left, as in the paper, the normalised scores, right the forward speed of the same trials and of
    the experts: where the expert only stands, a score of 1 is standing.
    """
    figure, panels = style.new_figure(3.9, ncols=2)
    return _draw_scores(figure, panels, runs_of("normalised_scores", frame))


@style.applied()
def figure_2d(frame: pd.DataFrame) -> Figure:
    """Draw Figure 2d: the Ants' scores, and below them their speed, and the steps before a fall."""
    figure, panels = style.new_figure(7.2, nrows=3)
    return _draw_scores(figure, panels, runs_of("figure_2d", frame), ("random",))


def _draw_scores(
    figure: Figure, panels: Sequence[Axes], frame: pd.DataFrame, low: tuple[str, ...] = ()
) -> Figure:
    """Draw scores in the first panel, speed in the second, steps of an episode in a third."""
    everyone, level = [*IMITATORS, "ppo", *low], paper.number("expert_level")
    titles = {
        "normalised": "Score: minimum, mean, maximum over trials",
        "speed_m_s": "Forward speed (m/s)",
        "steps": "Steps of an episode, at most 1,000",
    }
    panels[0].axhline(level, **_MEAN)
    for index, body in enumerate(results.body_names(frame)):
        best = results.scores(frame, "ppo", body).max(initial=level)
        if best > level:
            panels[0].plot([index - 0.44, index + 0.44], [best, best], **_BEST)
    for axes, (column, title) in zip(panels, titles.items(), strict=False):
        first = column == "normalised"
        axes.set(title=title)
        _body_ticks(axes, frame, scale="experts" if first else "")
        _draw_cells(axes, frame, (*IMITATORS, *low) if first else everyone, column, counts=not low)
        _room_for_counts(axes, 0.0, 1040.0 if column == "steps" else 1.05)
    original = results.original_body(frame)
    handles = style.marks(style.method(method, original) for method in everyone)
    handles.append(style.handle(label="mean of the body's experts", **_MEAN))
    handles.append(style.handle(label="the best of them, the demonstrator", **_BEST))
    figure.legend(handles=handles, loc="outside upper left", ncols=3)
    note = _interval_note(frame, everyone, "speed_m_s")
    if low:
        panels[-1].yaxis.set_major_formatter("{x:,.0f}")
        counts = [len(results.cell(frame, m, b)) for _, m, b in _places(frame, everyone[:-1])]
        note = f"trials of a cell: {min(counts)} to {max(counts)}; {note}"
    footer(figure, frame, note)
    return figure


@style.applied()
def humanoid_scores(frame: pd.DataFrame) -> Figure:
    """Draw Figure 3b: the true return of SILEM, SILEM⁻, TPIL and Peng20 on every humanoid.

    Above as in the paper the walking reward, not normalised, at most 1000. Below what that number
    hides: how much of an episode passes before the body falls, and how fast it moves. Dashed levels
    are PPO on the true reward.
    """
    frame = runs_of("humanoid_scores", frame)
    figure = Figure(figsize=(style.WIDTH_IN, 5.6), layout="constrained")
    rows: list[Any] = [["return_mean", "return_mean"], ["upright", "speed_m_s"]]
    panels = figure.subplot_mosaic(rows, height_ratios=[1.4, 1])
    for column, (title, top) in _HUMANOID_PANELS.items():
        axes, first = panels[column], column == "return_mean"
        axes.set_title(title)
        _body_ticks(axes, frame, scale="PPO" if first else "")
        for index, body in enumerate(results.body_names(frame)):
            values = results.scores(frame, "ppo", body, column)
            if len(values) and values.mean() <= 1.05 * top:
                axes.plot([index - 0.44, index + 0.44], [values.mean()] * 2, zorder=1.8, **_LEVEL)
        _draw_cells(axes, frame, COMPARED, column, counts=first, means=first)
        _room_for_counts(axes, 0.0, 1.04 * top, 0.18 if first else 0.04)
        if not first:
            axes.tick_params(axis="x", labelsize=8)
    panels["return_mean"].axhline(_MAX_RETURN, color=style.PAPER, lw=1.5, zorder=1.5)
    panels["return_mean"].yaxis.set_major_formatter("{x:,.0f}")
    panels["speed_m_s"].axhline(DEMONSTRATOR_SPEED_M_S, **_DOTTED)
    original = results.original_body(frame)
    methods = style.marks(style.method(method, original) for method in COMPARED)
    levels = [
        style.handle(label=style.method("ppo", original).label, **_LEVEL),
        style.handle(style.PAPER, "highest possible return", lw=1.5),
        style.handle(label=f"demonstrator, {DEMONSTRATOR_SPEED_M_S:g} m/s", **_DOTTED),
    ]
    note = _interval_note(frame, COMPARED, "return_mean")
    if frame["stand_in"].any():
        levels.append(style.handle(style.MUTED, OTHER_LENGTH, ls="none", marker="x", mew=1.8))
        note += "; ×: a run of another number of iterations, written below it; outside every mean"
    # a legend fills its columns first
    handles = [h for h in chain.from_iterable(zip_longest(methods, levels)) if h is not None]
    figure.legend(handles=handles, loc="outside upper left", ncols=4)
    footer(figure, frame, note)
    return figure


@style.applied()
def experts(frame: pd.DataFrame) -> Figure:
    """Draw the experts beside the random policy, and in amber the paper's own numbers."""
    frame = runs_of("experts", frame)
    methods = ("ppo", "random")
    titles = {
        "return_mean": "Return of an episode",
        "speed_m_s": "Forward speed (m/s)",
        "upright": results.upright_label(frame).capitalize(),
    }
    figure, panels = style.new_figure(3.1, ncols=3)
    for axes, (column, title) in zip(panels, titles.items(), strict=True):
        axes.set(title=title)
        _body_ticks(axes, frame)
        axes.tick_params(axis="x", labelsize=8)
        _draw_cells(axes, frame, methods, column)
        axes.margins(y=0.12)
        axes.update_datalim([(0.0, 0.0), (0.0, 1.0)])  # no zooming in on a lone run
        axes.autoscale_view(scalex=False)
    _returns_axis(panels[0])
    panels[2].set_ylim(-0.04, 1.08)
    handles = style.marks(style.method(m, results.original_body(frame)) for m in methods)
    if label := _paper_marks(panels[0], results.body_names(frame)):
        handles.append(style.handle(style.PAPER, label, lw=2))
    figure.legend(handles=handles, loc="outside upper left", ncols=3)
    footer(figure, frame, _interval_note(frame, methods[:1], "return_mean"))
    return figure


@style.applied()
def affine_or_mlp(frame: pd.DataFrame) -> Figure:
    """Draw Table 1 trial by trial: the discriminator's reward against the true return on HC0."""
    frame = runs_of("affine_or_mlp", frame)
    mlp, affine = paper.table("tab1").rows
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
    paper_mark |= {"gid": style.GHOST}
    handles.append(style.handle(style.MUTED, "the paper's means", ls="none", ms=9, **paper_mark))
    for method in ("ppo", "random"):
        returns = results.scores(frame, method, "HC0", "return_mean")
        if len(returns):
            axes.axhline(returns.mean(), **_MEAN)
            above: dict[str, Any] = {"xytext": (0, 3), "textcoords": "offset points", "ha": "right"}
            above |= {"fontsize": 8, "color": style.MUTED, "xycoords": ("axes fraction", "data")}
            axes.annotate(style.method(method).label, (1, returns.mean()), **above)
    axes.grid(axis="x")
    axes.set(xlabel="discriminator reward of an episode", ylabel="true return of an episode")
    low, high = paper.number("disc_reward_range")
    axes.set_xlim(low - 20, high + 20)
    axes.margins(y=0.12)
    _returns_axis(axes)
    figure.legend(handles=handles, loc="outside upper left", ncols=3)
    footer(figure, frame)
    return figure


def _draw_cells(
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
    than planned are crosses in either case. `counts` writes under each cell its number of trials,
    and the iterations of its crosses; `means` each mean, a whole number, above it.
    """
    small: dict[str, Any] = {"ha": "center", "fontsize": 7 if len(methods) > 3 else 7.5}
    plate: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "pad": 0.7}
    for x, method, body in _places(frame, methods):
        values = results.scores(frame, method, body, column)
        others = results.stand_ins(frame, method, body).dropna(subset=column)
        color = style.method(method).color
        if len(values):
            _draw_trials(axes, x, values, method)
        elif others.empty:
            style.empty_slot(axes, x, _reason(frame, method, body))
        crosses: dict[str, Any] = {"color": color, "ms": 6.5, "mew": 1.8, "zorder": 5}
        axes.plot(np.full(len(others), x), others[column], "x", **crosses)
        lines = [f"n={len(values)}"] if len(values) else []
        if lengths := sorted(others["n_iterations"].unique()):
            lines.append("× " + ", ".join(f"{n:,}" for n in lengths))
        if counts and lines:
            place: dict[str, Any] = {"transform": axes.get_xaxis_transform(), "color": style.MUTED}
            axes.text(x, 0.025, "\n".join(lines), bbox=plate, **place, **small)
        if means and len(values):
            above: dict[str, Any] = {"xytext": (0, 6), "textcoords": "offset points"}
            above |= small | {"color": style.INK, "bbox": plate | {"alpha": 0.8}}
            axes.annotate(style.number(values.mean()), (x, values.max()), **above)


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
        interval = statistics.interval(values)
        axes.plot([x, x], interval, color=look.color, lw=7, alpha=0.3, solid_capstyle="butt")
    if len(values) > 1:
        ends = values.min(), values.max()
        axes.plot([x, x], ends, color=look.color, lw=1.6)
        for end in ends:
            axes.plot([x - 0.045, x + 0.045], [end, end], color=look.color, lw=1.6)
        beside = axes.transData + ScaledTranslation(0.1, 0, axes.figure.dpi_scale_trans)
        dots: dict[str, Any] = {"ms": 3, "color": look.color, "alpha": 0.6, "mec": "none"}
        axes.plot(np.full(len(values), x), values, "o", transform=beside, **dots)
    mark: dict[str, Any] = {"mfc": look.color, "mec": "white", "mew": 0.8}
    if len(values) == 1 and method != "random":  # which is not trained
        mark = {"mfc": "white", "mec": look.color, "mew": 1.6}
    axes.plot([x], [values.mean()], look.marker, color=look.color, ms=7.5, zorder=5, **mark)


def _reason(frame: pd.DataFrame, method: str, body: str) -> str:
    """Say why a cell has nothing to draw."""
    rows = results.cell(frame, method, body)
    if rows.empty:
        return "no run" if results.is_planned(frame, method, body) else "not planned"
    return "no expert" if rows["expert_return"].isna().all() else "expert's return ≤ 0"


def _interval_note(frame: pd.DataFrame, methods: Sequence[str], column: str) -> str:
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


def _body_ticks(axes: Axes, frame: pd.DataFrame, *, scale: str = "") -> None:
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


def _room_for_counts(axes: Axes, lowest: float, highest: float, share: float = 0.12) -> None:
    """Show at least `lowest` to `highest`, and leave room below for the numbers of trials."""
    low, high = axes.get_ylim()
    low, high = min(low, lowest), max(high, highest)
    axes.set_ylim(low - share * (high - low), high + 0.02 * (high - low))
    # A fixed number of ticks: else the layout changes them, and with them the labels' width.
    axes.yaxis.set_major_locator(MaxNLocator(7))


def _paper_marks(axes: Axes, names: list[str]) -> str:
    """Mark the returns that the paper gives for a study's bodies; return what to call them."""
    look: dict[str, Any] = {"color": style.PAPER, "lw": 2, "zorder": 1.5}
    if "HC0" in names:
        ends = [names.index("HC0") - 0.42, names.index("HC0") + 0.42]
        for name in ("expert_return", "random_return"):
            axes.plot(ends, [paper.number(name)] * 2, **look)
        return "the paper's HC0"
    if bodies.get(names[0]).family == "humanoid":
        axes.axhline(_MAX_RETURN, **look)
        return "highest possible return"
    return ""


def _returns_axis(axes: Axes) -> None:
    axes.yaxis.set_major_formatter("{x:,.0f}")
    axes.yaxis.set_major_locator(MaxNLocator(6))
