"""Landmarks drawn as a stick figure, left and right in the colours of their side."""

from __future__ import annotations

import itertools

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from silem.motion.features import POINTS
from silem.motion.kinematics import SIDES
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
_BONES = [pair for chain in _CHAINS for pair in itertools.pairwise(chain)]


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
            for bone in _BONES
            if _color(bone) == color
        ]
        axes.add_collection(
            LineCollection(
                segments, colors=color, linewidths=2.4, capstyle="round", zorder=3, alpha=alpha
            )
        )
    head = points[POINTS.index("head")]
    axes.plot(*head, "o", ms=7, color=style.INK, mec="none", zorder=4, alpha=alpha)


def _color(bone: tuple[str, str]) -> str:
    """Return a bone's colour: its side's, or ink where it holds on to the torso."""
    return style.INK if "torso" in bone else side_color(bone[0])


def side_color(name: str) -> str:
    """Return the colour of what a name's first word, "left" or "l", puts on a side; else ink."""
    sides = [side for side in SIDES if name.partition("_")[0] in (side, side[0])]
    return SIDE_COLORS[sides[0]] if sides else style.INK


def handles(what: str) -> list[Line2D]:
    """Return the legend's entries for both sides, "left foot" and "right foot" for instance."""
    return [style.handle(c, f"{side} {what}", lw=2.4) for side, c in SIDE_COLORS.items()]
