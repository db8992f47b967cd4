"""What a body is made of, as the simulator has it rather than as the model file says."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from silem.bodies import registry
from silem.bodies.body import Body, BulletBody
from silem.bodies.shapes import shapes

_ROUND = (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_CYLINDER)


def describe(name: str) -> dict[str, Any]:
    """Return a body's lengths, masses, joints and actuators.

    PyBullet ignores the model files' `settotalmass`, and its masses follow its own densities, so
    the masses are read from a loaded body; MuJoCo's from the compiled model.

    Args:
        name: Name of the body.

    Returns:
        `name`, `family`, `description`; `lengths_m`: each capsule's length between the centres
        of its caps and each sphere's radius, by the name of its geom; `masses_kg` by link,
        massless links left out; `total_mass_kg`; `joints`: lower and upper limit in rad of each
        hinge, None where the model sets none; `root_joints`: those along which a planar root moves;
        `actuators`: torque in N m at action 1, by joint.

    Raises:
        SilemError: If there is no such body.
    """
    body = registry.get(name)
    measured = _in_bullet(body) if isinstance(body, BulletBody) else _in_mujoco(body)
    return {
        "name": body.name,
        "family": body.family,
        "description": body.description,
        "lengths_m": measured["lengths_m"],
        "masses_kg": measured["masses_kg"],
        "total_mass_kg": sum(measured["masses_kg"].values()),
        "joints": measured["joints"],
        "root_joints": body.root_joints if isinstance(body, BulletBody) else (),
        "actuators": {motor.joint: motor.torque_n_m for motor in body.motors},
    }


def _in_bullet(body: BulletBody) -> dict[str, dict[str, Any]]:
    from silem.bodies import (
        bullet,
    )  # PyBullet greets on standard output: only who needs it loads it

    measured = bullet.measure(body)
    return measured | {
        "lengths_m": {s.name: round(s.length_m or s.radius_m, 6) for s in shapes(body)}
    }


def _in_mujoco(body: Body) -> dict[str, dict[str, Any]]:
    model = mujoco.MjModel.from_xml_string(body.model_xml())
    lengths = {}
    for index, (kind, size) in enumerate(
        zip(model.geom_type.tolist(), model.geom_size, strict=True)
    ):
        if (name := model.geom(index).name) and kind in (*_ROUND, mujoco.mjtGeom.mjGEOM_SPHERE):
            lengths[name] = round(float(2 * size[1] if kind in _ROUND else size[0]), 6)
    links = [model.body(index) for index in range(1, model.nbody)]
    hinges = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE)
    limits = {
        model.joint(index).name: tuple(model.jnt_range[index].tolist())
        if model.jnt_limited[index]
        else None
        for index in hinges
    }
    masses = {link.name: float(link.mass[0]) for link in links if link.mass[0] > 0}
    return {"lengths_m": lengths, "masses_kg": masses, "joints": limits}
