"""The family of humanoids: dm_control's Humanoid, HumanoidR with unequal arms, and Atlas.

HumanoidR has a long right and a short left arm. Atlas has a module of its own.
"""

import itertools
import math
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from functools import partial
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from silem.bodies.body import Motor, MujocoBody, Skeleton, View, numbers
from silem.util.errors import SilemError

if TYPE_CHECKING:
    import mujoco

FAMILY = "humanoid"

ARM_FACTORS = {"left": 0.5, "right": 1.5}
"""HumanoidR's arm lengths as multiples of Humanoid's. The paper says "elongating Humanoid's right
arm and shortening its left arm" and gives no factor."""

STANDING_HEAD_M = 1.4  # of dm_control's reward
FALL_HEAD_M = 1.0  # of merel-mocap-gail, the code that the paper started from
DEMONSTRATOR_SPEED_M_S = 1.6  #: mean speed of the man in clip 08_01: 3.679 m in 2.30 s
UNSCALED = {"left": 1.0, "right": 1.0}

_ARM_LINKS = ("upper_arm", "lower_arm", "hand")
_LIMBS = (*_ARM_LINKS, "thigh", "shin", "foot")
_POINTS = ("shoulder", "elbow", "hand", "hip", "knee", "foot")
SKELETON = Skeleton.of_sides(
    "torso", "head", "left_", "right_", **dict(zip(_POINTS, _LIMBS, strict=True))
)
_AZIMUTH_RAD, _ELEVATION_RAD = math.radians(125), math.radians(-12)  # from the front left
_SKY = "texture[@type='skybox']"


def model(left_arm: float = 1.0, right_arm: float = 1.0) -> str:
    """Return the MJCF text of dm_control's humanoid with scaled arms.

    Lengths along an arm are scaled, radii are not; masses and inertias follow from the density.
    Sensors are left out: nothing reads them, and their sites would have to be scaled too. So is the
    sky, which takes nine tenths of the time to compile.
    """
    root = _read("humanoid.xml")
    for index, child in reversed(list(enumerate(root))):
        if child.tag == "include":
            root[index : index + 1] = list(_read(child.attrib["file"]))
    for parents, what in ((".//body", "site"), (".", "sensor"), ("asset", _SKY)):
        for parent in root.findall(parents):
            for found in parent.findall(what):
                parent.remove(found)
    for side, factor in (("left", left_arm), ("right", right_arm)):
        if factor <= 0:
            raise SilemError(f"{side} arm scaled by {factor}; allowed: factors above 0")
        if factor != 1.0:
            _scale_arm(root, side, factor)
    return ElementTree.tostring(root, encoding="unicode")


def body(name: str, description: str, arms: dict[str, float]) -> MujocoBody:
    """Return the registry entry of a humanoid, with factors on its "left" and "right" arm."""
    import mujoco

    build = partial(model, arms["left"], arms["right"])
    compiled = mujoco.MjModel.from_xml_string(build())
    scaled = [side for side, factor in arms.items() if factor != 1.0]
    pose = on_floor(compiled, compiled.qpos0)
    return MujocoBody(
        name=name,
        description=description,
        build=build,
        varied=tuple(f"{side}_{link}" for side in scaled for link in _ARM_LINKS),
        standing_pose=tuple(pose.tolist()),
        standing_head_m=STANDING_HEAD_M,
        fall_head_m=FALL_HEAD_M,
        **common(compiled, SKELETON, STANDING_HEAD_M),
    )


def one_arm(name: str, factor: float) -> MujocoBody:
    """Return a humanoid whose right arm is so many times as long."""
    about = f"Humanoid with its right arm {factor:g} times as long"
    return body(name, about, UNSCALED | {"right": factor})


