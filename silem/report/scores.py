"""Figures of the trials' scores: Figures 2b and 3b, the experts, Table 1 drawn, any trend.

A panel has its bodies along the x axis, 1 apart, and for each a slot per method, left to right: a
cell of a study, with its trials, their minimum, mean and maximum, and their interval.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import ScaledTranslation

from silem import bodies, paper
from silem.bodies.body import MAX_STEPS
from silem.bodies.humanoid import DEMONSTRATOR_SPEED_M_S
from silem.report import results, statistics, style
from silem.report.style import QUANTITIES, MethodStyle
from silem.study.settings import BUDGETS, METHODS
from silem.util.errors import SilemError, choose

INTERVAL_TRIALS = 5
"""Trials below which no figure draws an interval."""

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
    "humanoid_scores": (("ppo", *COMPARED), ("Humanoid", "HumanoidR", "Atlas")),
}
_MEAN: dict[str, Any] = {"color": style.MUTED, "lw": 1, "ls": style.DASHED}
_DOTTED: dict[str, Any] = {"color": style.INK, "lw": 1.5, "ls": (0, (1, 1.5))}
_LEVELS: dict[str, tuple[str, dict[str, Any]]] = {
    "max": ("the best expert", {"color": style.INK, "lw": 1, "ls": (0, (1, 2))}),
    "mean": ("PPO, true reward", {"color": style.MUTED, "lw": 1.2, "ls": style.DASHED}),
}
_MAX_RETURN = paper.number("humanoid_max_return")


class Panel(NamedTuple):
    """A column of the table as a panel, from 0 to `top` at least.

    `level` is what a line shows of each body's experts, "max" or "mean"; `scale` names their mean
    return, which then stands under the body; `counts` writes under each cell its number of trials,
    and `means` each mean, a whole number, above it.
    """

    column: str
    title: str
    methods: Sequence[str]
    top: float = 1.0
    level: str = ""
    scale: str = ""
    counts: bool = True
    means: bool = False


def runs_of(figure: str, frame: pd.DataFrame) -> pd.DataFrame:
    """Return the runs that a figure, named by its function, shows: those and no others."""
    methods, names = _SHOWN[choose("figure", figure, _SHOWN)]
    study, _ = results.context(frame)
    if names and not set(names) <= (known := set(results.body_names(frame))):
        raise SilemError(
            f"{figure} shows {', '.join(names)}; the runs of study {study!r} are of"
            f" {', '.join(sorted(known))}"
        )
    shown = results.select(frame, methods, names)
    shown.attrs["figure"] = figure
    return shown


def finish(
    figure: Figure,
    frame: pd.DataFrame,
    handles: Sequence[Line2D] = (),
    note: str = "",
    ncols: int = 3,
    *,
    runs: bool = True,
) -> Figure:
    """Put a legend above a figure; under it budget and runs shown, a warning of toy budgets."""
    budget = results.context(frame)[1]
    shown, evidence = f"budget {budget}", BUDGETS[budget].is_evidence
    text = "; ".join(part for part in (results.describe(frame) if runs else shown, note) if part)
    text = text if evidence else f"not evidence: {text}"
    return style.finish(figure, handles, text, ncols, warn=not evidence)


def methods_of(frame: pd.DataFrame, methods: Iterable[str]) -> list[Line2D]:
    """Return the legend's entries of methods, each with its marker."""
    return style.marks(style.method(name, results.original_body(frame)) for name in methods)


def by_body(
    frame: pd.DataFrame, panels: Sequence[Panel], height_in: float = 3.9, **layout: Any
) -> tuple[Figure, list[Axes], list[Line2D]]:
    """Draw columns of a table, every cell with its trials: a panel each, rows if many bodies.

    `layout` is a mosaic of the columns (`Figure.subplot_mosaic`) in place of that. Handles of the
    levels that were drawn, the paper's numbers among them, are returned last.
    """
    names, columns = results.body_names(frame), [panel.column for panel in panels]
    wide, handles = len(names) > 4, {}
    layout.setdefault("mosaic", [[name] for name in columns] if wide else [columns])
    height_in *= len(columns) if wide else 1
    figure = Figure((style.WIDTH_IN, height_in), layout="constrained")
    grid = figure.subplot_mosaic(**layout)
    for axes, panel in ((grid[panel.column], panel) for panel in panels):
        axes.set_title(panel.title)
        _body_ticks(axes, frame, panel.scale)
        draw_cells(axes, frame, panel)
        label, look = _LEVELS.get(panel.level, ("", {}))
        for index, body in enumerate(names if panel.level else ()):
            if len(values := results.scores(frame, "ppo", body, panel.column)):
                at = [getattr(values, panel.level)()] * 2
                axes.plot([index - 0.44, index + 0.44], at, zorder=1.8, **look)
                handles[label] = style.handle(label=label, **look)
        if panel.column in ("return_mean", "steps"):
            axes.yaxis.set_major_formatter("{x:,.0f}")
        if panel.column == "return_mean":
            if label := _paper_marks(axes, names):
                handles[label] = style.handle(style.PAPER, label, lw=2)
        low, high = axes.get_ylim()
        low, high = min(low, 0.0), max(high, 1.05 * panel.top)
        room = (0.18 if panel.means else 0.12) if panel.counts else 0.04  # for what is written
        axes.set_ylim(low - room * (high - low), high + 0.02 * (high - low))
        # A fixed number of ticks: else the layout changes them, and with them the labels' width.
        axes.yaxis.set_major_locator(MaxNLocator(7, steps=[1, 2, 5, 10]))
    return figure, [grid[name] for name in columns], list(handles.values())


