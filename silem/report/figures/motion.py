"""The demonstration in figures: the man's poses, his skeletal features over time, all his clips."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import mujoco
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from silem.motion import demonstrations, demonstrator
from silem.motion.demonstrator import CLIPS, Motion, published_name
from silem.motion.features import FEATURES, POINTS, Landmarks
from silem.motion.kinematics import SIDES
from silem.motion.retargeting import standing_feet
from silem.report import style
from silem.util.errors import SilemError

SIDE_COLORS = {"left": "#E07B39", "right": "#0072B2"}

_CHAINS = (
    ("torso", "head"),
    ("left_shoulder", "torso", "right_shoulder"),
    ("left_hip", "torso", "right_hip"),
    *((f"{side}_shoulder", f"{side}_elbow", f"{side}_hand") for side in SIDES),
    *((f"{side}_hip", f"{side}_knee", f"{side}_foot") for side in SIDES),
)
_AXES = {"x": "forward", "y": "left", "z": "up"}
_MARGIN_M = 0.15

_ROWS: tuple[tuple[tuple[str, tuple[str, ...]], ...], ...] = (
    *(
        tuple(
            (f"{limb} {axis}, {way}", tuple(f"{side}_{limb}_{axis}" for side in SIDES))
            for axis, way in _AXES.items()
        )
        for limb in ("hand", "foot")
    ),
    (
        ("elbow angle", ("left_elbow", "right_elbow")),
        ("knee angle", ("left_knee", "right_knee")),
        ("head height", ("head_height",)),
    ),
    *(
        tuple((f"{what} {axis}", (f"{name}_{axis}",)) for axis in _AXES)
        for what, name in (("torso's vertical", "torso_vertical"), ("velocity", "com_velocity"))
    ),
)
"""The panels of `features`, row by row: a title and the features drawn in it."""


def features(motion: Motion) -> Figure:
    """Draw every skeletal feature over time with its unit, left and right in one panel.

    While a foot stands (`silem.motion.targets.standing_feet`), the panels are shaded in its
    side's colour.

    Args:
        motion: A demonstrator's motion.
    """
    columns = {feature.name: column for column, feature in enumerate(FEATURES)}
    time_s = np.arange(len(motion.features)) / motion.rate_hz
    stances = list(_stances(motion))
    with style.applied():
        figure, grid = style.new_figure(8.2, nrows=len(_ROWS), ncols=3, sharex=True)
        for axes, (title, names) in zip(grid.flat, itertools.chain(*_ROWS), strict=True):
            unit = FEATURES[columns[names[0]]].unit
            axes.set_title(f"{title} ({unit})" if unit else title, fontweight="normal", pad=4)
            for side, start_s, end_s in stances:
                axes.axvspan(start_s, end_s, color=SIDE_COLORS[side], alpha=0.12, lw=0)
            for name in names:
                color = SIDE_COLORS.get(name.partition("_")[0], style.INK)
                axes.plot(time_s, motion.features[:, columns[name]], color=color, lw=1.4)
            axes.set_xlim(0, time_s[-1])
            axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
            axes.ticklabel_format(axis="y", useOffset=False)
        for axes in grid[-1]:
            axes.set_xlabel("time (s)")
        figure.align_xlabels(grid[-1])
        lines = [Line2D([], [], color=c, lw=1.8, label=side) for side, c in SIDE_COLORS.items()]
        lines.append(Line2D([], [], color=style.INK, lw=1.8, label="whole body"))
        spans = [
            Patch(color=color, alpha=0.25, lw=0, label=f"{side} foot stands")
            for side, color in SIDE_COLORS.items()
        ]
        figure.legend(handles=[*lines, *spans], loc="outside upper left", ncols=5)
    return figure


def poses(motion: Motion, n_poses: int = 6) -> Figure:
    """Draw poses at equal times, seen from the right, with the paths of hands and feet.

    Args:
        motion: A demonstrator's motion.
        n_poses: How many poses, the first and the last state among them.

    Raises:
        SilemError: There are fewer states than that, or less than 2 poses are asked for.
    """
    if not 2 <= n_poses <= len(motion.points):
        raise SilemError(f"{n_poses} poses of {len(motion.points)} states; allowed: 2 to all")
    seen = motion.points[..., [0, 2]]
    low, high = seen.min(axis=(0, 1)), seen.max(axis=(0, 1))
    with style.applied():
        width_m, height_m = high[0] - low[0] + 2 * _MARGIN_M, high[1] + 2 * _MARGIN_M
        figure, axes = style.new_figure(style.WIDTH_IN * height_m / width_m + 0.7)
        axes.set(xlim=(low[0] - _MARGIN_M, high[0] + _MARGIN_M), ylim=(-0.1, high[1] + 0.25))
        axes.set(aspect="equal", xlabel="x, forward (m)", ylabel="z, up (m)")
        axes.axhline(0.0, color=style.MUTED, lw=1)
        for name in ("left_hand", "right_hand", "left_foot", "right_foot"):
            color = SIDE_COLORS[name.partition("_")[0]]
            axes.plot(*seen[:, POINTS.index(name)].T, color=color, lw=0.8, alpha=0.6)
        for state in np.linspace(0, len(seen) - 1, n_poses).round().astype(int):
            draw_pose(axes, seen[state])
            x, y = seen[state, POINTS.index("head")]
            label = f"{state / motion.rate_hz:.2f} s"
            axes.text(x, y + 0.1, label, ha="center", va="bottom", color=style.MUTED)
        handles = [
            Line2D([], [], color=color, lw=2.4, label=f"{side} side")
            for side, color in SIDE_COLORS.items()
        ]
        figure.legend(handles=handles, loc="outside upper left", ncols=2)
    return figure


def clips() -> pd.DataFrame:
    """Return what the manifest says of the published clips, one row each.

    Raises:
        SilemError: One of them was not published.
    """
    rows = []
    for clip in CLIPS:
        about = demonstrations.entry(published_name(clip))
        rows.append(
            {
                "clip": clip,
                "states": about["n_states"],
                "duration (s)": about["duration_s"],
                "distance (m)": about["speed_m_s"] * about["duration_s"],
                "mean speed (m/s)": about["speed_m_s"],
                "repairs": "; ".join(about["repairs"]) or "none",
            }
        )
    return pd.DataFrame(rows)


def torso_distances_m() -> dict[str, float]:
    """Return how far foot and hand are from the torso in the default pose of the man's model."""
    model = demonstrator.model()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    points = Landmarks(model, demonstrator.SKELETON).points(data)
    return {
        limb: float(np.linalg.norm(points[POINTS.index(f"left_{limb}")] - points[0]))
        for limb in ("foot", "hand")
    }