def arms(name: str, low: float, high: float) -> MujocoBody:
    """Return a humanoid whose right arm has another length in each of E environments.

    The factors are the middles of E equal parts of the range: of a single environment, its middle.
    """
    if not 0 < low < high:
        raise SilemError(f"{name}: the arm's factors go from {low:g} up to {high:g}")

    def each(n: int) -> list[MujocoBody]:
        factors = [low + (i + 0.5) * (high - low) / n for i in range(n)]
        return [one_arm(f"{name}-{factor:.4g}", factor) for factor in factors]

    about = f"Humanoid with its right arm {low:g} to {high:g} times as long, by environment"
    return replace(one_arm(name, (low + high) / 2), description=about, each=each)


NAMED = {"Humanoid-arm-#": one_arm, "Humanoid-arm-#-#": arms}
"""Bodies that are named by numbers in the place of #: factors on the right arm."""


def placed(compiled: "mujoco.MjModel", qpos: np.ndarray) -> "mujoco.MjData":
    """Return a model's data in a pose."""
    import mujoco

    data = mujoco.MjData(compiled)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(compiled, data)
    return data


def on_floor(compiled: "mujoco.MjModel", qpos: np.ndarray) -> np.ndarray:
    """Return a pose lowered or lifted until the feet's capsules or spheres touch the floor."""
    data, pose = placed(compiled, qpos), qpos.copy()
    of_feet = [compiled.body(index).name.endswith("_foot") for index in compiled.geom_bodyid]
    feet = compiled.geom_contype.astype(bool) & of_feet
    radius, half_length = compiled.geom_size[feet, :2].T
    lowest = data.geom_xpos[feet, 2] - abs(data.geom_xmat[feet, 8]) * half_length - radius
    pose[2] -= lowest.min()
    return pose


def common(
    compiled: "mujoco.MjModel", skeleton: Skeleton, standing_head_m: float
) -> dict[str, Any]:
    """Return what is the same for all humanoids, or found in the same way in their models."""
    across = math.cos(_ELEVATION_RAD)
    direction = (across * math.cos(_AZIMUTH_RAD), across * math.sin(_AZIMUTH_RAD))
    joints = [compiled.joint(index).name for index in compiled.actuator_trnid[:, 0]]
    data = placed(compiled, compiled.qpos0)
    arm = (skeleton.right_shoulder, skeleton.right_elbow, skeleton.right_hand)
    points = [data.body(link).xpos for link in arm]
    length_m = sum(float(np.linalg.norm(b - a)) for a, b in itertools.pairwise(points))
    return {
        "family": FAMILY,
        "motors": tuple(map(Motor, joints, compiled.actuator_gear[:, 0].tolist())),
        "length": ("length of the right arm", round(length_m, 6)),
        "skeleton": skeleton,
        "target_speed_m_s": DEMONSTRATOR_SPEED_M_S,
        "view": View(
            direction=(*direction, math.sin(_ELEVATION_RAD)),
            look_at_m=0.55 * standing_head_m,
            span_m=4.2 * math.tan(math.pi / 8) * standing_head_m,  # from 2.1 of its heights
        ),
    }


def _read(name: str) -> ElementTree.Element:
    """Return one of the suite's files, read without loading every task of it."""
    path = files("dm_control") / "suite" / name
    return ElementTree.fromstring(path.read_text(encoding="utf-8"))


def _scale_arm(root: ElementTree.Element, side: str, factor: float) -> None:
    """Scale an arm from the shoulder on."""
    for name in _ARM_LINKS:
        (link,) = root.findall(f".//body[@name='{side}_{name}']")
        scaled = [(geom, "fromto") for geom in link.findall("geom[@fromto]")]
        if name != "upper_arm":  # whose place is the shoulder
            scaled.append((link, "pos"))
        for element, attribute in scaled:
            values = [float(value) * factor for value in element.attrib[attribute].split()]
            element.set(attribute, numbers(*values))


def _atlas() -> MujocoBody:
    from silem.bodies import atlas  # which needs MuJoCo

    return atlas.body()


BODIES = {
    "Humanoid": partial(body, "Humanoid", "dm_control's humanoid", UNSCALED),
    "HumanoidR": partial(
        body, "HumanoidR", "Humanoid with a longer right and a shorter left arm", ARM_FACTORS
    ),
    "Atlas": _atlas,
}