@style.applied()
def normalised_scores(frame: pd.DataFrame) -> Figure:
    """Draw Figure 2b or, with the steps before a fall, 2d, and whether a score is a gait.

    First, as in the paper, the normalised scores, then the forward speed of the same trials and of
    the experts: where the expert only stands, a score of 1 is standing.
    """
    falls = results.can_fall(frame)
    frame, low = runs_of("figure_2d" if falls else "normalised_scores", frame), ("random",) * falls
    score, everyone = "Score: minimum, mean, maximum over trials", (*IMITATORS, "ppo", *low)
    shown = [
        Panel("normalised", score, (*IMITATORS, *low), level="max", scale="experts"),
        Panel("speed_m_s", "Forward speed (m/s)", everyone),
        Panel("steps", f"Steps of an episode, at most {MAX_STEPS:,}", everyone, MAX_STEPS),
    ]
    shown = [panel._replace(counts=not falls) for panel in shown[: 3 if falls else 2]]
    figure, grid, levels = by_body(frame, shown, 2.4 if falls else 3.9)
    grid[0].axhline(paper.number("expert_level"), **_MEAN)
    mean = style.handle(label="mean of the body's experts", **_MEAN)
    note = interval_note(frame, everyone, "speed_m_s")
    if falls:
        counts = [len(results.cell(frame, m, b)) for _, m, b in _places(frame, everyone[:-1])]
        note = f"trials of a cell: {style.span(counts)}; {note}"
    return finish(figure, frame, [*methods_of(frame, everyone), mean, *levels], note)


@style.applied()
def humanoid_scores(frame: pd.DataFrame) -> Figure:
    """Draw Figure 3b: the true return of SILEM, SILEM⁻, TPIL and Peng20 on every humanoid.

    Above as in the paper the walking reward, not normalised, at most 1000. Below what that number
    hides: how much of an episode passes before the body falls, and how fast it moves.
    """
    frame, speed = runs_of("humanoid_scores", frame), DEMONSTRATOR_SPEED_M_S
    title = "True return of an episode: minimum, mean, maximum over trials"
    shown = [
        Panel("return_mean", title, COMPARED, _MAX_RETURN, "mean", scale="PPO", means=True),
        Panel("upright", "Share of steps upright", COMPARED, level="mean", counts=False),
        Panel("speed_m_s", "Speed (m/s)", COMPARED, speed, "mean", counts=False),
    ]
    mosaic = [["return_mean"] * 2, ["upright", "speed_m_s"]]
    figure, grid, levels = by_body(frame, shown, 5.6, mosaic=mosaic, height_ratios=[1.4, 1])
    grid[2].axhline(speed, **_DOTTED)
    levels.append(style.handle(label=f"demonstrator, {speed:g} m/s", **_DOTTED))
    note = interval_note(frame, COMPARED, "return_mean")
    return finish(figure, frame, methods_of(frame, COMPARED) + levels, note, ncols=4)


@style.applied()
def experts(frame: pd.DataFrame) -> Figure:
    """Draw the experts beside the random policy, and in amber the paper's own numbers."""
    frame, methods = runs_of("experts", frame), ("ppo", "random")
    shown = [
        Panel(name, QUANTITIES[name].heading.capitalize(), methods, counts=False)
        for name in ("return_mean", "speed_m_s", "upright")
    ]
    figure, _, levels = by_body(frame, shown, 3.1)
    note = interval_note(frame, methods[:1], "return_mean")
    return finish(figure, frame, methods_of(frame, methods) + levels, note)


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
    axes.yaxis.set_major_formatter("{x:,.0f}")
    return finish(figure, frame, handles)


@style.applied()
def against(
    frame: pd.DataFrame,
    x: str | Mapping[str, float],
    label: str,
    columns: Mapping[str, str],
    methods: Sequence[str],
) -> Figure:
    """Draw columns of a table, by title, against a number of each run: a line for each method.

    `x` is the column of that number, or maps bodies to it: a torso's length in m, for instance.
    """
    looks = {name: style.method(name, results.original_body(frame)) for name in methods}
    figure = draw_against(frame, x, label, columns, "method", looks)
    return finish(figure, frame, style.marks(looks.values()), "lines: means over trials")


