"""Atlas: its constants are the published ones, its ankle is adjustable, and it can stand."""

from __future__ import annotations

import json
import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from silem.bodies import MujocoBody, atlas
from silem.motion.features import FEATURES, POINTS, Landmarks, skeletal_features
from silem.motion.kinematics import observe
from silem.util.errors import SilemError

# the published constants, by name of link and joint: what the model's text has to hold
PUBLISHED = json.loads((Path(__file__).parents[1] / "data" / "atlas_v4.json").read_text())
WEIGHT_N = 182.42 * 9.81
ANKLES = {f"{side}_leg_{axis}" for side in "lr" for axis in ("aky", "akx")}
STANDING_GAIN = 20.0  # share of the effort per rad that keeps the robot on its feet


@pytest.fixture(scope="module")
def body() -> MujocoBody:
    return atlas.body()


@pytest.fixture(scope="module")
def model(body: MujocoBody) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(body.model_xml())


def placed(model: mujoco.MjModel, qpos: np.ndarray | tuple[float, ...]) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    return data


def angle(model: mujoco.MjModel, data: mujoco.MjData, joint: str) -> float:
    return float(data.qpos[model.joint(joint).qposadr[0]])


def features(model: mujoco.MjModel, data: mujoco.MjData) -> dict[str, float]:
    seen = observe(model, atlas.SKELETON, data.qpos[None], data.qvel[None])
    (values,) = skeletal_features(*seen).tolist()
    return dict(zip((feature.name for feature in FEATURES), values, strict=True))


def head_after(
    body: MujocoBody, model: mujoco.MjModel, seconds: float, gain: float
) -> tuple[float, mujoco.MjData]:
    """Return the head's height after holding the standing pose with a spring on each joint."""
    data, pose = placed(model, body.standing_pose), np.array(body.standing_pose[7:])
    for _ in range(round(seconds / model.opt.timestep)):
        data.ctrl[:] = np.clip(gain * (pose - data.qpos[7:]), -1, 1)
        mujoco.mj_step(model, data)
    return float(data.body("head").xpos[2]), data


