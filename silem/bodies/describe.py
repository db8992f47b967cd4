"""What a body is made of, as the simulator has it rather than as the model file says."""

from __future__ import annotations

from typing import Any

import pybullet

from silem.bodies import bullet, registry
from silem.bodies.body import Body
from silem.bodies.shapes import shapes


def describe(name: str) -> dict[str, Any]:
    """Return a body's lengths, masses, joints and actuators.

    PyBullet ignores the model files' `settotalmass`, and its masses follow its own densities, so
    the masses are read from a loaded body.

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
    client = pybullet.connect(pybullet.DIRECT)
    try:
        robot = bullet.load(body, client)
        masses = _masses(robot, client)
        joints = _joints(body, robot, client)
    finally:
        pybullet.disconnect(physicsClientId=client)
    return {
        "name": body.name,
        "family": body.family,
        "description": body.description,
        "lengths_m": {s.name: round(s.length_m or s.radius_m, 6) for s in shapes(body)},
        "masses_kg": masses,
        "total_mass_kg": sum(masses.values()),
        "joints": joints,
        "root_joints": body.root_joints,
        "actuators": {motor.joint: motor.torque_n_m for motor in body.motors},
    }


def _masses(robot: int, client: int) -> dict[str, float]:
    links = bullet.link_names(robot, client).items()
    masses = {
        name: pybullet.getDynamicsInfo(robot, link, physicsClientId=client)[0]
        for name, link in links
    }
    return {name: mass for name, mass in masses.items() if mass > 0}


def _joints(body: Body, robot: int, client: int) -> dict[str, tuple[float, float]]:
    actuated = {motor.joint for motor in body.motors}
    infos = bullet.joint_infos(robot, client)
    return {info[1].decode(): (info[8], info[9]) for info in infos if info[1].decode() in actuated}