@style.applied()
def draw_against(
    rows: pd.DataFrame,
    x: str | Mapping[str, float],
    label: str,
    columns: Mapping[str, str],
    by: str,
    looks: Mapping[str, MethodStyle],
) -> Figure:
    """Draw as `against` does, without its legend, a line for each value of the column `by`."""
    places = rows["body"].map(x) if isinstance(x, Mapping) else rows[x]
    figure, grid = style.panels(columns.values(), 2.8, sharex=True)
    for axes, column in zip(grid, columns, strict=True):
        axes.set_xlabel(label)
        for name, look in looks.items():
            known = rows[rows[by].eq(name)].dropna(subset=column)
            groups = known.groupby(places[known.index])[column]
            for place, values in groups:
                draw_trials(axes, place, values.to_numpy(), look)
            if len(known):
                axes.plot(groups.mean(), color=look.color, lw=1.4)
    if isinstance(x, Mapping):  # their whole range, however few of the bodies have a run yet
        grid[0].plot([*x.values()], [0] * len(x), alpha=0, transform=grid[0].get_xaxis_transform())
    return figure


def draw_cells(axes: Axes, frame: pd.DataFrame, panel: Panel) -> None:
    """Draw every cell of a panel; one without values is an empty slot with the reason."""
    small: dict[str, Any] = {"ha": "center", "fontsize": 7 if len(panel.methods) > 3 else 7.5}
    plate: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "pad": 0.7}
    for x, method, body in _places(frame, panel.methods):
        values = results.scores(frame, method, body, panel.column)
        if not len(values):
            style.empty_slot(axes, x, _reason(frame, method, body))
            continue
        draw_trials(axes, x, values, style.method(method))
        if panel.counts:
            place: dict[str, Any] = {"transform": axes.get_xaxis_transform(), "color": style.MUTED}
            axes.text(x, 0.025, f"n={len(values)}", bbox=plate, **place, **small)
        if panel.means:
            above: dict[str, Any] = {"xytext": (0, 6), "textcoords": "offset points"}
            above |= small | {"color": style.INK, "bbox": plate | {"alpha": 0.8}}
            axes.annotate(style.number(values.mean()), (x, values.max()), **above)


def draw_trials(axes: Axes, x: float, values: np.ndarray, look: MethodStyle) -> None:
    """Draw minimum, mean and maximum over trials, and the trials; hollow for a single one.

    From `INTERVAL_TRIALS` on a pale bar behind them is Student's 95 % t interval of the mean.
    """
    if len(values) >= INTERVAL_TRIALS:
        interval = statistics.interval(values)
        axes.plot([x, x], interval, color=look.color, lw=7, alpha=0.3, solid_capstyle="butt")
    if len(values) > 1:
        ends = values.min(), values.max()
        axes.plot([x, x], ends, marker="_", color=look.color, lw=1.6, ms=5, mew=1.6)
        beside = axes.transData + ScaledTranslation(0.1, 0, axes.figure.dpi_scale_trans)
        dots: dict[str, Any] = {"ms": 3, "color": look.color, "alpha": 0.6, "mec": "none"}
        axes.plot(np.full(len(values), x), values, "o", transform=beside, **dots)
    mark: dict[str, Any] = {"mfc": look.color, "mec": "white", "mew": 0.8}
    if len(values) == 1 and look.marker != style.METHODS["random"].marker:  # which is not trained
        mark = {"mfc": "white", "mec": look.color, "mew": 1.6}
    axes.plot([x], [values.mean()], look.marker, color=look.color, ms=7.5, zorder=5, **mark)


def _places(frame: pd.DataFrame, methods: Sequence[str]) -> Iterator[tuple[float, str, str]]:
    """Yield every cell's place on the x axis, its method and its body."""
    width = 0.81 / len(methods)
    for body_index, body in enumerate(results.body_names(frame)):
        for index, method in enumerate(methods):
            yield body_index + (index - (len(methods) - 1) / 2) * width, method, body


def _reason(frame: pd.DataFrame, method: str, body: str) -> str:
    """Say why a cell has nothing to draw."""
    rows = results.cell(frame, method, body)
    if rows.empty:
        return "no run" if results.is_planned(frame, method, body) else "not planned"
    return "no expert" if rows["expert_return"].isna().all() else "expert's return ≤ 0"


def interval_note(frame: pd.DataFrame, methods: Sequence[str], column: str) -> str:
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
        note.append(
            "they do not hold the variance of the demonstrator, which all imitators share, nor that"
            " of the experts' mean, by which a score divides"
        )
    return "; ".join(note)


def _body_ticks(axes: Axes, frame: pd.DataFrame, scale: str) -> None:
    """Name each body under the axis, and where PPO's return has a name, `scale`, that return."""
    names = results.body_names(frame)
    labels = []
    for body in names:
        returns = results.scores(frame, "ppo", body, "return_mean")
        level = f"{scale} {style.number(returns.mean())}" if len(returns) else f"no {scale}"
        labels.append(f"{body}\n{level}" if scale else body)
    axes.set_xticks(range(len(names)), labels)
    axes.set_xlim(-0.5, len(names) - 0.5)
    axes.tick_params(axis="x", length=0, labelsize=8)


def _paper_marks(axes: Axes, names: Sequence[str]) -> str:
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