def _stances(motion: Motion) -> Iterator[tuple[str, float, float]]:
    """Return each stretch of time in which a foot stands: side, start and end in s."""
    for side, stands in zip(SIDES, standing_feet(motion).T, strict=True):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], stands, [False]])))
        for start, end in edges.reshape(-1, 2):
            yield side, start / motion.rate_hz, (end - 1) / motion.rate_hz


def draw_pose(axes: Axes, points: np.ndarray, alpha: float = 1.0) -> None:
    """Draw one pose, points (P, 2), its left side behind its right one."""
    bones = [pair for chain in _CHAINS for pair in itertools.pairwise(chain)]
    for color in (SIDE_COLORS["left"], style.INK, SIDE_COLORS["right"]):
        chosen = [bone for bone in bones if _bone_color(bone) == color]
        segments = [points[[POINTS.index(name) for name in bone]] for bone in chosen]
        axes.add_collection(
            LineCollection(
                segments, colors=color, linewidths=2.4, capstyle="round", zorder=3, alpha=alpha
            )
        )
    head = points[POINTS.index("head")]
    axes.plot(*head, "o", ms=7, color=style.INK, mec="none", zorder=4, alpha=alpha)


def _bone_color(bone: tuple[str, str]) -> str:
    """Return a bone's colour: its side's, or ink where it holds on to the torso."""
    side = bone[0].partition("_")[0]
    return style.INK if "torso" in bone else SIDE_COLORS[side]
