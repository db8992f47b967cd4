"""Loading a body into a PyBullet client."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pybullet

from silem.bodies.body import BulletBody
from silem.util.errors import SilemError

BASE = -1  # PyBullet's number for the link at the root of a body's tree
_FLAGS = (
    pybullet.URDF_USE_SELF_COLLISION
    | pybullet.URDF_USE_SELF_COLLISION_EXCLUDE_ALL_PARENTS
    | pybullet.URDF_GOOGLEY_UNDEFINED_COLORS
)


def load(body: BulletBody, client: int) -> int:
    """Load a body as PyBullet's locomotion tasks do, and return PyBullet's number of it.

    Raises:
        SilemError: If PyBullet rejects the model.
    """
    with _model_file(body) as path:
        try:
            (robot,) = pybullet.loadMJCF(path, flags=_FLAGS, physicsClientId=client)
        except (pybullet.error, ValueError) as error:
            raise SilemError(f"PyBullet cannot load body {body.name!r}: {error}") from error
    return int(robot)


def joint_infos(robot: int, client: int) -> list[tuple[Any, ...]]:
    """Return PyBullet's description of every joint, in order."""
    count = pybullet.getNumJoints(robot, physicsClientId=client)
    return [pybullet.getJointInfo(robot, index, physicsClientId=client) for index in range(count)]


def link_names(robot: int, client: int) -> dict[str, int]:
    """Return the number of every named link, the base included.

    The base comes first: where a link proper has the same name, the link it is.
    """
    base = pybullet.getBodyInfo(robot, physicsClientId=client)[0].decode()
    links = {info[12].decode(): index for index, info in enumerate(joint_infos(robot, client))}
    return {base: BASE} | links


def measure(body: BulletBody) -> dict[str, dict[str, Any]]:
    """Return `masses_kg` by link and `joints`, their limits in rad, of a body that is loaded."""
    client = pybullet.connect(pybullet.DIRECT)
    try:
        robot = load(body, client)
        masses = {
            name: pybullet.getDynamicsInfo(robot, link, physicsClientId=client)[0]
            for name, link in link_names(robot, client).items()
        }
        infos = {info[1].decode(): info for info in joint_infos(robot, client)}
    finally:
        pybullet.disconnect(physicsClientId=client)
    joints = [motor.joint for motor in body.motors]
    return {
        "masses_kg": {name: mass for name, mass in masses.items() if mass > 0},
        "joints": {name: tuple(infos[name][8:10]) for name in infos if name in joints},
    }


@contextlib.contextmanager
def _model_file(body: BulletBody) -> Iterator[str]:
    """Give the body's model as a file, the only form in which PyBullet loads it."""
    handle, path = tempfile.mkstemp(prefix=f"{body.name}_", suffix=".xml")
    try:
        with os.fdopen(handle, "w", encoding="utf-8", newline="") as file:
            file.write(body.model_xml())
        yield path
    finally:
        Path(path).unlink(missing_ok=True)
