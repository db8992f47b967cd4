"""Atlas, Boston Dynamics' robot (v4), with an adjustable ankle.

Left is +y and forward +x in every upright link. The landmarks are the origins of links, which are
joints: `utorso` is the torso, the head is the neck's joint, a shoulder the joint that raises the
arm sideways, a hand the wrist, a foot the ankle. "Ankle's range of motion" is read as pitch and
roll of both: the paper gives one number, and a stiff ankle lets weak motors keep the foot flat.

The constants in `silem/bodies/atlas_v4.json` (masses, inertias, axes, limits, efforts, shapes) are
the published ones. What a simulation needs beside them, and what the paper leaves open, is on the
page "Deviations":

- **Motors.** Torque at action 1 is the joint's published effort. Per weight and leg length that is
  what dm_control's humanoid has in ankles and shoulders, and 1.6 to 3 times that in hips and knees.
- **Damping.** Effort over velocity limit: the straight torque-speed line of a motor. With the
  published 0.1 N m s/rad random torques make the model explode at this timestep.
- **Armature.** 0.05 kg m2 for all joints: the ankle's talus alone has 1e-5 kg m2.
- **Limits** are as stiff as the timestep allows, so that the ankle's range means something.
- **Contacts.** Each link meets the floor with its largest shape, a foot with the four corners of
  its sole; of self-collision only feet and shins of one leg with those of the other are on.
- **Welds.** `*_arm_wry2`, published with +-0.001 rad, has neither joint nor motor: 28 of 30 remain.
"""

import functools
import itertools
import json
import math
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from silem.bodies.body import MujocoBody, Skeleton
from silem.bodies.humanoid import FALL_HEAD_M, STANDING_HEAD_M, common, placed
from silem.util.errors import SilemError

_LEG = {"hip": "uleg", "knee": "lleg", "foot": "foot"}
SKELETON = Skeleton.of_sides(
    "utorso", "head", "l_", "r_", shoulder="scap", elbow="larm", hand="hand", **_LEG
)
_HUMANOID_HEAD_M = 1.4755  # dm_control's humanoid in its zero pose, soles on the floor

_ARM_RAD = {"shx": 1.35, "ely": np.pi / 2, "elx": -0.3}  # hanging, elbows bent forward a little
_MIRRORED = ("shx", "elx")  # whose sign differs between left and right
_FOREARM_RAD = {"l": np.pi, "r": 0.0}  # one forearm is mounted turned by pi about its own axis
_KNEE_RAD = 0.1
_ANKLE_RAD = 0.05  # enough to bring the centre of mass over the soles

_SOURCE = Path(__file__).with_name("atlas_v4.json")  # says whence its constants come
_ROOT = "pelvis"
_ANKLES = ("aky", "akx")  # the axes of an ankle, pitch and roll
_TIMESTEP_S = 0.005
_WELDED = "arm_wry2"
_ARMATURE_KG_M2 = 0.05
_LIMIT_SOLREF = (2 * _TIMESTEP_S, 1.0)  # the stiffest that MuJoCo advises
_CONTACT = {"solref": (0.015, 1.0), "solimp": (0.9, 0.99, 0.003, 0.5, 2.0)}  # dm_control's
_SOLE_RADIUS_M = 0.01

_BARE = {"contype": 0, "conaffinity": 0}  # drawn only
_SOLID = {"contype": 1, "conaffinity": 0, **_CONTACT}  # meets the floor and nothing else
_CORES = {  # capsules along shin and foot that keep the legs apart: ends and radius in m
    "lleg": ((0.0, 0.0, -0.05, 0.02, 0.0, -0.36), 0.07),
    "foot": ((-0.04, 0.0, -0.04, 0.12, 0.0, -0.04), 0.03),
}

Link = dict[str, Any]

