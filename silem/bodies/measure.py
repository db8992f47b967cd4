"""Bodies as their simulators have them: loaded into PyBullet, and measured in either."""

import re
import tempfile
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from silem.bodies.body import Body, BulletBody
from silem.util.errors import SilemError, reason
from silem.util.offscreen import silence

with silence(2):  # its greeting
    import pybullet

BASE = -1  # PyBullet's number for the link at the root of a body's tree
_FLAGS = (
    pybullet.URDF_USE_SELF_COLLISION
    | pybullet.URDF_USE_SELF_COLLISION_EXCLUDE_ALL_PARENTS
    | pybullet.URDF_GOOGLEY_UNDEFINED_COLORS
)
_ROUND = (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_CYLINDER)


def describe(body: Body) -> dict[str, Any]:
    """Return what `silem.bodies.describe` does."""
    model, lengths = spec(body).compile(), {}
    for geom in map(model.geom, range(model.ngeom)):
        kind, (radius, half, _) = int(geom.type[0]), geom.size.tolist()
        if geom.name and kind in (*_ROUND, mujoco.mjtGeom.mjGEOM_SPHERE):
            lengths[geom.name] = round(2 * half if kind in _ROUND else radius, 6)
    masses, joints = _in_bullet(body) if isinstance(body, BulletBody) else _in_mujoco(model)
    masses = {name: mass for name, mass in masses.items() if mass > 0}
    return {
        "name": body.name,
        "family": body.family,
        "description": body.description,
        "lengths_m": lengths,
        "masses_kg": masses,
        "total_mass_kg": sum(masses.values()),
        "joints": joints,
        "root_joints": getattr(body, "root_joints", ()),
        "actuators": {motor.joint: motor.torque_n_m for motor in body.motors},
    }


def spec(body: Body) -> mujoco.MjSpec:
    """Return a body's model as MuJoCo reads it; one that floats has a free joint.

    PyBullet's files lack what MuJoCo asks for beside a mass, and a root that floats has no joint.
    Raises SilemError if MuJoCo rejects the model.
    """
    xml = body.model_xml()
    if isinstance(body, BulletBody):
        xml = re.sub(r"<inertial\b[^>]*/>", "", xml)
    try:
        read = mujoco.MjSpec.from_string(xml)
    except ValueError as error:
        raise SilemError(f"MuJoCo cannot load body {body.name!r}: {error}") from error
    if isinstance(body, BulletBody):
        read.compiler.settotalmass = -1  # which PyBullet ignores
        if not body.root_joints:
            read.body(body.root).add_freejoint()
    return read


_Measured = tuple[dict[str, float], dict[str, tuple[float, float] | None]]  # masses, limits


def _in_bullet(body: BulletBody) -> _Measured:
    """Read off a loaded body: PyBullet ignores `settotalmass` and has densities of its own."""
    client = pybullet.connect(pybullet.DIRECT)
    try:
        robot = load(body, client)
        masses = {
            name: pybullet.getDynamicsInfo(robot, link, physicsClientId=client)[0]
            for name, link in link_names(robot, client).items()
        }
        limits = {info[1].decode(): info[8:10] for info in joint_infos(robot, client)}
    finally:
        pybullet.disconnect(physicsClientId=client)
    actuated = {motor.joint for motor in body.motors}
    return masses, {name: limit for name, limit in limits.items() if name in actuated}


def _in_mujoco(model: mujoco.MjModel) -> _Measured:
    joints = map(model.joint, np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE))
    limits = {j.name: tuple(j.range.tolist()) if j.limited[0] else None for j in joints}
    return {model.body(i).name: float(model.body_mass[i]) for i in range(1, model.nbody)}, limits


def load(body: BulletBody, client: int) -> int:
    """Load a body as PyBullet's locomotion tasks do, and return PyBullet's number of it.

    Raises SilemError if PyBullet rejects the model.
    """
    try:  # a file is the only form in which PyBullet loads it
        with tempfile.TemporaryDirectory(prefix="silem_") as folder:
            path = Path(folder) / f"{body.name}.xml"
            path.write_bytes(body.model_xml().encode())
            (robot,) = pybullet.loadMJCF(str(path), flags=_FLAGS, physicsClientId=client)
    except OSError as error:
        raise SilemError(f"no temporary file for {body.name}: {reason(error)}") from error
    except (pybullet.error, ValueError) as error:
        raise SilemError(f"PyBullet cannot load body {body.name!r}: {error}") from error
    return int(robot)


def joint_infos(robot: int, client: int) -> list[tuple[Any, ...]]:
    """Return PyBullet's description of every joint, in order."""
    count = pybullet.getNumJoints(robot, physicsClientId=client)
    return [pybullet.getJointInfo(robot, index, physicsClientId=client) for index in range(count)]


def link_names(robot: int, client: int) -> dict[str, int]:
    """Return the number of every named link, and of the base unless a link has its name."""
    base = pybullet.getBodyInfo(robot, physicsClientId=client)[0].decode()
    links = {info[12].decode(): index for index, info in enumerate(joint_infos(robot, client))}
    return {base: BASE} | links
