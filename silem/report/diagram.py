"""Figure 1 of the paper, redrawn: how expert, learner, transform and discriminator connect."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, PathPatch, Polygon
from matplotlib.path import Path

from silem.report import style

Point = tuple[float, float]

_HEIGHT_IN = 3.75
_BLUE, _BLUE_EDGE = "#E3EEF9", "#2F6DA8"
_GREEN, _GREEN_EDGE = "#DDF3E4", "#1E8A4C"
_TRAIL = ("#C3D8EC", "#8FB5D9", _BLUE_EDGE)  # earlier poses paler
_EXPERT_Y, _LEARNER_Y = 3.02, 1.42

# Joint angles of a galloping HalfCheetah in three poses: back and front thigh, shin, foot, radians.
_POSES = (
    ((0.55, -0.5, 0.75), (-0.35, 0.45, -0.2)),
    ((0.15, -0.35, 0.6), (0.1, 0.3, -0.2)),
    ((-0.35, -0.1, 0.5), (0.55, 0.05, -0.3)),
)
_THIGH, _SHIN, _FOOT = 0.29, 0.30, 0.17


def overview() -> Figure:
    """Draw Figure 1: the parts of SILEM and what flows between them.

    Solid arrows carry skeletal features, the green dashed one the gradient that trains the
    transform through the fixed discriminator, the thick dashed one the reward.
    """
    with style.applied():
        figure = Figure(figsize=(style.WIDTH_IN, _HEIGHT_IN))
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set(xlim=(0, style.WIDTH_IN), ylim=(0, _HEIGHT_IN), aspect="equal")
        axes.axis("off")
        _boxes(axes)
        _arrows(axes)
    return figure


def _boxes(axes: Axes) -> None:
    """Draw the six boxes and the two running bodies."""
    top, low = _EXPERT_Y, _LEARNER_Y
    _box(axes, (0.15, 1.85), (top - 0.52, top + 0.52))
    _box(axes, (0.15, 1.85), (low - 0.52, low + 0.52))
    axes.text(1.0, top + 0.32, "Expert trajectories", ha="center", va="center", weight="bold")
    axes.text(1.0, low + 0.32, r"Policy $\mathbf{\pi}$", ha="center", va="center", weight="bold")
    _stack(axes, (1.0, top - 0.14), torso_length=1.0)
    _stack(axes, (1.0, low - 0.14), torso_length=2.3)
    for y in (top, low):
        _box(axes, (2.35, 3.65), (y - 0.34, y + 0.34))
        _words(axes, (3.0, y), "Skeletal feature\nabstraction", r"$g$")
    _box(axes, (4.2, 5.55), (low - 0.34, low + 0.34), _GREEN, _GREEN_EDGE)
    _words(axes, (4.875, low), "Sequential\naffine transform", r"$T$")
    _box(axes, (6.3, 7.45), (low - 0.52, top + 0.52))
    _words(axes, (6.875, (top + low) / 2), "Discriminator", r"$D$")


def _arrows(axes: Axes) -> None:
    """Draw what flows between the boxes, and label it."""
    top, low = _EXPERT_Y, _LEARNER_Y
    for y in (top, low):
        _arrow(axes, [(1.85, y), (2.35, y)])
    _arrow(axes, [(3.65, top), (6.3, top)])
    _arrow(axes, [(3.65, low), (4.2, low)])
    _arrow(axes, [(5.55, low), (6.3, low)])
    _label(axes, (2.1, top + 0.12), r"$s_t$")
    _label(axes, (2.1, low + 0.12), r"$s_t$")
    _label(axes, (4.97, top + 0.13), r"$o = (g(s_t),\ \ldots,\ g(s_{t+3}))$")
    _label(axes, (3.88, low + 0.12), r"$o$")
    _label(axes, (5.9, low + 0.12), r"$T(o)$")
    corner = (top + low) / 2 + 0.03
    gradient = [(6.3, corner), (4.875, corner), (4.875, low + 0.34)]
    _arrow(axes, gradient, color=_GREEN_EDGE, linestyle=(0, (4, 2.5)))
    axes.text(
        5.53, corner + 0.09, "gradient of $-\\log\\,D(T(o))$\nthrough the fixed $D$",
        ha="center", va="bottom", fontsize=8, color=_GREEN_EDGE, linespacing=1.35,
    )  # fmt: skip
    _reward(axes, low)


def _reward(axes: Axes, low: float) -> None:
    """Draw the way back from the discriminator to the policy."""
    y = 0.36
    way = [(6.875, low - 0.52), (6.875, y), (1.0, y), (1.0, low - 0.52)]
    _arrow(axes, way, color="#8a8a8a", linestyle=(0, (2.6, 1.4)), linewidth=3.2, head=0.19)
    axes.text(
        3.95, y, "the output of the discriminator is the reward that trains the policy",
        ha="center", va="center", fontsize=8.5,
        bbox={"boxstyle": "round,pad=0.55,rounding_size=0.4", "fc": "white", "ec": "#8a8a8a"},
    )  # fmt: skip


def _box(axes: Axes, x: Point, y: Point, face: str = _BLUE, edge: str = _BLUE_EDGE) -> None:
    shape = "round,pad=0,rounding_size=0.1"
    size = x[1] - x[0], y[1] - y[0]
    axes.add_patch(
        FancyBboxPatch((x[0], y[0]), *size, boxstyle=shape, fc=face, ec=edge, lw=1.1, zorder=3)
    )


def _words(axes: Axes, centre: Point, name: str, symbol: str) -> None:
    lines = name.count("\n") + 1
    shift = 0.03 + 0.05 * lines
    text: dict[str, Any] = {"ha": "center", "va": "center", "zorder": 4, "linespacing": 1.25}
    axes.text(centre[0], centre[1] + shift, name, weight="bold", **text)
    axes.text(centre[0], centre[1] - 0.05 - 0.08 * lines, symbol, fontsize=10, **text)


def _label(axes: Axes, at: Point, text: str) -> None:
    axes.text(*at, text, ha="center", va="center", fontsize=8.5, color=style.INK)


def _arrow(
    axes: Axes,
    way: Sequence[Point],
    color: str = style.INK,
    linestyle: object = "solid",
    linewidth: float = 1.3,
    head: float = 0.1,
) -> None:
    """Draw an arrow along straight pieces with rounded corners; `head` is its length, inches."""
    before, tip = np.asarray(way[-2], dtype=float), np.asarray(way[-1], dtype=float)
    along = (tip - before) / np.linalg.norm(tip - before)
    across = np.array([-along[1], along[0]])
    base = tip - head * along
    # The line and its head apart: a dashed line would leave gaps in the head's outline.
    line = {"fc": "none", "ec": color, "lw": linewidth, "ls": linestyle, "capstyle": "butt"}
    axes.add_patch(PathPatch(_rounded([*way[:-1], tuple(base)]), zorder=2, **line))
    corners = [tip, base + 0.45 * head * across, base - 0.45 * head * across]
    axes.add_patch(Polygon(corners, closed=True, fc=color, ec="none", zorder=5))


def _rounded(way: Sequence[Point], radius: float = 0.14) -> Path:
    """Return a path along `way` with rounded corners."""
    points = [np.asarray(point, dtype=float) for point in way]
    vertices, codes = [points[0]], [Path.MOVETO]
    for before, corner, after in zip(points, points[1:], points[2:], strict=False):
        start = corner + radius * (before - corner) / np.linalg.norm(before - corner)
        end = corner + radius * (after - corner) / np.linalg.norm(after - corner)
        vertices += [start, corner, end]
        codes += [Path.LINETO, Path.CURVE3, Path.CURVE3]
    return Path([*vertices, points[-1]], [*codes, Path.LINETO])


def _stack(axes: Axes, centre: Point, torso_length: float) -> None:
    """Draw a HalfCheetah in three successive poses, the latest in front."""
    for index, pose in enumerate(_POSES):
        shift = 0.17 * (index - 1)
        at = (centre[0] + shift, centre[1])
        _cheetah(axes, at, torso_length, pose, color=_TRAIL[index], zorder=4 + index)


def _cheetah(
    axes: Axes,
    centre: Point,
    torso_length: float,
    pose: tuple[tuple[float, ...], tuple[float, ...]],
    color: str,
    zorder: int,
) -> None:
    """Draw one HalfCheetah: torso, head and two legs, lengths in proportion to the model's."""
    scale = 0.36
    half = torso_length / 2
    lines = [
        np.array([[-half, 0.0], [half, 0.0]]),
        np.array([[half, 0.0], [half + 0.2, 0.22]]),
        _leg(-half, pose[0]),
        _leg(half, pose[1]),
    ]
    for line in lines:
        x, y = (line * scale + [centre[0] - 0.04, centre[1] + 0.13]).T
        axes.plot(
            x, y, color=color, lw=3.0, zorder=zorder,
            solid_capstyle="round", solid_joinstyle="round",
        )  # fmt: skip


def _leg(hip: float, angles: tuple[float, ...]) -> np.ndarray:
    """Return the (4, 2) points of a leg that hangs from (hip, 0)."""
    point, heading = np.array([hip, 0.0]), -np.pi / 2
    points = [point]
    for length, angle in zip((_THIGH, _SHIN, _FOOT), angles, strict=True):
        heading += angle
        point = point + length * np.array([np.cos(heading), np.sin(heading)])
        points.append(point)
    return np.array(points)
