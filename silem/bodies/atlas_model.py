"""The MJCF model of Atlas v4, built from the constants in `silem/bodies/atlas_v4.json`.

Masses, inertias, joint axes, limits, efforts and shapes are the published ones. What a simulation
needs beside them:

- **Motors.** Torque at action 1 is the joint's published effort. Per weight and leg length that
  is what dm_control's humanoid has in its ankles and shoulders, and 1.6 to 3 times as much in its
  hips and knees.
- **Damping.** Effort over velocity limit, both published: a motor at full torque reaches its
  velocity limit and no more, the straight torque-speed line of a motor. With the published damping
  (0.1 N m s/rad) random torques make the model explode at this timestep.
- **Armature.** 0.05 kg m2 for all joints: the ankle's talus alone has 1e-5 kg m2.
- **Limits** are as stiff as the timestep allows, so that the ankle's range means something.
- **Contacts.** Each link meets the floor with its largest shape, a foot with the four corners of
  its sole (without the narrow tip of the toe, 4 cm). Of self-collision only what walking can run
  into is on: feet and shins of one leg with those of the other. Other shapes are only drawn.
- **Welds.** `*_arm_wry2`, published with +-0.001 rad, has neither joint nor motor: 28 of 30 remain.
"""

from __future__ import annotations

import functools
import itertools
import json
import math
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from silem.bodies import atlas_scene
from silem.util.errors import SilemError

SOURCE = Path(__file__).with_name("atlas_v4.json")
"""The published constants of the robot; the file says whence they come."""

ROOT = "pelvis"
ANKLES = ("aky", "akx")
"""The axes of an ankle, pitch and roll."""

TIMESTEP_S = 0.005

_WELDED = "arm_wry2"
_ARMATURE_KG_M2 = 0.05
_LIMIT_SOLREF = (2 * TIMESTEP_S, 1.0)  # the stiffest that MuJoCo advises
_CONTACT = {"solref": (0.015, 1.0), "solimp": (0.9, 0.99, 0.003, 0.5, 2.0)}  # dm_control's
_SOLE_RADIUS_M = 0.01

_BARE = {"contype": 0, "conaffinity": 0}  # drawn only
_SOLID = {"contype": 1, "conaffinity": 0, **_CONTACT}  # meets the floor and nothing else
_CORES = {  # capsules along shin and foot that keep the legs apart: ends and radius in m
    "lleg": ((0.0, 0.0, -0.05, 0.02, 0.0, -0.36), 0.07),
    "foot": ((-0.04, 0.0, -0.04, 0.12, 0.0, -0.04), 0.03),
}

Link = dict[str, Any]