_COLOURS = {
    (0.72, 0.74, 0.77, 1.0): ("utorso", "uarm", "ufarm", "uleg"),  # white
    (0.20, 0.22, 0.26, 1.0): ("mtorso", "ltorso", "lfarm", "uglut", "lglut", "talus"),  # dark
    (0.40, 0.44, 0.50, 1.0): ("pelvis", "clav"),  # steel
    (0.16, 0.40, 0.66, 1.0): ("scap", "larm", "lleg"),  # blue
    (0.93, 0.52, 0.15, 1.0): ("head", "hand", "foot"),  # orange
}


def body(ankle_range_rad: float = 0.1) -> MujocoBody:
    """Return Atlas with ankles that turn within +-`ankle_range_rad` about both axes.

    The paper searched over 0.1 and 0.3 (supplement, tab42_h, a); 0.1 was best for SILEM. Raises
    SilemError if the range is not above 0 or exceeds the robot's own.
    """
    joints = constants()["joints"]
    limits = [joints[f"l_leg_{axis}"]["limit"] for axis in _ANKLES]
    widest = min(min(-limit["lower"], limit["upper"]) for limit in limits)
    if not 0 < ankle_range_rad <= widest:
        raise SilemError(
            f"Atlas's ankles within +-{ankle_range_rad} rad; allowed: above 0, up to {widest},"
            " the robot's own limit"
        )
    compiled = robot(ankle_range_rad).compile()
    pose = _standing_pose(compiled, ankle_range_rad)
    head_m = float(placed(compiled, pose).body(SKELETON.head).xpos[2])
    standing_head_m = round(head_m * STANDING_HEAD_M / _HUMANOID_HEAD_M, 3)
    return MujocoBody(
        name="Atlas",
        description=f"Atlas v4 of Boston Dynamics, ankles within +-{ankle_range_rad:g} rad",
        build=functools.partial(model, float(ankle_range_rad)),
        varied=(),
        standing_pose=tuple(pose.tolist()),
        standing_head_m=standing_head_m,
        fall_head_m=round(head_m * FALL_HEAD_M / _HUMANOID_HEAD_M, 3),
        parameters={"ankle_range_rad": ankle_range_rad},
        variants=body,
        **common(compiled, SKELETON, standing_head_m),
    )


def _standing_pose(compiled: mujoco.MjModel, ankle_range_rad: float) -> np.ndarray:
    """Return joint positions (nq,): knees slightly bent, arms hanging, soles flat on the floor."""
    ankle = -min(_ANKLE_RAD, ankle_range_rad / 2)
    legs = {"kny": _KNEE_RAD, "aky": ankle, "hpy": -_KNEE_RAD - ankle}
    angles: dict[str, float] = {}
    for side, sign in (("l", -1), ("r", 1)):
        angles |= {f"{side}_leg_{joint}": angle for joint, angle in legs.items()}
        for joint, angle in _ARM_RAD.items():
            angles[f"{side}_arm_{joint}"] = angle * (sign if joint in _MIRRORED else 1)
        angles[f"{side}_arm_wry"] = _FOREARM_RAD[side]
    pose = compiled.qpos0.copy()
    for name, angle in angles.items():
        pose[compiled.joint(name).qposadr[0]] = angle
    sole = max(constants()["links"]["l_foot"]["collision"], key=_volume_m3)
    ankle_height_m = placed(compiled, pose).body(SKELETON.left_foot).xpos[2]
    pose[2] += sole["size"][2] / 2 - sole["xyz_m"][2] - ankle_height_m
    return pose


@functools.cache
def constants() -> dict[str, Any]:
    """Return the published constants: `links` and `joints`, each by name."""
    return json.loads(_SOURCE.read_text(encoding="utf-8"))


def model(ankle_range_rad: float) -> str:
    """Return the MJCF text of Atlas on a floor, its ankles turning within +-`ankle_range_rad`."""
    spec = robot(ankle_range_rad)
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    spec.worldbody.add_geom(name="floor", type=plane, size=[100, 100, 0.2])
    spec.compile()
    return spec.to_xml()


