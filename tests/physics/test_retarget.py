"""Retargeting: what a body can do it does exactly, what it cannot is reported, never hidden."""

from __future__ import annotations

import dataclasses
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator

import mujoco
import numpy as np
import pytest

from silem import bodies
from silem.bodies.body import MujocoBody, Skeleton
from silem.motion import kinematics, retargeted, retargeting
from silem.motion.demonstrations import Demonstrations
from silem.motion.demonstrator import Motion, published_motion
from silem.motion.features import FEATURES, POINTS, skeletal_features
from silem.motion.kinematics import Soles
from silem.motion.retargeting import (
    BODIES,
    STANCE_SPEED_M_S,
    TARGETS,
    IKResult,
    Limbs,
    learner,
    published_retargeting,
    retarget_clip,
    standing_feet,
    targets,
)
from silem.study.settings import HUMAN
from silem.util.errors import SilemError

LEFT_HAND = TARGETS.index("left_hand")
SCALED_ATTRIBUTES = ("pos", "fromto", "size")


def compiled(body: MujocoBody) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(body.model_xml())


def cut(motion: Motion, n_frames: int) -> Motion:
    """Return the first frames of a motion."""
    arrays = ("qpos", "qvel", "points", "torso_axes", "com_velocity", "features")
    first = {name: getattr(motion, name)[:n_frames] for name in arrays}
    return dataclasses.replace(motion, **first)


def motion_of(result: IKResult) -> Motion:
    """Return a retargeted motion as if its body had been the demonstrator."""
    body = learner(result.body)
    model = compiled(body)
    _, axes, _ = kinematics.observe(model, body.skeleton, result.qpos, result.qvel)
    return Motion(
        name=f"{result.motion} on {result.body}",
        rate_hz=result.rate_hz,
        qpos=result.qpos,
        qvel=result.qvel,
        points=result.points,
        torso_axes=np.array(axes),
        com_velocity=np.zeros((len(axes), 3)),
        features=result.features,
    )


def scaled(body: MujocoBody, factor: float) -> MujocoBody:
    """Return a body of the same shape and another size."""
    root = ElementTree.fromstring(body.model_xml())
    (top,) = root.findall("worldbody/body")
    for element in top.iter():
        for name in SCALED_ATTRIBUTES if element.tag in ("body", "geom", "joint") else ():
            if name in element.attrib:
                values = [factor * float(value) for value in element.attrib[name].split()]
                element.set(name, " ".join(f"{value:.9g}" for value in values))
    text = ElementTree.tostring(root, encoding="unicode")
    pose = (*(factor * value for value in body.standing_pose[:3]), *body.standing_pose[3:])
    return dataclasses.replace(body, name="Scaled", build=lambda: text, standing_pose=pose)


@pytest.fixture(scope="module")
def human() -> Motion:
    return published_motion("08_01")


@pytest.fixture(scope="module")
def results(human: Motion) -> dict[str, IKResult]:
    short = cut(human, 45)  # more than one stride
    return {name: retarget_clip(short, learner(name)) for name in BODIES}


@pytest.fixture(scope="module")
def walker() -> Motion:
    """Humanoid's own walk."""
    return cut(motion_of(published_retargeting("Humanoid")), 45)


def test_a_body_that_follows_itself_reproduces_its_motion(walker):
    result = retarget_clip(walker, bodies.get("Humanoid"))
    assert result.residuals.max() < 1e-3
    assert result.converged.all()
    np.testing.assert_allclose(result.ratios, 1.0, rtol=3e-3)
    assert result.raised_m.max() < 5e-3
    start = walker.points[0, 0, :2] - result.points[0, 0, :2]
    off_m = np.abs(result.points - (walker.points - np.append(start, 0.0)))
    # Targets leave the waist's and the knees' sideways turn open; those stay near.
    assert off_m.mean() < 3e-3 and off_m.max() < 0.05


