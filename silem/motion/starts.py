"""States of a retargeted demonstration, for episodes that start from them."""

from __future__ import annotations

import mujoco
import numpy as np

from silem.bodies.body import MujocoBody
from silem.motion.demonstrations import Demonstrations
from silem.motion.retarget import LIMIT_TOLERANCE_RAD
from silem.motion.soles import Soles
from silem.motion.targets import SIDES
from silem.util.errors import SilemError


def demonstration_states(name: str, body: MujocoBody) -> tuple[np.ndarray, np.ndarray]:
    """Return the states of retargeted demonstrations as states of a learner's body.

    Peng20 retargets to an Atlas whose ankles turn further than those of the Atlas that other
    methods train. A hinge beyond its range is put to the limit, at rest, and the body is lifted
    until both soles are above the floor; states that fit are returned as they are.

    Args:
        name: Name of the demonstrations, for example "cmu_08_01_on_Humanoid".
        body: The learner's body.

    Returns:
        Positions (S, nq) and velocities (S, nv).

    Raises:
        SilemError: There are no demonstrations of this name, they hold no states, or states of
            another body or with NaN or infinity.
    """
    extra = Demonstrations.load(name).extra
    missing = [array for array in ("qpos", "qvel") if array not in extra]
    if missing:
        raise SilemError(f"demonstrations {name!r} hold no states: they lack {', '.join(missing)}")
    qpos, qvel = extra["qpos"], extra["qvel"]
    model = mujoco.MjModel.from_xml_string(body.model_xml())
    if qpos.shape[1:] != (model.nq,) or qvel.shape[1:] != (model.nv,):
        raise SilemError(
            f"demonstrations {name!r} hold states of shape {qpos.shape[1:]} and {qvel.shape[1:]};"
            f" {body.name} needs ({model.nq},) and ({model.nv},)"
        )
    finite = np.isfinite(qpos).all(axis=1) & np.isfinite(qvel).all(axis=1)
    if not finite.all():
        frame = int(np.argmin(finite))
        raise SilemError(f"demonstrations {name!r}: state {frame} holds NaN or infinity")
    return _within_range(model, body, qpos, qvel)


def _within_range(
    model: mujoco.MjModel, body: MujocoBody, qpos: np.ndarray, qvel: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return states whose hinges are in their range and whose soles are not below the floor."""
    hinges = np.flatnonzero(model.jnt_limited)
    places, rates = model.jnt_qposadr[hinges], model.jnt_dofadr[hinges]
    allowed = np.clip(qpos[:, places], *model.jnt_range[hinges].T)
    beyond = np.abs(qpos[:, places] - allowed) > LIMIT_TOLERANCE_RAD
    qpos, qvel = qpos.copy(), qvel.copy()
    qpos[:, places] = np.where(beyond, allowed, qpos[:, places])
    qvel[:, rates] = np.where(beyond, 0.0, qvel[:, rates])
    data = mujoco.MjData(model)
    soles = Soles(model, [getattr(body.skeleton, f"{side}_foot") for side in SIDES])
    for changed in np.flatnonzero(beyond.any(axis=1)):
        data.qpos[:] = qpos[changed]
        mujoco.mj_kinematics(model, data)
        qpos[changed, 2] += max(0.0, -soles.heights(data).min())
    return qpos, qvel