def robot(ankle_range_rad: float) -> mujoco.MjSpec:
    """Return Atlas alone, its ankles turning within +-`ankle_range_rad` about both axes."""
    spec = mujoco.MjSpec()
    spec.modelname = "atlas"
    spec.compiler.degree = False
    spec.option.timestep = _TIMESTEP_S
    pelvis = spec.worldbody.add_body(name=_ROOT)
    pelvis.add_freejoint(name="root")
    _fill(pelvis, _ROOT, ankle_range_rad)
    for name in (joint.name for joint in spec.joints[1:]):
        spec.add_actuator(
            name=name,
            target=name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            gear=[constants()["joints"][name]["limit"]["effort"], 0, 0, 0, 0, 0],
            ctrlrange=[-1, 1],
        )
    for left, right in itertools.product(_CORES, repeat=2):
        spec.add_pair(geomname1=f"l_{left}_core", geomname2=f"r_{right}_core", condim=1)
    return spec


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
                limit = joint["limit"]
                span = limit["lower"], limit["upper"]
                if joint_name.endswith(_ANKLES):
                    span = -ankle_range_rad, ankle_range_rad
                child.add_joint(
                    name=joint_name,
                    axis=joint["axis"],
                    range=span,
                    damping=limit["effort"] / limit["velocity"],
                    armature=_ARMATURE_KG_M2,
                    solref_limit=_LIMIT_SOLREF,
                )
            _fill(child, joint["child"], ankle_range_rad)


def _add_shapes(body: mujoco.MjsBody, name: str, shapes: list[Link]) -> None:
    """Draw a link's shapes, and let the largest ones, or the corners of a sole, meet the floor."""
    is_foot, part = name.endswith("foot"), name.removeprefix("l_").removeprefix("r_")
    (rgba,) = (colour for colour, parts in _COLOURS.items() if part in parts)
    largest_m3 = max(map(_volume_m3, shapes), default=0.0)
    for shape in shapes:
        kind, size, volume_m3 = _primitive(shape)
        place = {"pos": shape["xyz_m"], "quat": _quaternion(shape["rpy_rad"])}
        contact = _SOLID if volume_m3 == largest_m3 and not is_foot else _BARE
        body.add_geom(type=kind, size=size, rgba=rgba, **place, **contact)
    if is_foot:  # small spheres inside the lower corners of its box, flush with its faces
        box = max(shapes, key=_volume_m3)  # the other one is the narrow tip of its toe
        reach = np.array(box["size"]) / 2 - _SOLE_RADIUS_M
        for index, (x, y) in enumerate(itertools.product((-1, 1), repeat=2)):
            body.add_geom(
                name=f"{name}_sole_{index}",
                type=mujoco.mjtGeom.mjGEOM_SPHERE,
                size=[_SOLE_RADIUS_M, 0, 0],
                pos=np.array(box["xyz_m"]) + reach * (x, y, -1),
                rgba=rgba,
                **_SOLID,
            )
    if part in _CORES:
        ends, radius = _CORES[part]
        body.add_geom(
            name=f"{name}_core",
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=ends,
            size=[radius, 0, 0],
            group=4,  # which pictures leave out
            **_BARE,
        )


def _primitive(shape: Link) -> tuple[mujoco.mjtGeom, list[float], float]:
    """Return MuJoCo's type and sizes of a published shape, and its volume in m3."""
    kind, name = mujoco.mjtGeom, shape["shape"]
    if name == "box":
        return kind.mjGEOM_BOX, [side / 2 for side in shape["size"]], math.prod(shape["size"])
    radius_m, length_m = shape["radius"], shape.get("length", 0.0)
    disc_m2 = math.pi * radius_m**2
    if name == "cylinder":
        return kind.mjGEOM_CYLINDER, [radius_m, length_m / 2, 0], disc_m2 * length_m
    return kind.mjGEOM_SPHERE, [radius_m, 0, 0], disc_m2 * 4 / 3 * radius_m


def _volume_m3(shape: Link) -> float:
    return _primitive(shape)[2]


def _quaternion(rpy_rad: list[float]) -> np.ndarray:
    """Return the quaternion (4,) of a URDF's roll, pitch and yaw, about fixed axes."""
    quaternion = np.empty(4)
    mujoco.mju_euler2Quat(quaternion, np.array(rpy_rad), "XYZ")
    return quaternion