def test_masses_and_inertias_are_the_published_ones(model: mujoco.MjModel):
    assert model.body_mass.sum() == pytest.approx(182.42, abs=0.01)
    links = PUBLISHED["links"]
    assert len(links) == model.nbody - 1 == 31
    for name, link in links.items():
        body = model.body(name)
        assert body.mass[0] == pytest.approx(link["mass_kg"], rel=1e-5)
        np.testing.assert_allclose(body.ipos, link["com_m"], atol=1e-6)
        axes = np.empty(9)
        mujoco.mju_quat2Mat(axes, body.iquat)
        axes = axes.reshape(3, 3)
        tensor = axes @ np.diag(body.inertia) @ axes.T
        given = link["inertia_kgm2"]
        expected = [given[key] for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")]
        found = tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        np.testing.assert_allclose(found, expected, atol=1e-5 * max(expected))


def test_joints_are_the_published_ones_but_for_ankles_and_welded_wrists(
    body: MujocoBody, model: mujoco.MjModel
):
    published = PUBLISHED["joints"]
    names = [model.joint(index).name for index in range(1, model.njnt)]
    assert set(published) - set(names) == {"l_arm_wry2", "r_arm_wry2"}
    assert [motor.joint for motor in body.motors] == names
    for name, motor in zip(names, body.motors, strict=True):
        joint, limit = model.joint(name), published[name]["limit"]
        np.testing.assert_allclose(joint.axis, published[name]["axis"], atol=1e-9)
        if name not in ANKLES:
            np.testing.assert_allclose(joint.range, (limit["lower"], limit["upper"]), rtol=1e-5)
        assert motor.torque_n_m == model.actuator(name).gear[0] == limit["effort"]
        assert model.actuator(name).ctrlrange.tolist() == [-1, 1]
        assert joint.damping[0] == pytest.approx(limit["effort"] / limit["velocity"], rel=1e-5)


def test_the_control_step_is_five_substeps(body: MujocoBody, model: mujoco.MjModel):
    assert model.opt.timestep * body.n_substeps == pytest.approx(body.control_step_s)
    assert body.control_step_s == 0.025


def test_the_same_text_every_time(body: MujocoBody):
    assert body.model_xml() == atlas.body().model_xml()


@pytest.mark.parametrize("ankle_range_rad", [0.1, 0.3])
def test_the_ankles_range_holds_against_full_torque(ankle_range_rad: float):
    spec = mujoco.MjSpec.from_string(atlas.model(ankle_range_rad))
    spec.delete(spec.geom("floor"))
    model = spec.compile()
    model.opt.gravity[:] = 0
    data = placed(model, atlas.body(ankle_range_rad).standing_pose)
    for sign in (1, -1):
        for name in ANKLES:
            data.ctrl[model.actuator(name).id] = sign
        for _ in range(300):
            mujoco.mj_step(model, data)
        for name in ANKLES:
            assert angle(model, data, name) == pytest.approx(sign * ankle_range_rad, abs=0.02)


def test_the_ankles_range_changes_nothing_else(model: mujoco.MjModel):
    wide = mujoco.MjModel.from_xml_string(atlas.body(0.3).model_xml())
    ankles = [model.joint(name).id for name in ANKLES]
    np.testing.assert_allclose(np.abs(model.jnt_range[ankles]), 0.1)
    np.testing.assert_allclose(np.abs(wide.jnt_range[ankles]), 0.3)
    others = np.setdiff1d(np.arange(model.njnt), ankles)
    np.testing.assert_array_equal(model.jnt_range[others], wide.jnt_range[others])
    assert atlas.body(0.1).standing_pose == atlas.body(0.3).standing_pose


@pytest.mark.parametrize("ankle_range_rad", [0.0, -0.1, 0.71, float("nan")])
def test_impossible_ankles_are_refused(ankle_range_rad: float):
    with pytest.raises(SilemError, match=r"allowed: above 0, up to 0\.7"):
        atlas.body(ankle_range_rad)


@pytest.mark.parametrize("ankle_range_rad", [0.02, 0.1, 0.7])
def test_standing_pose_has_flat_soles_on_the_floor_and_respects_limits(ankle_range_rad: float):
    model = mujoco.MjModel.from_xml_string(atlas.model(ankle_range_rad))
    data = placed(model, atlas.body(ankle_range_rad).standing_pose)
    soles = [geom for geom in range(model.ngeom) if "_sole_" in model.geom(geom).name]
    lowest = data.geom_xpos[soles, 2] - model.geom_size[soles, 0]
    assert len(soles) == 8
    np.testing.assert_allclose(lowest, 0, atol=1e-3)
    assert np.all(data.qpos[7:] >= model.jnt_range[1:, 0] - 1e-5)
    assert np.all(data.qpos[7:] <= model.jnt_range[1:, 1] + 1e-5)
    over = data.subtree_com[1, :2] - data.geom_xpos[soles, :2].mean(axis=0)
    assert np.abs(over).max() < 0.06  # of 0.23 by 0.36 m of support
    np.testing.assert_allclose(data.body("utorso").xmat.reshape(3, 3), np.eye(3), atol=1e-9)


def test_stands_when_held_and_falls_when_not(body: MujocoBody, model: mujoco.MjModel):
    start = placed(model, body.standing_pose).body("head").xpos[2]
    height, data = head_after(body, model, 2.0, STANDING_GAIN)
    assert height == pytest.approx(start, abs=0.03) and height > body.standing_head_m
    force = np.zeros(6)
    pressed = 0.0
    for contact in range(data.ncon):
        mujoco.mj_contactForce(model, data, contact, force)
        pressed += force[0]
    assert pressed == pytest.approx(WEIGHT_N, rel=0.05)
    assert head_after(body, model, 2.0, 0.0)[0] < body.fall_head_m


@pytest.mark.parametrize("start", ["standing", "dropped"])
def test_full_random_torques_leave_the_physics_sane(
    body: MujocoBody, model: mujoco.MjModel, rng: np.random.Generator, start: str
):
    data = placed(model, body.standing_pose)
    if start == "dropped":
        data.qpos[2] = 1.8
        data.qpos[3:7] = rng.normal(size=4)
    for _ in range(400):
        data.ctrl[:] = rng.choice([-1.0, 1.0], model.nu)
        mujoco.mj_step(model, data, nstep=body.n_substeps)
        assert np.abs(data.qvel[6:]).max() < 60  # rad/s; motors alone reach 12
    assert data.warning.number.sum() == 0
    assert data.time == pytest.approx(400 * body.control_step_s)


def test_legs_do_not_pass_through_each_other(body: MujocoBody, model: mujoco.MjModel):
    assert len(placed(model, body.standing_pose).contact.dist) == 0  # the soles just touch
    pose = np.array(body.standing_pose)
    for joint, angle_rad in (("l_leg_hpx", -0.25), ("r_leg_hpx", 0.25)):
        pose[model.joint(joint).qposadr[0]] = angle_rad
    pose[2] += 1
    contacts = placed(model, pose).contact.geom
    touching = {frozenset(model.geom(geom).name for geom in pair) for pair in contacts}
    assert frozenset({"l_lleg_core", "r_lleg_core"}) in touching


def test_heights_are_the_humanoids_fractions_of_the_head(body: MujocoBody, model: mujoco.MjModel):
    head = placed(model, body.standing_pose).body("head").xpos[2]
    assert head == pytest.approx(1.771, abs=0.002)
    assert body.standing_head_m / head == pytest.approx(1.4 / 1.4755, abs=1e-3)
    assert body.fall_head_m / head == pytest.approx(1.0 / 1.4755, abs=1e-3)


def test_distances_from_the_torso_beside_the_papers(body: MujocoBody, model: mujoco.MjModel):
    """The paper: feet 0.99, hands 0.91; the module's docstring has the reason."""
    data = placed(model, model.qpos0)

    def distance(link: str, torso: str = "utorso") -> float:
        return float(np.linalg.norm(data.body(link).xpos - data.body(torso).xpos))

    assert distance("l_foot") == pytest.approx(distance("r_foot")) == pytest.approx(1.08, abs=5e-3)
    assert distance("l_hand") == pytest.approx(0.98, abs=5e-3)
    assert distance("l_hand", "pelvis") == pytest.approx(1.04, abs=5e-3)
    assert distance("l_hand", "mtorso") == pytest.approx(0.99, abs=5e-3)
    assert distance("l_foot", "pelvis") == pytest.approx(0.87, abs=5e-3)
    assert distance("l_foot", "mtorso") == pytest.approx(1.03, abs=5e-3)
    data = placed(model, body.standing_pose)
    assert distance("l_foot") == pytest.approx(1.08, abs=5e-3)
    assert distance("l_hand") == pytest.approx(0.62, abs=5e-3)


def test_left_is_y_and_both_sides_mirror_each_other(
    body: MujocoBody, model: mujoco.MjModel, rng: np.random.Generator
):
    """Any pose and its mirror image; the forearms' own turn stays, whose ranges do not mirror."""
    pose, mirrored = np.array(body.standing_pose), np.array(body.standing_pose)
    for name in (motor.joint for motor in body.motors):
        if "_arm_wry" in name:
            continue
        here, twin = (model.joint(n).qposadr[0] for n in (name, _twin(name)))
        low, high = model.joint(name).range
        pose[here] = rng.uniform(low, high)
        mirrored[twin] = pose[here] * (1 if name.endswith(("y", "ry")) else -1)
    ids = Landmarks(model, atlas.SKELETON).ids
    points, reflected = (placed(model, qpos).xpos[ids] for qpos in (pose, mirrored))
    swap = [POINTS.index(_other_side(point)) for point in POINTS]
    np.testing.assert_allclose(reflected[swap] * (1, -1, 1), points, atol=1e-5)
    left = points[POINTS.index("left_hip"), 1] - points[POINTS.index("right_hip"), 1]
    assert left > 0.1


def test_links_of_both_sides_weigh_and_collide_alike(body: MujocoBody, model: mujoco.MjModel):
    data = placed(model, body.standing_pose)
    flip = np.diag([1.0, -1.0, 1.0])
    for name in (n for n in PUBLISHED["links"] if n.startswith("l_")):
        left, right = (data.body(n).id for n in (name, _twin(name)))
        np.testing.assert_allclose(data.xipos[left] @ flip, data.xipos[right], atol=1e-5)
        tensors = []
        for link in (left, right):
            axes = data.ximat[link].reshape(3, 3)
            tensors.append(axes @ np.diag(model.body_inertia[link]) @ axes.T)
        np.testing.assert_allclose(flip @ tensors[0] @ flip, tensors[1], atol=1e-5)
    solid = np.flatnonzero(model.geom_contype * (model.geom_bodyid > 0))
    centers = data.geom_xpos[solid]
    for center in centers @ flip:
        assert np.linalg.norm(centers - center, axis=1).min() < 0.012


def test_features_of_the_standing_pose_by_hand(body: MujocoBody, model: mujoco.MjModel):
    data = placed(model, body.standing_pose)
    data.qvel[:2] = 1.5, -0.5
    mujoco.mj_forward(model, data)
    found = features(model, data)
    # hip below the torso, thigh turned by -0.05 rad, shin by +0.05
    hip = np.array([0.0125 + 0.05, -0.066 - 0.162 - 0.05])
    thigh, shin = _pitched(-0.05, 0.374, offset=-0.05), _pitched(0.05, 0.422)
    foot = hip + thigh + shin
    assert found["left_foot_x"] == pytest.approx(foot[0], abs=1e-5)
    assert found["left_foot_y"] == pytest.approx(0.089 + 0.0225, abs=1e-5)
    assert found["left_foot_z"] == pytest.approx(foot[1], abs=1e-5)
    knee = math.pi - abs(0.1 - math.atan(0.05 / 0.374))  # the knee lies behind the hip
    assert found["left_knee"] == pytest.approx(knee, abs=1e-5)
    assert found["head_height"] == pytest.approx(0.6215 - foot[1] + 0.074119, abs=1e-5)
    vertical = [found[f"torso_vertical_{axis}"] for axis in "xyz"]
    np.testing.assert_allclose(vertical, [0, 0, 1], atol=1e-6)
    velocity = [found[f"com_velocity_{axis}"] for axis in "xyz"]
    np.testing.assert_allclose(velocity, [1.5, -0.5, 0], atol=1e-5)
    # upper arm from the shoulder: 0.187 out, then 0.119 with the offset 0.0092 turned forward
    upper = np.array([0.0092, 0.187 + 0.119, -0.016])
    fore = 0.306 * np.array([math.sin(0.3), math.cos(0.3), 0.0])
    elbow = math.acos(-upper @ fore / np.linalg.norm(upper) / np.linalg.norm(fore))
    assert found["left_elbow"] == pytest.approx(elbow, abs=1e-5)
    for part in ("hand", "foot"):
        left, right = ([found[f"{side}_{part}_{a}"] for a in "xyz"] for side in ("left", "right"))
        np.testing.assert_allclose(np.multiply(left, [1, -1, 1]), right, atol=1e-5)
    assert found["left_hand_y"] > 0.3 and found["left_hand_z"] < -0.3  # beside the hips


def test_the_limit_of_the_ankles_is_the_robots_own():
    joints = PUBLISHED["joints"]
    limits = [joints[name]["limit"] for name in ANKLES]
    assert min(min(-limit["lower"], limit["upper"]) for limit in limits) == 0.7


def test_every_published_shape_is_there(model: mujoco.MjModel):
    for name, link in PUBLISHED["links"].items():
        own = [geom for geom in range(model.ngeom) if not model.geom(geom).name]
        own = [geom for geom in own if model.geom_bodyid[geom] == model.body(name).id]
        for geom, shape in zip(own, link["collision"], strict=True):
            kind = mujoco.mjtGeom(model.geom_type[geom]).name
            assert kind == f"mjGEOM_{shape['shape'].upper()}"
            sides = shape.get("size") or [2 * shape["radius"], shape.get("length", 0.0)]
            size = np.array(sides) / 2
            np.testing.assert_allclose(model.geom_size[geom][: len(size)], size, rtol=1e-5)
            np.testing.assert_allclose(model.geom_pos[geom], shape["xyz_m"], atol=1e-6)


def test_the_source_and_the_licence_are_told():
    for text in (PUBLISHED["source"], atlas.__doc__ or ""):
        assert "Roboschool" in text and "MIT" in text


def _twin(name: str) -> str:
    other = {"l_": "r_", "r_": "l_"}.get(name[:2])
    return other + name[2:] if other else name


def _other_side(point: str) -> str:
    if point.startswith("left"):
        return point.replace("left", "right")
    return point.replace("right", "left")


def _pitched(angle_rad: float, length_m: float, offset: float = 0.0) -> np.ndarray:
    """Return (x, z) of a segment that hangs down, turned about y."""
    sine, cosine = math.sin(angle_rad), math.cos(angle_rad)
    return np.array([offset * cosine - length_m * sine, -offset * sine - length_m * cosine])
