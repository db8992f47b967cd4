"""Atlas, Boston Dynamics' robot (v4), with an adjustable ankle.

Left is +y and forward +x in every upright link. The landmarks are the origins of links, which are
joints: `utorso` is the torso, the head is the neck's joint, a shoulder the joint that raises the
arm sideways, a hand the wrist, a foot the ankle. "Ankle's range of motion" is read as pitch and
roll of both: the paper gives one number, and a stiff ankle lets weak motors keep the foot flat.

The model is `silem/bodies/atlas.xml`. Its masses, inertias, axes, limits, efforts and shapes are
Atlas v4's (unplugged) as published in the open robot description shipped with OpenAI Roboschool
(MIT licence). What a simulation needs beside them, and what the paper leaves open, is on the page
"Deviations":

- **Motors.** Torque at action 1 is the joint's published effort. Per weight and leg length that is
  what dm_control's humanoid has in ankles and shoulders, and 1.6 to 3 times that in hips and knees.
- **Damping.** Effort over velocity limit: the straight torque-speed line of a motor. With the
  published 0.1 N m s/rad random torques make the model explode at this timestep.
- **Armature.** 0.05 kg m2 for all joints: the ankle's talus alone has 1e-5 kg m2.
- **Limits** are as stiff as the timestep allows, so that the ankle's range means something.
- **Contacts** are dm_control's. Each link meets the floor with its largest shape, a foot with
  spheres in the four corners of its sole; of self-collision only feet and shins of one leg with
  those of the other are on, by capsules along them, which pictures leave out.
- **Welds.** `*_arm_wry2`, published with +-0.001 rad, has neither joint nor motor: 28 of 30 remain.
"""

import functools
from pathlib import Path

import mujoco
import numpy as np

from silem.bodies.body import MujocoBody, Skeleton, edited
from silem.bodies.humanoid import FALL_HEAD_M, STANDING_HEAD_M, common, on_floor, placed
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

_ANKLES = ("l_leg_aky", "l_leg_akx", "r_leg_aky", "r_leg_akx")  # pitch and roll
_WIDEST_RAD = 0.7  # the robot's own limit


def body(ankle_range_rad: float = 0.1) -> MujocoBody:
    """Return Atlas with ankles that turn within +-`ankle_range_rad` about both axes.

    The paper searched over 0.1 and 0.3 (supplement, tab42_h, a); 0.1 was best for SILEM. Raises
    SilemError if the range is not above 0 or exceeds the robot's own.
    """
    if not 0 < ankle_range_rad <= _WIDEST_RAD:
        raise SilemError(
            f"Atlas's ankles within +-{ankle_range_rad} rad; allowed: above 0, up to {_WIDEST_RAD},"
            " the robot's own limit"
        )
    build = functools.partial(model, float(ankle_range_rad))
    compiled = mujoco.MjModel.from_xml_string(build())
    pose = _standing_pose(compiled, ankle_range_rad)
    head_m = float(placed(compiled, pose).body(SKELETON.head).xpos[2])
    standing_head_m = round(head_m * STANDING_HEAD_M / _HUMANOID_HEAD_M, 3)
    return MujocoBody(
        name="Atlas",
        description=f"Atlas v4 of Boston Dynamics, ankles within +-{ankle_range_rad:g} rad",
        build=build,
        varied=(),
        standing_pose=tuple(pose.tolist()),
        standing_head_m=standing_head_m,
        fall_head_m=round(head_m * FALL_HEAD_M / _HUMANOID_HEAD_M, 3),
        parameters={"ankle_range_rad": ankle_range_rad},
        variants=body,
        **common(compiled, SKELETON, standing_head_m),
    )


def model(ankle_range_rad: float) -> str:
    """Return the MJCF text of Atlas on a floor, its ankles turning within +-`ankle_range_rad`."""
    text = Path(__file__).with_name("atlas.xml").read_text(encoding="utf-8")
    span = (-ankle_range_rad, ankle_range_rad)
    return edited(text, {("joint", name, "range"): span for name in _ANKLES})


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
    return on_floor(compiled, pose)