@functools.cache
def constants() -> dict[str, Any]:
    """Return the published constants: `links` and `joints`, each by name.

    Raises:
        SilemError: If the file is missing or is not JSON.
    """
    try:
        return json.loads(SOURCE.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SilemError(f"cannot read Atlas's constants, {SOURCE}: {error}") from error


def hinges() -> list[str]:
    """Return the names of the 28 hinges, in the model's order."""
    return [name for name, joint in _walk(ROOT) if not name.endswith(_WELDED)]


def model(ankle_range_rad: float) -> str:
    """Return the MJCF text of Atlas on a floor under a sky.

    Args:
        ankle_range_rad: Both axes of both ankles turn within +- this.
    """
    spec = robot(ankle_range_rad)
    atlas_scene.add_scene(spec)
    atlas_scene.add_views(spec.body(ROOT))
    spec.compile()
    return spec.to_xml()


def robot(ankle_range_rad: float) -> mujoco.MjSpec:
    """Return Atlas alone, its ankles turning within +-`ankle_range_rad` about both axes."""
    spec = mujoco.MjSpec()
    spec.modelname = "atlas"
    spec.compiler.degree = False
    spec.option.timestep = TIMESTEP_S
    pelvis = spec.worldbody.add_body(name=ROOT)
    pelvis.add_freejoint(name="root")
    _fill(pelvis, ROOT, ankle_range_rad)
    for name in hinges():
        _add_motor(spec, name)
    for left, right in itertools.product(_CORES, repeat=2):
        spec.add_pair(geomname1=f"l_{left}_core", geomname2=f"r_{right}_core", condim=1)
    return spec


def sole_depth_m() -> float:
    """Return how far a sole lies below its ankle."""
    sole = _sole(constants()["links"]["l_foot"]["collision"])
    return float(sole["size"][2] / 2 - sole["xyz_m"][2])


def _walk(parent: str) -> list[tuple[str, Link]]:
    """Return the joints below a link, depth first: the order in which the model lists them."""
    found = []
    for name, joint in constants()["joints"].items():
        if joint["parent"] == parent:
            found += [(name, joint), *_walk(joint["child"])]
    return found


def _fill(body: mujoco.MjsBody, name: str, ankle_range_rad: float) -> None:
    """Give a body its mass, its shapes and the links that hang on it."""
    link = constants()["links"][name]
    inertia = link["inertia_kgm2"]
    body.explicitinertial = True
    body.mass, body.ipos = link["mass_kg"], link["com_m"]
    body.fullinertia = [inertia[key] for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")]
    _add_shapes(body, name, link["collision"])
    for joint_name, joint in constants()["joints"].items():
        if joint["parent"] == name:
            child = body.add_body(name=joint["child"], pos=joint["xyz_m"])
            child.quat = _quaternion(joint["rpy_rad"])
            if not joint_name.endswith(_WELDED):
                _add_hinge(child, joint_name, joint, ankle_range_rad)
            _fill(child, joint["child"], ankle_range_rad)


def _add_hinge(body: mujoco.MjsBody, name: str, joint: Link, ankle_range_rad: float) -> None:
    limit = joint["limit"]
    span = (limit["lower"], limit["upper"])
    if name.endswith(ANKLES):
        span = (-ankle_range_rad, ankle_range_rad)
    body.add_joint(
        name=name,
        axis=joint["axis"],
        range=span,
        damping=limit["effort"] / limit["velocity"],
        armature=_ARMATURE_KG_M2,
        solref_limit=_LIMIT_SOLREF,
    )


def _add_motor(spec: mujoco.MjSpec, joint: str) -> None:
    effort = constants()["joints"][joint]["limit"]["effort"]
    spec.add_actuator(
        name=joint,
        target=joint,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        gear=[effort, 0, 0, 0, 0, 0],
        ctrlrange=[-1, 1],
    )


def _add_shapes(body: mujoco.MjsBody, name: str, shapes: list[Link]) -> None:
    """Draw a link's shapes, and let the largest ones, or the corners of a sole, meet the floor."""
    is_foot = name.endswith("foot")
    rgba = atlas_scene.colour(name)
    largest_m3 = max(map(_volume_m3, shapes), default=0.0)
    for shape in shapes:
        is_solid = not is_foot and _volume_m3(shape) == largest_m3
        kind, size = _primitive(shape)
        orientation = _quaternion(shape["rpy_rad"])
        contact = _SOLID if is_solid else _BARE
        body.add_geom(
            type=kind, size=size, pos=shape["xyz_m"], quat=orientation, rgba=rgba, **contact
        )
    if is_foot:
        _add_sole(body, name, _sole(shapes), rgba)
    for part, (ends, radius) in _CORES.items():
        if name.endswith(part):
            body.add_geom(
                name=f"{name}_core",
                type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                fromto=ends,
                size=[radius, 0, 0],
                group=4,  # which pictures leave out
                **_BARE,
            )


def _add_sole(body: mujoco.MjsBody, name: str, box: Link, rgba: list[float]) -> None:
    """Add small spheres inside the lower corners of a foot's box, flush with its faces."""
    center = np.array(box["xyz_m"])
    reach = np.array(box["size"]) / 2 - _SOLE_RADIUS_M
    for index, (x, y) in enumerate(itertools.product((-1, 1), repeat=2)):
        body.add_geom(
            name=f"{name}_sole_{index}",
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[_SOLE_RADIUS_M, 0, 0],
            pos=center + reach * (x, y, -1),
            rgba=rgba,
            **_SOLID,
        )


def _primitive(shape: Link) -> tuple[mujoco.mjtGeom, list[float]]:
    """Return MuJoCo's type and sizes of a published shape."""
    if shape["shape"] == "box":
        return mujoco.mjtGeom.mjGEOM_BOX, [side / 2 for side in shape["size"]]
    if shape["shape"] == "cylinder":
        return mujoco.mjtGeom.mjGEOM_CYLINDER, [shape["radius"], shape["length"] / 2, 0]
    return mujoco.mjtGeom.mjGEOM_SPHERE, [shape["radius"], 0, 0]


def _sole(shapes: list[Link]) -> Link:
    """Return a foot's main box; the other one is the narrow tip of its toe."""
    return max(shapes, key=_volume_m3)


def _volume_m3(shape: Link) -> float:
    if shape["shape"] == "box":
        return math.prod(shape["size"])
    if shape["shape"] == "cylinder":
        return math.pi * shape["radius"] ** 2 * shape["length"]
    return 4 / 3 * math.pi * shape["radius"] ** 3


def _quaternion(rpy_rad: list[float]) -> np.ndarray:
    """Return the quaternion (4,) of a URDF's roll, pitch and yaw, about fixed axes."""
    quaternion = np.empty(4)
    mujoco.mju_euler2Quat(quaternion, np.array(rpy_rad), "XYZ")
    return quaternion
