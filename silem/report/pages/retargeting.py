"""The page of retargeting: its film, what inverse kinematics could not reach, limits, foot skate.

Everywhere `human` is the demonstrator's motion, and `results` is the same motion on some bodies.
"""

import itertools
import re
import tomllib
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator

from silem.bodies import MujocoBody, of_kind
from silem.motion import retargeting as ik
from silem.motion.demonstrations import retargeted
from silem.motion.demonstrator import Motion
from silem.motion.features import POINTS
from silem.motion.kinematics import SIDES
from silem.motion.retargeting import TARGETS, TOLERANCE_M, IKResult, standing_feet
from silem.report import film, style
from silem.report import results as runs
from silem.report.pages import demonstration
from silem.report.pages.demonstration import SIDE_COLORS
from silem.study.config import RunConfig
from silem.study.settings import HUMAN
from silem.util.paths import REPO

_TOP_JOINTS = 8
_LINES = {
    "left hand": (SIDE_COLORS["left"], ("left_hand",)),
    "right hand": (SIDE_COLORS["right"], ("right_hand",)),
    "torso": (style.INK, ("torso",)),
    "feet, the worse one": ("#009E73", ("left_foot", "right_foot")),
}
"""The lines of `residuals`: a label, a colour and the targets of which the worst counts."""


def beside(human: Motion, results: Sequence[IKResult], duration_s: float) -> film.Clip:
    """Film the start of the demonstrator's motion, and it on other bodies; no physics acts."""
    walks = {"the man": (film.man(), human.qpos)}
    walks |= {result.body: (ik.learner(result.body), result.qpos) for result in results}
    clips = {
        name: film.motion(body, qpos, human.rate_hz, duration_s, film.PANEL)
        for name, (body, qpos) in walks.items()
    }
    return film.grid(clips, n_columns=len(clips))


def poses(human: Motion, result: IKResult) -> Figure:
    """Draw poses of the man and of a learner, a ring of the tolerance where its hands should be."""
    walks = {"the man": human.points, result.body: result.points}
    figure = demonstration.poses(walks, human.rate_hz)
    states = demonstration.equal_times(len(human.points), demonstration.N_POSES)
    wanted = demonstration.from_the_right(hand_targets(human, result)[states])
    for places, color in zip(wanted.swapaxes(0, 1), SIDE_COLORS.values(), strict=True):
        for place in places:
            ring = Circle(place, TOLERANCE_M, fill=False, ec=color, lw=1.2, zorder=5)
            figure.axes[1].add_patch(ring)
    return figure


@style.applied()
def residuals(results: Sequence[IKResult]) -> Figure:
    """Draw over time how far each landmark is from its target, one panel per body."""
    titles = [result.body for result in results]
    figure, grid = style.panels(titles, 1.6, 1, sharex=True, sharey=True)
    for axes, result in zip(grid, results, strict=True):
        time_s = np.arange(len(result.residuals)) / result.rate_hz
        for color, names in _LINES.values():
            worst = result.residuals[:, [TARGETS.index(name) for name in names]].max(axis=1)
            axes.plot(time_s, 1000 * worst, color=color, lw=1.5)
        axes.axhline(1000 * TOLERANCE_M, color=style.MUTED, lw=1.2, ls=style.DASHED)
        axes.set(ylabel="mm", xlim=(0, time_s[-1]))
    grid[-1].set_ylim(bottom=-2)
    grid[-1].set_xlabel("time (s)")
    lines = [style.handle(color, label, lw=1.8) for label, (color, _) in _LINES.items()]
    label = f"tolerance, {1000 * TOLERANCE_M:.0f} mm"
    lines.append(style.handle(style.MUTED, label, lw=1.2, ls=style.DASHED))
    return style.finish(figure, lines, ncols=5)


