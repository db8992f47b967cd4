"""Learning curves of the same methods on one body under two conditions, one figure for both."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from silem.report import results, style

_QUANTITIES = {
    "return_mean": "Return of an episode",
    "episode_length": "Steps before a fall",
    "speed_m_s": "Forward speed (m/s)",
    "disc_reward": "Discriminator reward of an episode",
}
_LINES: tuple[dict[str, Any], ...] = (
    {"ls": "-", "lw": 1.6},
    {"ls": (0, (4, 1.5)), "lw": 1.6},
    {"ls": (0, (1, 1.2)), "lw": 1.6},
)


def compared_curves(groups: Mapping[str, pd.DataFrame]) -> Figure:
    """Draw runs of some tables over iterations: a colour per method, a dash per table.

    Every run is a line of its own, whatever its number of iterations; nothing is smoothed. An
    iteration's value is the mean over the episodes that ended in it.

    Args:
        groups: One to three tables of `results.load_records` by what to call them, all of one body.
    """
    methods = [name for frame in groups.values() for name in frame["method"]]
    drawn = [name for name in style.METHODS if name in methods]
    first = next(iter(groups.values()))
    original = results.original_body(first)
    with style.applied():
        figure, grid = style.new_figure(4.6, nrows=2, ncols=2, sharex=True)
        for axes, (quantity, title) in zip(grid.flat, _QUANTITIES.items(), strict=True):
            axes.set_title(title)
            for line, frame in zip(_LINES, groups.values(), strict=False):
                for run in frame[frame["n_steps"] > 0].itertuples():
                    curve = results.load_curve(run.run_id)[["iteration", quantity]].dropna()
                    color = style.method(run.method).color
                    axes.plot(curve["iteration"], curve[quantity], color=color, **line)
            if not axes.lines:
                axes.set(xticks=[], yticks=[])
                middle: dict[str, Any] = {"transform": axes.transAxes, "ha": "center"}
                axes.text(0.5, 0.5, "no run", color=style.MUTED, **middle)
        for axes in grid[1]:
            axes.set_xlabel("iteration")
        handles = [
            Line2D([], [], color=look.color, lw=2.2, label=look.label)
            for look in (style.method(name, original) for name in drawn)
        ]
        for line, (name, frame) in zip(_LINES, groups.items(), strict=False):
            label = f"{name}: {style.trials(len(frame))}"
            handles.append(Line2D([], [], color=style.MUTED, label=label, **line))
        figure.legend(handles=handles, loc="outside upper left", ncols=2)
        budget = results.context(first)[1]
        text = f"budget {budget}; every run is a line of its own, unsmoothed"
        evidence = results.is_evidence(budget)
        style.footer(figure, text if evidence else f"not evidence: {text}", warn=not evidence)
    return figure
