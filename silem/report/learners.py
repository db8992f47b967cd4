"""The humanoids in numbers: lengths and masses, the motors' strength, how soon they fall."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import pandas as pd

from silem import paper
from silem.bodies import MujocoBody, describe
from silem.bodies.body import MAX_STEPS
from silem.envs.mujoco.simulator import body_of
from silem.motion.features import POINTS, Landmarks
from silem.motion.retargeting import Limbs
from silem.report.pages import humanoids
from silem.study.evaluate import RandomPolicy, evaluate

_ALIKE = {  # joints of Humanoid and of Atlas that do the same
    "hip, forward and back": ("right_hip_y", "r_leg_hpy"),
    "hip, sideways": ("right_hip_x", "r_leg_hpx"),
    "hip, turning": ("right_hip_z", "r_leg_hpz"),
    "knee": ("right_knee", "r_leg_kny"),
    "ankle, pitch": ("right_ankle_y", "r_leg_aky"),
    "ankle, roll": ("right_ankle_x", "r_leg_akx"),
    "waist, forward and back": ("abdomen_y", "back_bky"),
    "waist, sideways": ("abdomen_x", "back_bkx"),
    "waist, turning": ("abdomen_z", "back_bkz"),
    "shoulder, first": ("right_shoulder1", "r_arm_shz"),
    "shoulder, second": ("right_shoulder2", "r_arm_shx"),
    "elbow, bending": ("right_elbow", "r_arm_elx"),
}
_PRINTED = (humanoids.DEMONSTRATOR, "Humanoid", "Atlas")  # the paper's distances, in its order
_GRAVITY_M_S2 = 9.81
_TRUNK = ("pelvis", "ltorso", "mtorso", "utorso")  # of Atlas, from below


def overview(names: Sequence[str]) -> pd.DataFrame:
    """Return what humanoids measure, a row each: mass in kg, lengths and heights in m."""
    rows = {}
    for name in names:
        body = body_of(name)
        lengths = leg_and_arms(body)
        rows[name] = {
            "mass (kg)": describe(name)["total_mass_kg"],
            "head (m)": standing_head_m(body),
            "leg (m)": lengths.leg,
            "left arm (m)": lengths.left_arm,
            "right arm (m)": lengths.right_arm,
            "hips to torso (m)": lengths.spine,
            "motors": body.action_size,
        }
    return pd.DataFrame(rows).T.astype({"motors": int}).rename_axis("body")


def leg_and_arms(body: MujocoBody) -> Limbs:
    """Return the lengths of a humanoid's limbs."""
    data, landmarks = _posed(body)
    return Limbs.of(landmarks.points(data))


def standing_head_m(body: MujocoBody) -> float:
    """Return the height of a humanoid's head in its standing pose."""
    data, landmarks = _posed(body, body.standing_pose)
    return float(landmarks.points(data)[POINTS.index("head"), 2])


def standing_distance_m(name: str, landmark: str) -> float:
    """Return how far a landmark is from the torso when a humanoid stands."""
    body = body_of(name)
    data, landmarks = _posed(body, body.standing_pose)
    points = landmarks.points(data)
    return float(np.linalg.norm(points[POINTS.index(landmark)] - points[POINTS.index("torso")]))


def _posed(
    body: MujocoBody, qpos: Sequence[float] | None = None
) -> tuple[mujoco.MjData, Landmarks]:
    """Put a humanoid into a pose; None means all joints at zero."""
    model = mujoco.MjModel.from_xml_string(body.model_xml())
    data = mujoco.MjData(model)
    if qpos is not None:
        data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    return data, Landmarks(model, body.skeleton)


def arms(first: str, second: str) -> pd.DataFrame:
    """Compare two humanoids' links that differ in mass: their masses in kg, a row per link."""
    masses = pd.DataFrame({name: describe(name)["masses_kg"] for name in (first, second)})
    return masses[masses[first] != masses[second]].rename_axis("mass (kg)")


def strength() -> pd.DataFrame:
    """Compare the motors of Humanoid and Atlas, joint by joint.

    Returns:
        Torque at action 1 in N m, then the same over the body's weight times the length of its
        leg, in per cent.
    """
    torques, scales = {}, {}
    for name in ("Humanoid", "Atlas"):
        body, facts = body_of(name), describe(name)
        torques[name] = facts["actuators"]
        scales[name] = facts["total_mass_kg"] * _GRAVITY_M_S2 * leg_and_arms(body).leg
    rows: dict[str, dict[str, Any]] = {}
    for what, joints in _ALIKE.items():
        found = {name: torques[name][joint] for name, joint in zip(torques, joints, strict=True)}
        rows[what] = {f"{name} (N m)": round(value) for name, value in found.items()}
        rows[what] |= {f"{n} (%)": 100 * value / scales[n] for n, value in found.items()}
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("joint")


def trunk_distances() -> pd.DataFrame:
    """Return how far Atlas's feet and hands are from each part of its trunk, joints at zero, m."""
    body = body_of("Atlas")
    data, _ = _posed(body)
    ends = {"feet (m)": body.skeleton.left_foot, "hands (m)": body.skeleton.left_hand}
    rows = {
        part: {
            label: float(np.linalg.norm(data.body(end).xpos - data.body(part).xpos))
            for label, end in ends.items()
        }
        for part in _TRUNK
    }
    return pd.DataFrame(rows).T.rename_axis("from")


def gaps() -> dict[str, float]:
    """Return by how much learners' limb distances differ from the demonstrator's, in m.

    Returns:
        ``paper_feet_Humanoid``, ``our_hand_Atlas`` and so on, by the paper's numbers and by ours.
    """
    found = humanoids.limb_distances()
    differences = {}
    for part, limb in (("feet", "foot"), ("hand", "hand")):
        ours = [
            np.mean([found[name][f"{side}_{limb}"] for side in ("left", "right")])
            for name in _PRINTED
        ]
        for whose, distances in (("paper", paper.number(f"{part}_distances")), ("our", ours)):
            for name, distance in zip(_PRINTED[1:], distances[1:], strict=True):
                differences[f"{whose}_{part}_{name}"] = abs(float(distance - distances[0]))
    return differences


def falls(names: Sequence[str], n_episodes: int, seed: int) -> pd.DataFrame:
    """Return how long humanoids stand without a policy, and what it earns: means over episodes.

    Args:
        names: The humanoids.
        n_episodes: Episodes of each, without torques and with random ones.
        seed: Seed of the start states and of the random torques.
    """
    rows = {}
    for name in names:
        body = body_of(name)
        row = {}
        for label, std in (("no torques", 0.0), ("random torques", 1.0)):
            found = evaluate(RandomPolicy(body, std=std), name, n_episodes, seed)
            row[f"{label}: seconds"] = (found.upright or 0.0) * MAX_STEPS * body.control_step_s
            row[f"{label}: return"] = found.return_mean
        rows[name] = row
    return pd.DataFrame(rows).T.rename_axis("body")


def heights(names: Sequence[str]) -> pd.DataFrame:
    """Return the heights of the head in m that the walking task goes by, a row per body."""
    rows = {}
    for name in names:
        body = body_of(name)
        rows[name] = {
            "standing pose": standing_head_m(body),
            "counts as standing from": body.standing_head_m,
            "episode ends below": body.fall_head_m,
        }
    return pd.DataFrame(rows).T.rename_axis("height of the head (m)")