@style.applied()
def joint_limits(results: Sequence[IKResult]) -> Figure:
    """Draw in which share of the frames joints are at a limit: of each body the foremost ones."""
    figure, grid = style.panels([r.body for r in results], 2.5, len(results), sharex=True)
    for axes, result in zip(grid, results, strict=True):
        shares = 100 * pd.Series(result.at_limit.mean(axis=0), result.joint_names)
        top = shares[shares > 0].nlargest(_TOP_JOINTS)
        axes.barh(range(len(top)), top, color=[demonstration.side_color(n) for n in top.index])
        axes.set_yticks(range(len(top)), top.index)
        axes.set(ylim=(_TOP_JOINTS - 0.4, -0.6), xlabel="frames (%)")  # the most frequent on top
        axes.grid(axis="x")
        axes.grid(visible=False, axis="y")
    return style.finish(figure, demonstration.handles("side"), ncols=2, word="none")


@style.applied()
def foot_skate(human: Motion, results: Sequence[IKResult]) -> Figure:
    """Draw the horizontal speed of each ankle while the man's stands, his own behind it."""
    own = _own_skate(human)
    time_s = np.arange(len(own)) / human.rate_hz
    figure, grid = style.panels([r.body for r in results], 2.1, len(results), sharey=True)
    for axes, result in zip(grid, results, strict=True):
        for side, his, speeds in zip(SIDES, own.T, result.foot_skate_m_s.T, strict=True):
            color = SIDE_COLORS[side]
            axes.plot(time_s, his, color=color, lw=4, alpha=0.3, solid_capstyle="butt")
            axes.plot(time_s, speeds, color=color, lw=1.4)
        axes.set(xlabel="time (s)", xlim=(0, time_s[-1]))
        axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    grid[0].set_ylabel("m/s")
    handles = demonstration.handles("foot")
    handles.append(style.handle(style.MUTED, "on the learner", lw=1.4))
    handles.append(style.handle(style.MUTED, "the man's own", lw=4, alpha=0.4))
    return style.finish(figure, handles, ncols=4)


def limb_ratios(human: Motion, results: Sequence[IKResult]) -> pd.DataFrame:
    """Return the demonstrator's limbs in m, and each learner's as ratios to them."""
    rows = {"the man's, in m": ik.Limbs.of(human.points)}
    rows |= {f"{result.body}'s over his": result.ratios for result in results}
    labels = [name.replace("_", " ") for name in ik.Limbs._fields]
    return pd.DataFrame(rows.values(), rows, labels).rename_axis("lengths")


def scales(results: Sequence[IKResult], frame: pd.DataFrame) -> pd.DataFrame:
    """Return by how much hands and feet are brought nearer or further, and who says so: a row each.

    That is: a learner's limbs over the man's; 1 / a, the mean over SILEM's runs and the three axes,
    since A makes the man's of the learner's positions; what a retargeting tool has in its tables.
    """
    rows: list[tuple[Any, ...]] = []
    for result in results:
        arms_and_legs = result.ratios.left_arm, result.ratios.right_arm, result.ratios.leg
        rows.append((result.body, "its limbs over the man's", *arms_and_legs))
        values = partial(runs.values, frame, "silem", result.body)
        hands = [values(f"A {side}_hand") for side in SIDES]
        feet = np.mean([values(f"A {side}_foot") for side in SIDES], axis=0)
        learned = [1 / np.mean(a) if len(a) else np.nan for a in (*hands, feet)]
        rows.append((result.body, f"1 / a of SILEM, {style.trials(len(feet))}", *learned))
    for robot in tomllib.loads((REPO / "data" / "scale_tables.toml").read_text())["robot"]:
        said = [robot[name] for name in ("left_hand", "right_hand", "feet")]
        where = f"{robot['source']}, {robot['commit'][:7]}"
        rows.append((robot["name"], f"set by hand: {where}", *said))
    columns = ["body", "by", "left hand", "right hand", "feet"]
    return pd.DataFrame(rows, columns=columns).set_index("body")


