"""The demonstrator on film: a captured motion on dm_control's ``humanoid_CMU``."""

from __future__ import annotations

from functools import cache

import mujoco
from dm_control.suite import humanoid_CMU

from silem import bodies
from silem.bodies import MujocoBody
from silem.bodies.humanoid import FALL_HEAD_M, STANDING_HEAD_M, common
from silem.motion.demonstrator import BODY, SKELETON, Motion
from silem.report import rendering
from silem.report.video import Clip
from silem.util.errors import SilemError

STATES_PER_PICTURE = 2
"""20 pictures a second show a walk; each costs as much to draw as many states cost to simulate."""


def film(motion: Motion, states_per_picture: int = STATES_PER_PICTURE) -> Clip:
    """Film a captured motion, in real time and from the side that the learners are filmed from.

    The published states are enough for it; no raw clip is needed.

    Args:
        motion: The motion.
        states_per_picture: Every how many states a picture is taken.

    Raises:
        SilemError: That number is below 1, or nothing can be drawn offscreen here.
    """
    if states_per_picture < 1:
        raise SilemError(f"states_per_picture = {states_per_picture}; allowed: 1 or more")
    rate_hz = motion.rate_hz / states_per_picture
    return rendering.motion(demonstrator(), motion.qpos[::states_per_picture], rate_hz)


@cache
def demonstrator() -> MujocoBody:
    """Return the demonstrator as a body that a camera can follow; nothing moves it but a motion."""
    text, assets = humanoid_CMU.get_model_and_assets()
    model = mujoco.MjSpec.from_string(text, include=assets)
    pose = tuple(model.compile().qpos0.tolist())
    return MujocoBody(
        name=BODY,
        description="dm_control's humanoid with the proportions of CMU's subject 8",
        build=model.to_xml,
        motors=(),
        length=("", 0.0),
        varied=(),
        view=bodies.get("Humanoid").view,
        target_speed_m_s=1.0,
        skeleton=SKELETON,
        standing_pose=pose,
        standing_head_m=STANDING_HEAD_M,
        fall_head_m=FALL_HEAD_M,
        **common(STANDING_HEAD_M),
    )
