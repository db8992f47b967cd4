"""Figure 3a: the man who demonstrates, as a stick figure, and the bodies that learn from him."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from silem.motion.features import POINTS
from silem.report import style
from silem.report.figures.motion import SIDE_COLORS, draw_pose
from silem.util.errors import SilemError

_AZIMUTH_DEG = 25.0  # seen from the right and a little from the front, level with the floor
_METRE = float(np.cos(np.deg2rad(_AZIMUTH_DEG)))  # a metre of the way, as long as it is seen
_MARGIN_M = 0.15


def humanoids(
    points: np.ndarray, pictures: Mapping[str, np.ndarray], rate_hz: float, n_poses: int = 7
) -> Figure:
    """Draw Figure 3a: the demonstrator's walk, and below it the bodies that learn from it.

    Strokes on the floor are a metre apart along x, the way that he walks.

    Args:
        points: The demonstrator's landmarks in the world in m, (T, P, 3), in the order of
            `silem.motion.features.POINTS`.
        pictures: Of each learner, (H, W, 3), by its name.
        rate_hz: States per second of `points`.
        n_poses: How many poses of the walk to show.

    Raises:
        SilemError: The points have another shape, there are fewer than `n_poses` states, or there
            is no picture.
    """
    if points.ndim != 3 or points.shape[1:] != (len(POINTS), 3):
        raise SilemError(f"points of shape {points.shape}; allowed: (T, {len(POINTS)}, 3)")
    if not 2 <= n_poses <= len(points) or not pictures:
        raise SilemError(f"{n_poses} poses of {len(points)} states, {len(pictures)} pictures")
    names = list(pictures)
    rows: list[Any] = [["walk"] * len(names), names]
    with style.applied():
        figure = Figure(figsize=(style.WIDTH_IN, 5.9), layout="constrained")
        panels = figure.subplot_mosaic(rows, height_ratios=[1, 1.2])
        walk = panels["walk"]
        _frame(walk, _project(points))
        shown = np.linspace(0, len(points) - 1, n_poses).round().astype(int)
        for rank, state in enumerate(shown, start=1):
            draw_pose(walk, _project(points[state]), alpha=0.35 + 0.65 * rank / n_poses)
        way_m = float(np.linalg.norm(points[-1, 0, :2] - points[0, 0, :2]))
        walk.set_title(f"The demonstrator: {way_m:.1f} m in {(len(points) - 1) / rate_hz:.1f} s")
        for name, picture in pictures.items():
            panels[name].imshow(picture, interpolation="none")
            panels[name].set(xticks=[], yticks=[], title=name)
            panels[name].spines[:].set(visible=True, color=style.FAINT)
    return figure


def _project(points: np.ndarray) -> np.ndarray:
    """Project points (..., 3) onto the picture, in m: to the right and up, (..., 2)."""
    azimuth = np.deg2rad(_AZIMUTH_DEG)
    right = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    return points @ np.stack([right, [0.0, 0.0, 1.0]], axis=1)


def _frame(axes: Axes, points: np.ndarray) -> None:
    """Set the limits so that the whole walk (T, P, 2) is seen, undistorted, on its floor."""
    low, high = points.min(axis=(0, 1)) - _MARGIN_M, points.max(axis=(0, 1)) + _MARGIN_M
    axes.set(xlim=(low[0], high[0]), ylim=(min(low[1], -_MARGIN_M), high[1]), aspect="equal")
    axes.axhline(0.0, color=style.FAINT, lw=1.5, zorder=0)
    strokes = np.arange(np.ceil(low[0] / _METRE), np.floor(high[0] / _METRE) + 1) * _METRE
    axes.plot(strokes, np.zeros(len(strokes)), "|", ms=9, color=style.MUTED, zorder=0)
    axes.set_axis_off()
    lines = [
        Line2D([], [], color=c, lw=2.6, label=f"{side} side") for side, c in SIDE_COLORS.items()
    ]
    axes.legend(handles=lines, loc="upper right", bbox_to_anchor=(1, 1.12), ncols=2, fontsize=8)