@pytest.fixture
def unscaled(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """All limbs taken to be alike, so that nothing is scaled; by the tolerance nothing fails."""
    with monkeypatch.context() as patch:
        patch.setattr(Limbs, "of", classmethod(lambda cls, points: cls(1, 1, 1, 1, 1)))
        patch.setattr(retargeting, "TOLERANCE_M", 1.0)
        yield


def test_a_scaled_copy_takes_the_same_joint_angles(walker):
    body = bodies.get("Humanoid")
    own = retarget_clip(walker, body)
    larger = retarget_clip(walker, scaled(body, 1.3))
    np.testing.assert_allclose(larger.ratios, 1.3, rtol=3e-3)
    assert larger.residuals.max() < 2e-3
    np.testing.assert_allclose(larger.qpos[:, 7:], own.qpos[:, 7:], rtol=0, atol=0.02)
    np.testing.assert_allclose(larger.qpos[:, :3], 1.3 * own.qpos[:, :3], rtol=0, atol=0.01)


def test_a_copy_of_another_size_needs_scaled_targets(walker, unscaled):
    """The negative control of the test above."""
    body = bodies.get("Humanoid")
    own, larger = retarget_clip(walker, body), retarget_clip(walker, scaled(body, 1.3))
    assert np.abs(larger.qpos[:, 7:] - own.qpos[:, 7:]).max() > 0.3


@pytest.mark.parametrize("name", BODIES)
def test_joint_limits_hold_and_contact_with_them_is_counted(results, name):
    result, model = results[name], compiled(learner(name))
    lower, upper = model.jnt_range[1:].T
    angles = result.qpos[:, 7:]
    assert (angles >= lower - 1e-6).all() and (angles <= upper + 1e-6).all()
    assert result.at_limit.shape == (len(angles), model.njnt - 1) == (45, len(result.joint_names))
    closest = np.minimum(angles - lower, upper - angles)
    np.testing.assert_array_equal(result.at_limit, closest < 1e-3)
    assert 0 < result.at_limit.mean() < 0.3


@pytest.mark.parametrize("name", BODIES)
def test_soles_stay_on_the_floor(results, human, name):
    result = results[name]
    assert result.sole_height_m.min() > -1e-5
    stance = standing_feet(cut(human, 45))
    assert np.median(result.sole_height_m[stance]) < 5e-3
    assert result.sole_height_m[~stance].max() > 0.04


@pytest.mark.parametrize("name", BODIES)
def test_standing_feet_do_not_skate(results, human, name):
    """They may move as much as the demonstrator's own, and no more."""
    result = results[name]
    stance = standing_feet(cut(human, 45))
    np.testing.assert_array_equal(np.isnan(result.foot_skate_m_s), ~stance)
    assert np.nanmax(result.foot_skate_m_s) < STANCE_SPEED_M_S * 1.02


@pytest.mark.parametrize("name", BODIES)
def test_feet_and_torso_are_reached_and_the_walk_goes_on(results, name):
    result = results[name]
    torso, _, _, left_foot, right_foot = result.residuals.T
    assert torso.max() < 0.01 and result.torso_tilt_rad.max() < 0.01
    assert max(left_foot.max(), right_foot.max()) < 1e-3
    # No pose jumps to another solution: a leg's would cost it 1 rad in a frame, 40 rad/s. (The
    # twist of Atlas's hanging arms is all but free, and turns at up to 27 rad/s.)
    speeds = dict(zip(result.joint_names, np.abs(result.qvel[:, 6:]).max(axis=0), strict=True))
    assert max(speed for joint, speed in speeds.items() if "_arm_" not in joint) < 12.0
    assert np.all(np.diff(result.points[:, 0, 0]) > 0.02)  # along x, 0.8 m/s and more


def test_without_limb_scaling_the_short_arm_cannot_reach(results, human, unscaled):
    kept = retarget_clip(cut(human, 45), learner("HumanoidR"))
    assert results["HumanoidR"].ratios.left_arm == pytest.approx(0.59, abs=0.01)
    assert results["HumanoidR"].ratios.right_arm == pytest.approx(1.77, abs=0.01)
    assert kept.residuals[:, LEFT_HAND].mean() > 0.1
    assert results["HumanoidR"].residuals[:, LEFT_HAND].mean() < 0.02


def test_an_unreachable_target_is_reported_with_frame_and_name(walker):
    points = walker.points[:12].copy()
    points[5, POINTS.index("left_hand")] += [0, 0, 2.0]
    broken = dataclasses.replace(cut(walker, 12), points=points)
    result = retarget_clip(broken, bodies.get("Humanoid"))
    assert result.residuals[5, LEFT_HAND] > 0.3
    assert not result.converged[5] and result.converged.sum() >= 10


def test_a_motion_that_no_frame_can_follow_is_refused(human, monkeypatch):
    monkeypatch.setattr(retargeting, "TOLERANCE_M", 1e-9)
    with pytest.raises(SilemError, match="Humanoid cannot follow 08_01 in any frame: in frame 0"):
        retarget_clip(cut(human, 5), bodies.get("Humanoid"))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_absurd_targets_are_refused(human, value):
    points = human.points.copy()
    points[7, 3, 1] = value
    with pytest.raises(SilemError, match="motion 08_01: points of frame 7 hold NaN or infinity"):
        retarget_clip(dataclasses.replace(human, points=points), bodies.get("Humanoid"))


def test_the_same_motion_gives_the_same_arrays(human):
    first, second = (retarget_clip(cut(human, 10), bodies.get("Humanoid")) for _ in range(2))
    for name in ("qpos", "qvel", "features", "residuals", "points"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_targets_keep_the_demonstrators_stance_and_proportions(human):
    body = bodies.get("Humanoid")
    model = compiled(body)
    standing = np.array([body.standing_pose]), np.zeros((1, model.nv))
    (points,), _, _ = kinematics.observe(model, body.skeleton, *standing)
    wanted = targets(human, body)
    lengths = Limbs.of(points)
    # By hand, from humanoid.xml: thigh and shin; upper and lower arm; pelvis to torso.
    leg = np.hypot(0.403, 0.01) + 0.39
    np.testing.assert_allclose(lengths, [leg, *[2 * np.sqrt(3) * 0.18] * 2, 0.465, 0.2], atol=2e-3)
    feet = wanted.positions[:, 3:]
    assert feet[..., 2].min() == pytest.approx(points[POINTS.index("left_foot"), 2], abs=1e-6)
    human_way = human.points[-1, 0, 0] - human.points[0, 0, 0]
    way = wanted.positions[-1, 0, 0] - wanted.positions[0, 0, 0]
    assert way == pytest.approx(wanted.ratios.leg * human_way, abs=0.01)
    assert wanted.raised_m.max() < 0.02


def feet(geom: str) -> tuple[mujoco.MjModel, Skeleton]:
    """A model whose left and right foot are one body with one shape, at z = 1."""
    xml = f"""<mujoco><worldbody><body name="foot" pos="0 0 1"><freejoint/>
    <geom name="sole" {geom}/></body></worldbody></mujoco>"""
    skeleton = Skeleton(**{name: "foot" for name in POINTS})
    return mujoco.MjModel.from_xml_string(xml), skeleton


def test_a_foot_that_cannot_be_kept_off_the_floor_is_refused():
    with pytest.raises(SilemError, match="'sole' of a foot is a cylinder; allowed: sphere"):
        Soles(*feet('type="cylinder" size="0.1 0.1"'))
    with pytest.raises(SilemError, match="foot 'foot' has no shape that could touch the floor"):
        Soles(*feet('type="capsule" size="0.1 0.1" contype="0" conaffinity="0"'))


def test_soles_know_spheres_capsules_and_tilted_boxes():
    lowest = {
        'type="sphere" size="0.1" pos="0 0 -0.2"': 1 - 0.2 - 0.1,
        'type="capsule" size="0.1" fromto="0 0 0 0.3 0 -0.4"': 1 - 0.4 - 0.1,
        'type="box" size="0.2 0.1 0.3" euler="0 45 0"': 1 - 0.5 * np.sqrt(0.5),
    }
    for geom, height in lowest.items():
        model, skeleton = feet(geom)
        found = Soles(model, skeleton).lowest(np.array([model.qpos0, model.qpos0 + 0.5]))
        assert found[0] == pytest.approx([height, height])
        assert found[1, 0] > height + 0.2


@pytest.mark.parametrize("name", BODIES)
def test_published_states_and_features_belong_together(name):
    demonstrations = Demonstrations.load(retargeted(HUMAN, name))
    qpos, qvel = demonstrations.extra["qpos"], demonstrations.extra["qvel"]
    (features,) = demonstrations.features
    body = learner(name)
    model = compiled(body)
    assert qpos.shape == (len(features), model.nq) and qvel.shape == (len(features), model.nv)
    assert demonstrations.body == name and demonstrations.n_features == len(FEATURES)
    np.testing.assert_allclose(qvel, kinematics.velocities(model, qpos, 40.0), atol=1e-9)
    seen = kinematics.observe(model, body.skeleton, qpos, qvel)
    np.testing.assert_allclose(skeletal_features(*seen), features, atol=1e-5)


def test_what_is_published_is_what_retargeting_gives(human):
    published = published_retargeting("Humanoid")
    result = retarget_clip(human, learner("Humanoid"))
    np.testing.assert_allclose(result.features, published.features, atol=1e-3)
    np.testing.assert_allclose(result.residuals, published.residuals, atol=1e-3)
    assert result.joint_names == published.joint_names
    worst_m = dict(zip(TARGETS, published.residuals.max(axis=0), strict=True))
    assert worst_m["left_foot"] < 1e-3 < worst_m["left_hand"]
    way_m = np.linalg.norm(published.points[-1, 0, :2] - published.points[0, 0, :2])
    speed_m_s = way_m * published.rate_hz / (len(published.points) - 1)
    assert speed_m_s == pytest.approx(human.speed_m_s * published.ratios.leg, abs=0.02)