def hands(human: Motion, results: Sequence[IKResult]) -> pd.DataFrame:
    """Return how far each learner's hands stay from their targets, and why: a row per hand.

    The columns from "beyond" on are over the frames in which the hand is further from its target
    than the tolerance: their share, by how much the hand is too far forward and outward in the
    torso's frame, and the shares in which the target is behind the shoulder and in which a joint
    of this arm is at a limit.
    """
    rows = []
    for result, side in itertools.product(results, SIDES):
        wanted = hand_targets(human, result)[:, SIDES.index(side)]
        hand, shoulder = (
            result.points[:, POINTS.index(f"{side}_{n}")] for n in ("hand", "shoulder")
        )
        distance = result.residuals[:, TARGETS.index(f"{side}_hand")]
        forward, left, _ = np.einsum("tij,tj->it", human.torso_axes, hand - wanted)
        ahead = np.einsum("tj,tj->t", human.torso_axes[:, 0], wanted - shoulder)
        arm = re.compile(rf"{side}_(shoulder|elbow)|{side[0]}_arm_")
        arm_joints = [bool(arm.match(name)) for name in result.joint_names]
        row: dict[str, Any] = {"body": result.body, "hand": side}
        row |= {"mean (mm)": 1000 * distance.mean(), "worst (mm)": 1000 * distance.max()}
        row["beyond (%)"] = 100 * (beyond := distance > TOLERANCE_M).mean()
        of_these = {
            "forward (mm)": 1000 * forward,
            "outward (mm)": 1000 * (left if side == "left" else -left),
            "behind (%)": 100 * (ahead < 0),
            "at limit (%)": 100 * result.at_limit[:, arm_joints].any(axis=1),
        }
        rows.append(
            row | {k: v[beyond].mean() if beyond.any() else np.nan for k, v in of_these.items()}
        )
    return pd.DataFrame(rows)


def foot_skates(human: Motion, results: Sequence[IKResult]) -> pd.DataFrame:
    """Return mean and largest speed of each ankle while the man's feet stand, his own first."""
    skates = {"the man": _own_skate(human)}
    skates |= {result.body: result.foot_skate_m_s for result in results}
    table = pd.concat({n: pd.DataFrame(s, columns=list(SIDES)) for n, s in skates.items()})
    found = table.groupby(level=0, sort=False).agg(["mean", "max"]).rename_axis("body")
    what = {"mean": "mean", "max": "largest"}
    found.columns = pd.Index([f"{side} {what[of]} (m/s)" for side, of in found.columns])
    return found


def starts(results: Sequence[IKResult]) -> pd.DataFrame:
    """Return what a SILEM run's body changes in the retargeted states to start from them."""
    rows = []
    for result in results:
        body = of_kind(RunConfig.create(result.body, "silem").learner, MujocoBody)
        qpos, _ = ik.demonstration_states(retargeted(HUMAN, body.name), body)
        moved = np.abs(qpos - result.qpos)
        row = {"body": body.name, "states": len(qpos)}
        row["changed"] = int((moved[:, 7:] > 0).any(axis=1).sum())
        row["joint at most by (rad)"] = moved[:, 7:].max()
        rows.append(row | {"lifted at most by (mm)": 1000 * moved[:, 2].max()})
    return pd.DataFrame(rows)


def hand_targets(human: Motion, result: IKResult) -> np.ndarray:
    """Return where the left and the right hand of a learner should be, (T, 2, 3) in m."""
    wanted = ik.targets(human, ik.learner(result.body)).positions
    return wanted[:, [TARGETS.index(f"{side}_hand") for side in SIDES]]


def _own_skate(human: Motion) -> np.ndarray:
    """Return the speed of the demonstrator's own standing ankles in m/s, (T, 2); NaN in swing."""
    return np.where(standing_feet(human), ik.foot_speeds_m_s(human.points, human.rate_hz), np.nan)
