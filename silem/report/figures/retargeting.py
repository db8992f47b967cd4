"""Retargeting in figures: what inverse kinematics could not reach, joints at limits, foot skate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator

from silem.motion.demonstrator import Motion
from silem.motion.kinematics import SIDES
from silem.motion.retargeting import TARGETS, TOLERANCE_M, IKResult
from silem.report import style
from silem.report.figures.motion import SIDE_COLORS, draw_pose
from silem.report.retargeting import hand_targets, own_foot_skate
from silem.util.errors import SilemError

_MARGIN_M = 0.15
_SIDE_VIEW = [0, 2]  # x to the right and z up: seen from the right
_DASHES = (0, (4, 3))
_TOP_JOINTS = 8

_LINES = {
    "left hand": (SIDE_COLORS["left"], ("left_hand",)),
    "right hand": (SIDE_COLORS["right"], ("right_hand",)),
    "torso": (style.INK, ("torso",)),
    "feet, the worse one": ("#009E73", ("left_foot", "right_foot")),
}
"""The lines of `residuals`: a label, a colour and the targets of which the worst counts."""


def poses(human: Motion, result: IKResult, n_poses: int = 5) -> Figure:
    """Draw poses of the demonstrator and of a learner with its hands' targets, seen from the right.

    A ring around each target has the tolerance as its radius: a hand outside it has not arrived.

    Args:
        human: The demonstrator's motion.
        result: The same motion retargeted.
        n_poses: How many poses, at equal times, the first and the last state among them.

    Raises:
        SilemError: There are fewer states than that, or less than 2 poses are asked for.
    """
    if not 2 <= n_poses <= len(human.points):
        raise SilemError(f"{n_poses} poses of {len(human.points)} states; allowed: 2 to all")
    states = np.linspace(0, len(human.points) - 1, n_poses).round().astype(int)
    walks = {"the man": human.points, result.body: result.points}
    seen = np.concatenate(list(walks.values()))[..., _SIDE_VIEW]
    low, high = seen.min(axis=(0, 1)) - _MARGIN_M, seen.max(axis=(0, 1)) + _MARGIN_M
    with style.applied():
        ratio = (high[1] - low[1]) / (high[0] - low[0])
        figure, grid = style.new_figure(2 * style.WIDTH_IN * ratio + 0.6, nrows=2, sharex=True)
        for axes, (name, points) in zip(grid, walks.items(), strict=True):
            axes.set(xlim=(low[0], high[0]), ylim=(-0.1, high[1]), aspect="equal")
            axes.set(title=name, ylabel="z, up (m)")
            axes.axhline(0.0, color=style.MUTED, lw=1)
            for state in states:
                draw_pose(axes, points[state][:, _SIDE_VIEW])
        wanted = hand_targets(human, result)[states][..., _SIDE_VIEW]
        for places, color in zip(wanted.swapaxes(0, 1), SIDE_COLORS.values(), strict=True):
            for place in places:
                ring = Circle(place, TOLERANCE_M, fill=False, ec=color, lw=1.2, zorder=5)
                grid[1].add_patch(ring)
        grid[1].set_xlabel("x, forward (m)")
        figure.legend(handles=_side_handles("side"), loc="outside upper left", ncols=2)
    return figure


def residuals(results: Sequence[IKResult]) -> Figure:
    """Draw over time how far each landmark is from its target, one panel per body.

    Args:
        results: One motion on some bodies.
    """
    with style.applied():
        rows = len(results)
        figure, grid = style.new_figure(
            0.8 + 1.45 * rows, nrows=rows, sharex=True, sharey=True, squeeze=False
        )
        for axes, result in zip(grid.flat, results, strict=True):
            time_s = np.arange(len(result.residuals)) / result.rate_hz
            for color, names in _LINES.values():
                worst = result.residuals[:, [TARGETS.index(name) for name in names]].max(axis=1)
                axes.plot(time_s, 1000 * worst, color=color, lw=1.5)
            axes.axhline(1000 * TOLERANCE_M, color=style.MUTED, lw=1.2, ls=_DASHES)
            axes.set(title=result.body, ylabel="mm", xlim=(0, time_s[-1]))
        axes.set_ylim(bottom=-2)
        axes.set_xlabel("time (s)")
        lines = [Line2D([], [], color=c, lw=1.8, label=k) for k, (c, _) in _LINES.items()]
        label = f"tolerance, {1000 * TOLERANCE_M:.0f} mm"
        lines.append(Line2D([], [], color=style.MUTED, lw=1.2, ls=_DASHES, label=label))
        figure.legend(handles=lines, loc="outside upper left", ncols=5, columnspacing=1.2)
    return figure


def foot_skate(human: Motion, results: Sequence[IKResult]) -> Figure:
    """Draw the horizontal speed of each ankle while the demonstrator's stands, his own behind it.

    Args:
        human: The demonstrator's motion.
        results: The same motion on some bodies.
    """
    own = own_foot_skate(human)
    time_s = np.arange(len(own)) / human.rate_hz
    with style.applied():
        figure, grid = style.new_figure(2.5, ncols=len(results), sharey=True, squeeze=False)
        for axes, result in zip(grid.flat, results, strict=True):
            for side, his, speeds in zip(SIDES, own.T, result.foot_skate_m_s.T, strict=True):
                color = SIDE_COLORS[side]
                axes.plot(time_s, his, color=color, lw=4, alpha=0.3, solid_capstyle="butt")
                axes.plot(time_s, speeds, color=color, lw=1.4)
            axes.set(title=result.body, xlabel="time (s)", xlim=(0, time_s[-1]))
            axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        grid[0, 0].set_ylabel("m/s")
        handles = _side_handles("foot")
        handles += [
            Line2D([], [], color=style.MUTED, lw=1.4, label="on the learner"),
            Line2D([], [], color=style.MUTED, lw=4, alpha=0.4, label="the man's own"),
        ]
        figure.legend(handles=handles, loc="outside upper left", ncols=4)
    return figure


def joint_limits(results: Sequence[IKResult]) -> Figure:
    """Draw in which share of the frames joints are at a limit: of each body the foremost ones.

    Args:
        results: One motion on some bodies.
    """
    with style.applied():
        figure, grid = style.new_figure(2.9, ncols=len(results), sharex=True, squeeze=False)
        for axes, result in zip(grid.flat, results, strict=True):
            shares = 100 * pd.Series(result.at_limit.mean(axis=0), result.joint_names)
            top = shares[shares > 0].nlargest(_TOP_JOINTS)
            axes.barh(range(len(top)), top, color=[_joint_color(name) for name in top.index])
            axes.set_yticks(range(len(top)), top.index)
            axes.set_ylim(_TOP_JOINTS - 0.4, -0.6)  # the most frequent one on top
            axes.set(title=result.body, xlabel="frames (%)")
            axes.grid(axis="x")
            axes.grid(visible=False, axis="y")
        figure.legend(handles=_side_handles("side"), loc="outside upper left", ncols=2)
    return figure


def _joint_color(name: str) -> str:
    """Return the colour of a joint's side: "left_knee" and "l_leg_kny" are on the left."""
    initials = {side[0]: color for side, color in SIDE_COLORS.items()}
    first = name.partition("_")[0]
    return SIDE_COLORS.get(first, initials.get(first, style.INK))


def _side_handles(what: str) -> list[Line2D]:
    return [
        Line2D([], [], color=color, lw=2.4, label=f"{side} {what}")
        for side, color in SIDE_COLORS.items()
    ]
