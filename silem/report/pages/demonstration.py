"""The page of the demonstration: the man's poses, his features over time, all his clips."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from silem.motion import demonstrations
from silem.motion.demonstrator import CLIPS, Motion, published_name
from silem.motion.features import FEATURES, POINTS
from silem.motion.kinematics import SIDES
from silem.motion.retargeting import standing_feet
from silem.report import stick_figure, style
from silem.report.stick_figure import MARGIN_M, SIDE_COLORS

_N_POSES = 6
_AXES = {"x": "forward", "y": "left", "z": "up"}
_PANELS: tuple[tuple[str, tuple[str, ...]], ...] = (
    *(
        (f"{limb} {axis}, {way}", tuple(f"{side}_{limb}_{axis}" for side in SIDES))
        for limb in ("hand", "foot")
        for axis, way in _AXES.items()
    ),
    ("elbow angle", ("left_elbow", "right_elbow")),
    ("knee angle", ("left_knee", "right_knee")),
    ("head height", ("head_height",)),
    *(
        (f"{what} {axis}", (f"{name}_{axis}",))
        for what, name in (("torso's vertical", "torso_vertical"), ("velocity", "com_velocity"))
        for axis in _AXES
    ),
)
"""The panels of `features`, three in a row: a title and the features drawn in it."""


def poses(motion: Motion) -> Figure:
    """Draw poses at equal times, seen from the right, with the paths of hands and feet."""
    seen = stick_figure.from_the_right(motion.points)
    low, high = seen.min(axis=(0, 1)), seen.max(axis=(0, 1))
    with style.applied():
        width_m, height_m = high[0] - low[0] + 2 * MARGIN_M, high[1] + 2 * MARGIN_M
        figure, axes = style.new_figure(style.WIDTH_IN * height_m / width_m + 0.7)
        axes.set(xlim=(low[0] - MARGIN_M, high[0] + MARGIN_M), ylim=(-0.1, high[1] + 0.25))
        axes.set(aspect="equal", xlabel="x, forward (m)", ylabel="z, up (m)")
        axes.axhline(0.0, color=style.MUTED, lw=1)
        for name in ("left_hand", "right_hand", "left_foot", "right_foot"):
            color = stick_figure.side_color(name)
            axes.plot(*seen[:, POINTS.index(name)].T, color=color, lw=0.8, alpha=0.6)
        for state in stick_figure.equal_times(len(seen), _N_POSES):
            stick_figure.draw(axes, seen[state])
            x, y = seen[state, POINTS.index("head")]
            label = f"{state / motion.rate_hz:.2f} s"
            axes.text(x, y + 0.1, label, ha="center", va="bottom", color=style.MUTED)
        figure.legend(handles=stick_figure.handles("side"), loc="outside upper left", ncols=2)
    return figure


def features(motion: Motion) -> Figure:
    """Draw every skeletal feature over time with its unit, left and right in one panel.

    While a foot stands (`silem.motion.targets.standing_feet`), the panels are shaded in its
    side's colour.
    """
    columns = {feature.name: column for column, feature in enumerate(FEATURES)}
    time_s = np.arange(len(motion.features)) / motion.rate_hz
    stances = list(_stances(motion))
    with style.applied():
        figure, grid = style.new_figure(8.2, nrows=len(_PANELS) // 3, ncols=3, sharex=True)
        for axes, (title, names) in zip(grid.flat, _PANELS, strict=True):
            unit = FEATURES[columns[names[0]]].unit
            axes.set_title(f"{title} ({unit})" if unit else title, fontweight="normal", pad=4)
            for side, start_s, end_s in stances:
                axes.axvspan(start_s, end_s, color=SIDE_COLORS[side], alpha=0.12, lw=0)
            for name in names:
                color = stick_figure.side_color(name)
                axes.plot(time_s, motion.features[:, columns[name]], color=color, lw=1.4)
            axes.set_xlim(0, time_s[-1])
            axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
            axes.ticklabel_format(axis="y", useOffset=False)
        for axes in grid[-1]:
            axes.set_xlabel("time (s)")
        figure.align_xlabels(grid[-1])
        colors = {**SIDE_COLORS, "whole body": style.INK}
        lines = [style.handle(color, label, lw=1.8) for label, color in colors.items()]
        spans = [
            Patch(color=color, alpha=0.25, lw=0, label=f"{side} foot stands")
            for side, color in SIDE_COLORS.items()
        ]
        figure.legend(handles=[*lines, *spans], loc="outside upper left", ncols=5)
    return figure


def _stances(motion: Motion) -> Iterator[tuple[str, float, float]]:
    """Return each stretch of time in which a foot stands: side, start and end in s."""
    for side, stands in zip(SIDES, standing_feet(motion).T, strict=True):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], stands, [False]])))
        for start, end in edges.reshape(-1, 2):
            yield side, start / motion.rate_hz, (end - 1) / motion.rate_hz


def clips() -> pd.DataFrame:
    """Return what the manifest says of the published clips, one row each.

    Raises:
        SilemError: One of them was not published.
    """
    about = pd.DataFrame([demonstrations.entry(published_name(clip)) for clip in CLIPS])
    return pd.DataFrame(
        {
            "clip": CLIPS,
            "states": about["n_states"],
            "duration (s)": about["duration_s"],
            "distance (m)": about["speed_m_s"] * about["duration_s"],
            "mean speed (m/s)": about["speed_m_s"],
            "repairs": about["repairs"].str.join("; ").replace("", "none"),
        }
    )
