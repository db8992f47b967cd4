"""The walking task's reward in a figure: what each of its four factors asks for."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from silem import bodies
from silem.bodies import MujocoBody
from silem.bodies.humanoid import DEMONSTRATOR_SPEED_M_S
from silem.envs.mujoco import task as walking
from silem.envs.mujoco.task import Reading
from silem.motion.features import POINTS
from silem.report import style

_SUITE_SPEED_M_S = 1.0  # what dm_control's own task asks for
_N = 201  # points of a curve


def factors() -> Figure:
    """Draw the reward's factors, each with the other three at their best, Humanoid's as example.

    The curves are computed by the environments' own `silem.envs.mujoco.task.rewards`.
    """
    body = bodies.get("Humanoid")
    assert isinstance(body, MujocoBody)
    head_m = np.linspace(0.0, 1.2 * body.standing_head_m, _N)
    tilt_rad = np.linspace(0.0, np.pi, _N)
    torque, speed_m_s = np.linspace(0.0, 1.0, _N), np.linspace(0.0, 2.5, _N)
    with style.applied():
        figure, (standing, upright, control, move) = style.new_figure(2.5, ncols=4, sharey=True)
        standing.plot(head_m, _rewards(body, head_m=head_m), color=style.INK)
        standing.axvspan(0.0, body.fall_head_m, color=style.FAINT, lw=0)
        standing.set(title="Standing", xlabel="head's height (m)", ylabel="factor of the reward")
        upright.plot(np.rad2deg(tilt_rad), _rewards(body, tilt_rad=tilt_rad), color=style.INK)
        upright.set(title="Upright", xlabel="torso's tilt (degrees)", xticks=[0, 90, 180])
        control.plot(torque, _rewards(body, torque=torque), color=style.INK)
        control.set(title="Small control", xlabel="size of all actions")
        for target, line in ((DEMONSTRATOR_SPEED_M_S, "-"), (_SUITE_SPEED_M_S, ":")):
            rewards = _rewards(body, speed_m_s=speed_m_s, target_m_s=target)
            move.plot(speed_m_s, rewards, line, color=style.INK, label=f"target {target:g} m/s")
        move.set(title="Speed", xlabel="horizontal speed (m/s)", ylim=(0, 1.05))
        move.legend(fontsize=7.5, loc="lower right")
    return figure


def _rewards(
    body: MujocoBody,
    *,
    head_m: np.ndarray | None = None,
    tilt_rad: np.ndarray | None = None,
    torque: np.ndarray | None = None,
    speed_m_s: np.ndarray | None = None,
    target_m_s: float = DEMONSTRATOR_SPEED_M_S,
) -> np.ndarray:
    """Return rewards (N,) of made-up states that are perfect but in the quantity given."""
    given = [values for values in (head_m, tilt_rad, torque, speed_m_s) if values is not None]
    (size,) = {len(values) for values in given}
    points, axes, velocity = (
        np.zeros((size, len(POINTS), 3)),
        np.zeros((size, 3, 3)),
        np.zeros((size, 3)),
    )
    points[:, POINTS.index("head"), 2] = body.standing_head_m if head_m is None else head_m
    axes[:, 2, 2] = 1.0 if tilt_rad is None else np.cos(tilt_rad)
    velocity[:, 0] = target_m_s if speed_m_s is None else speed_m_s
    actions = np.zeros((size, 1)) if torque is None else torque[:, None]
    nothing = np.empty((size, 0))
    reading = Reading(nothing, nothing, points, axes, velocity)
    return walking.rewards(reading, actions, body.standing_head_m, target_m_s)
