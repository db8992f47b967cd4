"""Bodies that their names describe: of any length, on a slope, another in each environment."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from silem import bodies
from silem.bodies import BulletBody
from silem.envs import SingleEnv, make_vec
from silem.envs.bullet import LocomotionTask, State, _felt
from silem.envs.camera import Camera
from silem.motion.features import FEATURES
from silem.report.film import why_no_pictures
from silem.util.errors import SilemError

SLOPES = ("HC0-slope-10", "Ant0-slope-10", "Humanoid-slope-10")
VERTICAL = [f.name.startswith("torso_vertical") for f in FEATURES]


@pytest.mark.parametrize(
    ("described", "listed"), [("HC-2", "HC1"), ("HC-3", "HC2"), ("Ant-0.35", "Ant3")]
)
def test_a_described_body_is_the_papers_of_that_length(described: str, listed: str):
    assert bodies.get(described).model_xml() == bodies.get(listed).model_xml()
    assert bodies.get("HC-1.25").length == ("length of the torso", 1.25)
    assert described not in bodies.names()  # which lists what the paper knows


def test_a_longer_arm_is_humanoid_rs():
    right = bodies.describe("Humanoid-arm-1.5")["lengths_m"]
    both = bodies.describe("HumanoidR")["lengths_m"]
    plain = bodies.describe("Humanoid")["lengths_m"]
    for name, length in right.items():
        arm = name.startswith("right_") and name.endswith("_arm")
        assert length == (both if arm else plain)[name]


@pytest.mark.parametrize(
    "name", ["HC-1.250", "HC-0", "HC--1", "XX-slope-3", "HC0-slope-0", "HC0-slope-50",
             "HC0-slope-5-slope-5", "Pendulum-v1-slope-3", "Humanoid-arm-2-1"],
)  # fmt: skip
def test_other_names_describe_none(name: str):
    with pytest.raises(SilemError, match=r"unknown body|a slope has up to 45|go from 2 up to 1"):
        bodies.get(name)


def test_a_slope_follows_its_body(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(bodies, "_BODIES", dict(bodies._BODIES))
    monkeypatch.setattr(bodies, "_OWN", {})
    own = bodies.half_cheetah.body
    bodies.register(own("Mine", 1.5))
    assert bodies.get("Mine-slope-5").length[1] == 1.5
    bodies.register(own("Mine", 1.7), replace=True)
    assert bodies.get("Mine-slope-5").length[1] == 1.7
    bodies._described.cache_clear()


def test_what_is_felt_on_a_slope_is_the_rotated_state():
    slope, rng = math.radians(12.0), np.random.default_rng(0)
    up, turn = (math.sin(slope), 0.0, math.cos(slope)), Rotation.from_euler("y", -slope)
    for rpy in rng.uniform(-1.0, 1.0, (20, 3)):
        velocity = rng.standard_normal(3)
        yaw, pitch, roll = (turn * Rotation.from_euler("ZYX", rpy[::-1])).as_euler("ZYX")
        level, _, rise = turn.apply(velocity)
        found = _felt(up, tuple(rpy), (velocity[0], velocity[2]))
        np.testing.assert_allclose(found, (roll, pitch, level, rise), atol=1e-12)
        assert abs(yaw - rpy[2]) < 1.0  # and is not asked for: the bearing is the floor's


@pytest.mark.parametrize("name", SLOPES[:2])
def test_a_runner_on_a_slope_feels_its_pitch_and_falls_straight_down(name: str):
    env = make_vec(name, 1, seed=0)
    pitch = env.reset()[0, 7]
    assert pitch == pytest.approx(-math.radians(10.0), abs=1e-6)  # its nose is up
    if name.startswith("Ant"):  # which starts in the air
        (observation,), *_ = env.step(np.zeros((1, 8), np.float32))
        level, _, rise = observation[3:6]
        assert level == pytest.approx(0.0, abs=1e-4)
        assert rise == pytest.approx(-0.3 * 9.8 * 0.0165, rel=0.02)
    again, flat = (make_vec(n, 1, seed=0).reset()[0] for n in (name, name.partition("-")[0]))
    np.testing.assert_array_equal(np.delete(again, 7), np.delete(flat, 7))  # the rest is as ever


def test_the_alive_rule_is_the_floors():
    body = bodies.get("HC0-slope-10")
    assert isinstance(body, BulletBody)
    task = LocomotionTask(body, [(-1.0, 1.0)] * 6)
    for pitch, upright in ((0.9, True), (1.05, False)):  # both below 1 against the vertical
        places = [(0.0, 0.0, 0.5)] * len(body.parts)
        state = State([(0.0, 0.0)] * 6, (0.0, pitch, 0.0), (0.0,) * 3, places, [0.0] * 6)
        task.begin(state)
        observation, *_ = task.step([0.0] * 6, state)
        assert observation[7] == pytest.approx(pitch - math.radians(10.0))
        assert bool(task.n_upright) == upright


def test_a_humanoid_on_a_slope_feels_the_vertical():
    env, flat = make_vec("Humanoid-slope-10", 1, seed=0), make_vec("Humanoid", 1, seed=0)
    assert env.reset().shape == flat.reset().shape
    (there,), (here,) = ([i["skeletal_features"] for i in e.reset_infos] for e in (env, flat))
    tilt = math.degrees(math.acos(there[VERTICAL] @ here[VERTICAL]))
    assert tilt == pytest.approx(10.0, abs=1e-3)
    simulation = env.simulation
    qpos = simulation.qpos[0].copy()
    qpos[2] += 5.0
    simulation.place(0, qpos, np.zeros(simulation.qvel.shape[1]))
    simulation.advance(np.zeros((1, 21)))
    fall = simulation.read().com_velocity[0]
    np.testing.assert_allclose(fall / np.linalg.norm(fall), -np.array(env.body.up), atol=1e-3)


@pytest.mark.parametrize("name", SLOPES)
def test_a_picture_of_a_slope_has_gravitys_vertical(name: str):
    if why_no_pictures(name):
        pytest.skip("nothing can be drawn here")
    body = bodies.get(name)
    for shown, up in ((body, body.up), (dataclasses.replace(body, slope_deg=0.0), (0, 0, 1))):
        camera = Camera(shown, 64, 48)
        camera.picture()
        for eye in camera._renderer.scene.camera:
            right = np.cross(eye.forward, eye.up)
            assert abs(right @ up) < 1e-6 < eye.up @ up
            assert eye.up @ eye.forward == pytest.approx(0.0, abs=1e-6)
        camera.close()


def test_every_environment_has_the_body_it_was_given():
    """Environment i is a single environment of body i, to the bit."""
    names = ["Humanoid-arm-0.5", "Humanoid", "Humanoid-arm-1.5"]
    several = make_vec("Humanoid", 3, bodies=[bodies.get(name) for name in names])
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1, 1, (60, 21)).astype(np.float32)
    roots = [np.random.default_rng(s) for s in np.random.SeedSequence(0).spawn(3)]
    rows = [several.reset()]
    for action in actions:
        rows.append(several.step(np.tile(action, (3, 1)))[0])
    ended = 0
    for i, name in enumerate(names):
        env = SingleEnv(name)
        env.reset(seed=0)
        env.np_random = roots[i]
        alone = [env.reset()[0]]
        for action in actions:
            observation, _, fallen, *_ = env.step(action)
            alone.append(env.reset()[0] if fallen else observation)
            ended += fallen
        np.testing.assert_array_equal(np.array(rows)[:, i], alone)
        other = (i + 1) % 3
        assert not np.array_equal(np.array(rows)[:, other], alone)
    assert ended


def test_every_environment_starts_as_its_own_body_stands():
    plain = bodies.get("Humanoid")
    x, y, z, *rest = plain.standing_pose
    raised = dataclasses.replace(plain, standing_pose=(x, y, z + 0.5, *rest))
    env = make_vec("Humanoid", 3, bodies=[plain, raised, plain])
    env.reset()
    np.testing.assert_allclose(env.simulation.qpos[:, 2] - z, [0.0, 0.5, 0.0])


def test_a_range_of_arms_is_spread_over_the_environments():
    body = bodies.get("Humanoid-arm-0.5-1.5")
    assert [each.length[1] for each in body.each(4)] == sorted(e.length[1] for e in body.each(4))
    assert body.each(1)[0].model_xml() == bodies.get("Humanoid").model_xml()
    env, plain = make_vec(body, 4), make_vec("Humanoid", 4)
    steps = [e.step(np.zeros((4, 21), np.float32))[0] for e in (env, plain) if len(e.reset())]
    assert not np.array_equal(*steps)


def test_the_first_environments_own_body_is_filmed():
    if why_no_pictures("Humanoid"):
        pytest.skip("nothing can be drawn here")
    pictures = []
    for given in (["Humanoid-arm-1.5", "Humanoid"], ["Humanoid", "Humanoid-arm-1.5"]):
        env = make_vec("Humanoid", 2, bodies=[bodies.get(name) for name in given])
        env.reset()
        pictures.append(env.render())
        env.close()
    assert np.any(pictures[0] != pictures[1])


def test_bodies_of_a_batch_are_of_one_kind():
    humanoid, atlas = bodies.get("Humanoid"), bodies.get("Atlas")
    for given, problem in (([humanoid], "1 bodies for 2"), ([humanoid, atlas], "in lengths alone")):
        with pytest.raises(SilemError, match=problem):
            make_vec("Humanoid", 2, bodies=given)
