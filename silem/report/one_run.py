"""Figures of one thing at a time: an expert's trajectory, one run's curve, one run's transform.

They belong to the notebooks that make a run; the figures of a whole study are in
`silem.report.figures`.
"""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, MaxNLocator

from silem import bodies
from silem.bodies import BulletBody
from silem.motion.demonstrations import Demonstrations
from silem.report import style
from silem.report.features import Group, feature_groups, feature_names
from silem.report.figures.affine import sheet
from silem.study.record import CURVE, TRANSFORM, RunRecord
from silem.util import files
from silem.util.errors import SilemError, choose

# Curve columns by panel: title, and each line's label.
_PANELS: tuple[tuple[str, dict[str, str]], ...] = (
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


def trajectory(demonstrations: Demonstrations, index: int = 0, duration_s: float = 2.0) -> Figure:
    """Draw the start of one demonstrated trajectory of a runner, every feature over time.

    Raises:
        SilemError: It is no PyBullet body's, there is no such trajectory, or its features are not
            the body's.
    """
    runners = [name for name in bodies.names() if bodies.get(name).engine == "bullet"]
    body = bodies.get(choose("runner", demonstrations.body, runners))
    names = feature_names(body.name)
    if not 0 <= index < len(demonstrations.features):
        raise SilemError(f"trajectory {index} of {len(demonstrations.features)}")
    n_states = max(2, round(duration_s / BulletBody.control_step_s))
    values = demonstrations.features[index][:n_states]
    if values.shape[1] != len(names):
        raise SilemError(f"{values.shape[1]} features, {demonstrations.body} has {len(names)}")
    *lines, contacts = feature_groups(body.name)
    with style.applied():
        heights = [3.2, 3, 3, 0.34 * len(contacts.columns)]
        figure, all_axes = style.new_figure(
            7.2, nrows=4, sharex=True, gridspec_kw={"height_ratios": heights}
        )
        time_s = np.arange(len(values)) * BulletBody.control_step_s
        for axes, group in zip(all_axes[:3], lines, strict=True):
            axes.set_prop_cycle(color=mpl.colormaps["tab10"].colors)  # type: ignore[attr-defined]
            axes.plot(time_s, values[:, group.columns], lw=1.2, label=group.labels)
            axes.set_ylabel(f"{group.name}\n({group.unit})")
            axes.legend(loc="center left", bbox_to_anchor=(1, 0.5), fontsize=8, handlelength=1.2)
        _draw_contacts(all_axes[3], values, contacts)
        all_axes[3].set_xlabel("time (s)")
        figure.align_ylabels(all_axes)
    return figure


def curve(record: RunRecord) -> Figure:
    """Draw the learning curve of one run, a panel for each of the first quantities it knows.

    There are four at most, and six for a humanoid, whose episodes end with a fall.

    Raises:
        SilemError: The run has no curve, or its file is damaged.
    """
    table = pd.DataFrame(files.read_csv(record.file(CURVE)))
    # an older curve lacks the newest columns
    known = {name for name in table if table[name].notna().any()}
    if bodies.get(record.config["body"]).engine == "bullet":  # nobody falls
        known.discard("episode_length")
    panels = [panel for panel in _PANELS if panel[0] in _ALWAYS or known & panel[1].keys()]
    panels = panels[: 6 if "episode_length" in known else 4]
    with style.applied():
        n_columns = 3 if len(panels) == 3 else 2
        n_rows = -(-len(panels) // n_columns)
        figure, grid = style.new_figure(
            2.0 * n_rows + 0.4, nrows=n_rows, ncols=n_columns, sharex=True, squeeze=False
        )
        for axes in grid.flat[len(panels) :]:
            axes.set_axis_off()
        for axes, (title, lines) in zip(grid.flat, panels, strict=False):
            axes.set_title(title)
            _draw_curve(axes, table, lines)
        for axes in grid.flat[len(panels) - n_columns : len(panels)]:
            axes.set_xlabel("timesteps")
            axes.tick_params(labelbottom=True)
        style.footer(figure, record.run_id)
    return figure


def transform(record: RunRecord) -> Figure:
    """Draw the affine transform that one run learned, feature by feature.

    Raises:
        SilemError: The run learned no affine transform, or its file is damaged.
    """
    arrays, body = files.read_npz(record.file(TRANSFORM)), record.config["body"]
    rows = np.arange(len(feature_names(body)))
    color = style.method("silem").color
    with style.applied():
        figure, panels = sheet(body, 0.21 * len(rows) + 1.0)
        for (entry, axes), neutral in zip(panels.items(), (1.0, 0.0), strict=True):
            axes.hlines(rows, neutral, arrays[entry], color=color, lw=1.6)
            axes.plot(arrays[entry], rows, "o", ms=4.5, color=color)
            axes.ticklabel_format(axis="x", useOffset=False)
            axes.xaxis.set_major_locator(MaxNLocator(5))
        style.footer(figure, record.run_id)
    return figure


def _draw_curve(axes: Axes, table: pd.DataFrame, lines: dict[str, str]) -> None:
    colors = style.INK, style.method("silem").color
    for color, (column, label) in zip(colors, lines.items(), strict=False):
        known = table.reindex(columns=["timesteps", column]).dropna()
        if known.empty:
            axes.text(
                0.5, 0.5, "no episode ended during training", transform=axes.transAxes,
                ha="center", va="center", color=style.MUTED,
            )  # fmt: skip
            axes.set_yticks([])
            continue
        marker = "o" if len(known) < 12 else ""
        axes.plot(
            known["timesteps"], known[column], marker=marker, ms=3.5, color=color, label=label
        )
        axes.ticklabel_format(axis="y", useOffset=False)
        axes.yaxis.set_major_locator(MaxNLocator(5))
    if any(lines.values()):
        axes.set_ylim(0, 1.05)
        axes.legend(loc="lower right")
    axes.set_xlim(0, table["timesteps"].iloc[-1] * 1.03)
    axes.xaxis.set_major_formatter(EngFormatter())
    axes.xaxis.set_major_locator(MaxNLocator(5))


def _draw_contacts(axes: Axes, values: np.ndarray, group: Group) -> None:
    """Draw a bar for every stretch of time in which a part touches the floor."""
    for row, column in enumerate(group.columns):
        touching = np.concatenate([[False], values[:, column] > 0.5, [False]])
        starts, ends = np.flatnonzero(np.diff(touching)).reshape(-1, 2).T
        bars = BulletBody.control_step_s * np.stack([starts, ends - starts], axis=1)
        axes.broken_barh(bars.tolist(), (row - 0.35, 0.7), color=style.INK, lw=0)
    axes.set_yticks(range(len(group.labels)), group.labels)
    axes.set_ylim(len(group.labels) - 0.4, -0.6)
    axes.grid(visible=False, axis="y")
    axes.set_ylabel(group.name)
