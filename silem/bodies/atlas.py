"""Atlas, Boston Dynamics' robot (v4), with an adjustable ankle.

Left is +y and forward +x in every upright link, as in the features. The landmarks are the origins
of links, which are joints: `utorso` is the torso (its frame is upright and faces forward when the
robot does), the head is the neck's joint, a shoulder the joint that raises the arm sideways, a
hand the wrist, a foot the ankle.

The paper gives 0.99 and 0.91 as the distances of Atlas's feet and hands from its torso; here they
are 1.08 and 0.98 in the zero pose, arms spread, and 1.08 and 0.62 when it stands. No link of v4's
trunk gives the paper's pair: from `pelvis` 0.87 and 1.04, from `mtorso` 1.03 and 0.99. The paper
does not say which model of Atlas it used, nor in which pose it measured.

"Ankle's range of motion" is read as both axes of both ankles, pitch and roll: the paper gives one
number, and a stiff ankle lets the weak motors (92 and 45 N m against a weight of 1790 N) keep the
foot flat.
"""

from __future__ import annotations

import itertools
from functools import partial

import mujoco
import numpy as np

from silem.bodies import atlas_model
from silem.bodies.body import Motor, MujocoBody, Skeleton
from silem.bodies.humanoid import FALL_HEAD_M, STANDING_HEAD_M
from silem.util.errors import SilemError

SKELETON = Skeleton(
    torso="utorso",
    head="head",
    left_shoulder="l_scap",
    left_elbow="l_larm",
    left_hand="l_hand",
    right_shoulder="r_scap",
    right_elbow="r_larm",
    right_hand="r_hand",
    left_hip="l_uleg",
    left_knee="l_lleg",
    left_foot="l_foot",
    right_hip="r_uleg",
    right_knee="r_lleg",
    right_foot="r_foot",
)

_HUMANOID_HEAD_M = 1.4755  # dm_control's humanoid in its zero pose, soles on the floor

_ARM_RAD = {"shx": 1.35, "ely": np.pi / 2, "elx": -0.3}  # hanging, elbows bent forward a little
_MIRRORED = ("shx", "elx")  # whose sign differs between left and right
_FOREARM_RAD = {"l": np.pi, "r": 0.0}  # one forearm is mounted turned by pi about its own axis
_KNEE_RAD = 0.1
_ANKLE_RAD = 0.05  # enough to bring the centre of mass over the soles


def body(ankle_range_rad: float = 0.1) -> MujocoBody:
    """Return Atlas with ankles that turn within +-`ankle_range_rad` about both axes.

    The paper searched over 0.1 and 0.3 (supplement, tab42_h, a); 0.1 was best for SILEM.

    Raises:
        SilemError: If the range is not above 0 or exceeds the robot's own.
    """
    widest = widest_ankle_range_rad()
    if not 0 < ankle_range_rad <= widest:
        raise SilemError(
            f"Atlas's ankles within +-{ankle_range_rad} rad; allowed: above 0, up to {widest},"
            " the robot's own limit"
        )
    compiled = atlas_model.robot(ankle_range_rad).compile()
    pose = _standing_pose(compiled, ankle_range_rad)
    head_m = _place(compiled, pose).body(SKELETON.head).xpos[2]
    return MujocoBody(
        name="Atlas",
        family="humanoid",
        description=f"Atlas v4 of Boston Dynamics, ankles within +-{ankle_range_rad:g} rad",
        build=partial(atlas_model.model, float(ankle_range_rad)),
        motors=tuple(
            Motor(name, float(compiled.actuator(name).gear[0])) for name in atlas_model.hinges()
        ),
        length=("length of the right arm", _arm_length_m(compiled)),
        varied=(),
        skeleton=SKELETON,
        standing_pose=tuple(pose.tolist()),
        standing_head_m=round(float(head_m) * STANDING_HEAD_M / _HUMANOID_HEAD_M, 3),
        fall_head_m=round(float(head_m) * FALL_HEAD_M / _HUMANOID_HEAD_M, 3),
    )


def widest_ankle_range_rad() -> float:
    """Return the largest +-a that lies within the robot's own limits of both ankle axes."""
    joints = atlas_model.constants()["joints"]
    limits = [joints[f"l_leg_{axis}"]["limit"] for axis in atlas_model.ANKLES]
    return float(min(min(-limit["lower"], limit["upper"]) for limit in limits))


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
    ankle_height_m = _place(compiled, pose).body(SKELETON.left_foot).xpos[2]
    pose[2] -= ankle_height_m - atlas_model.sole_depth_m()
    return pose


def _place(compiled: mujoco.MjModel, qpos: np.ndarray) -> mujoco.MjData:
    data = mujoco.MjData(compiled)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(compiled, data)
    return data


def _arm_length_m(compiled: mujoco.MjModel) -> float:
    data = _place(compiled, compiled.qpos0)
    arm = (SKELETON.right_shoulder, SKELETON.right_elbow, SKELETON.right_hand)
    points = [data.body(link).xpos for link in arm]
    return round(float(sum(np.linalg.norm(b - a) for a, b in itertools.pairwise(points))), 6)


BODIES = (body(),)
