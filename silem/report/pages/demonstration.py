"""The page of the demonstration: the man's poses, his features over time, all his clips.

Its stick figures, landmarks with left and right in the colours of their side, are also those of the
other pages on humanoids.
"""

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from silem.motion import demonstrations
from silem.motion.demonstrator import CLIPS, Motion, published_name
from silem.motion.features import FEATURES, POINTS
from silem.motion.kinematics import SIDES
from silem.motion.retargeting import standing_feet
from silem.report import style

SIDE_COLORS = {"left": "#E07B39", "right": "#0072B2"}
MARGIN_M = 0.15
"""What is left free around a walk."""

_CHAINS = (
    ("torso", "head"),
    ("left_shoulder", "torso", "right_shoulder"),
    ("left_hip", "torso", "right_hip"),
    *((f"{side}_shoulder", f"{side}_elbow", f"{side}_hand") for side in SIDES),
    *((f"{side}_hip", f"{side}_knee", f"{side}_foot") for side in SIDES),
)
N_POSES = 5
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


def from_the_right(points: np.ndarray) -> np.ndarray:
    """Project points (..., 3) for a look from the right: x to the right and z up, (..., 2)."""
    return points[..., [0, 2]]


def equal_times(n_states: int, n_poses: int) -> np.ndarray:
    """Return which of some states lie at equal times, the first and the last among them."""
    return np.linspace(0, n_states - 1, n_poses).round().astype(int)


def draw(axes: Axes, points: np.ndarray, alpha: float = 1.0) -> None:
    """Draw one pose, points (P, 2), its left side behind its right one."""
    for color in (SIDE_COLORS["left"], style.INK, SIDE_COLORS["right"]):
        segments = [
            points[[POINTS.index(name) for name in bone]]
            for bone in itertools.chain.from_iterable(map(itertools.pairwise, _CHAINS))
            if (style.INK if "torso" in bone else side_color(bone[0])) == color
        ]
        look: dict[str, Any] = {"linewidths": 2.4, "capstyle": "round", "zorder": 3, "alpha": alpha}
        axes.add_collection(LineCollection(segments, colors=color, **look))
    head = points[POINTS.index("head")]
    axes.plot(*head, "o", ms=7, color=style.INK, mec="none", zorder=4, alpha=alpha)


def floor(axes: Axes, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Draw the floor, undistorted and as wide as a walk (..., 2); return its corners, (2,) each."""
    flat = points.reshape(-1, 2)
    low, high = flat.min(axis=0) - MARGIN_M, flat.max(axis=0) + MARGIN_M
    axes.set(xlim=(low[0], high[0]), ylim=(-0.1, high[1]), aspect="equal")
    axes.axhline(0.0, color=style.MUTED, lw=1, zorder=0)
    return low, high


def side_color(name: str) -> str:
    """Return the colour of what a name's first word, "left" or "l", puts on a side; else ink."""
    sides = [side for side in SIDES if name.partition("_")[0] in (side, side[0])]
    return SIDE_COLORS[sides[0]] if sides else style.INK


def handles(what: str) -> list[Line2D]:
    """Return the legend's entries for both sides, "left foot" and "right foot" for instance."""
    return [style.handle(c, f"{side} {what}", lw=2.4) for side, c in SIDE_COLORS.items()]


@style.applied()
def poses(walks: Mapping[str, np.ndarray], rate_hz: float) -> Figure:
    """Draw poses at equal times, seen from the right, with the paths of hands and feet.

    `walks` are landmarks (T, P, 3) by whose they are, one below the other in one scale.
    """
    seen = {name: from_the_right(points) for name, points in walks.items()}
    everything = np.concatenate(list(seen.values()))
    (width_m, _), top_m = np.ptp(everything, axis=(0, 1)) + 2 * MARGIN_M, everything[..., 1].max()
    height_in = len(walks) * (style.WIDTH_IN * (top_m + 2 * MARGIN_M) / width_m + 0.5) + 0.4
    figure, grid = style.new_figure(height_in, nrows=len(walks), sharex=True, squeeze=False)
    for axes, (name, points) in zip(grid.flat, seen.items(), strict=True):
        floor(axes, everything)
        axes.set(ylim=(-0.1, top_m + 0.25), ylabel="z, up (m)", title=name)
        for limb in ("left_hand", "right_hand", "left_foot", "right_foot"):
            path = points[:, POINTS.index(limb)].T
            axes.plot(*path, color=side_color(limb), lw=0.8, alpha=0.6)
        for state in equal_times(len(points), N_POSES):
            draw(axes, points[state])
            x, y = points[state, POINTS.index("head")]
            label = f"{state / rate_hz:.2f} s"
            axes.text(x, y + 0.1, label, ha="center", va="bottom", color=style.MUTED)
    grid[-1, 0].set_xlabel("x, forward (m)")
    return style.finish(figure, handles("side"), ncols=2)


@style.applied()
def features(motion: Motion) -> Figure:
    """Draw every feature over time, left and right in one panel, shaded while a foot stands."""
    columns = {feature.name: column for column, feature in enumerate(FEATURES)}
    time_s = np.arange(len(motion.features)) / motion.rate_hz
    titles = [
        f"{title} ({unit})" if (unit := FEATURES[columns[names[0]]].unit) else title
        for title, names in _PANELS
    ]
    figure, grid = style.panels(titles, 1.55, 3, sharex=True)
    for axes, (_, names) in zip(grid, _PANELS, strict=True):
        for side, stands in zip(SIDES, standing_feet(motion).T, strict=True):
            edges = np.flatnonzero(np.diff(stands, prepend=False, append=False))
            for start, end in edges.reshape(-1, 2) / motion.rate_hz:
                last = end - 1 / motion.rate_hz
                axes.axvspan(start, last, color=SIDE_COLORS[side], alpha=0.12, lw=0)
        for name in names:
            values = motion.features[:, columns[name]]
            axes.plot(time_s, values, color=side_color(name), lw=1.4)
        axes.set_xlim(0, time_s[-1])
        axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        axes.ticklabel_format(axis="y", useOffset=False)
    for axes in grid[-3:]:
        axes.set_xlabel("time (s)")
    figure.align_xlabels(grid[-3:])
    colors = {**SIDE_COLORS, "whole body": style.INK}
    lines = [style.handle(color, label, lw=1.8) for label, color in colors.items()]
    look: dict[str, Any] = {"alpha": 0.25, "lw": 0}
    spans = [Patch(color=c, label=f"{s} foot stands", **look) for s, c in SIDE_COLORS.items()]
    return style.finish(figure, [*lines, *spans], ncols=5)


def clips() -> pd.DataFrame:
    """Return what the manifest says of the published clips, one row each."""
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
