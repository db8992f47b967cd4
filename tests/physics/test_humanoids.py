"""The humanoids' environments: parity with dm_control, episodes, seeds, threads and bad input."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest
from dm_control import suite

from silem import bodies
from silem.bodies import MujocoBody, humanoid
from silem.envs import BatchedEnv, SingleEnv, make_vec
from silem.envs.mujoco import Simulation, observe, stepped_model
from silem.motion.features import FEATURES, Landmarks, skeletal_features
from silem.motion.kinematics import observe as seen
from silem.util.errors import SilemError

ARM = ("upper_arm", "lower_arm", "hand")


def actions(n_steps: int, n_envs: int = 1, size: int = 21, scale: float = 1.0) -> np.ndarray:
    generator = np.random.default_rng(0)
    return generator.uniform(-scale, scale, (n_steps, n_envs, size)).astype(np.float32)


@pytest.fixture(scope="module")
def walked():
    """dm_control's walking task and our batch, stepped side by side from the same state."""
    theirs = suite.load("humanoid", "walk", task_kwargs={"random": 0})
    theirs.reset()
    # Falls are part of it: the body never ends an episode.
    body = dataclasses.replace(bodies.get("Humanoid"), fall_head_m=-1.0)
    ours = BatchedEnv(body, 1, speed_m_s=1.0)
    ours.reset()
    data = theirs.physics.data
    ours.simulation.place(0, data.qpos, data.qvel)
    rows = []
    for action in actions(300):
        wanted = theirs.step(action[0])
        observations, rewards, _, _ = ours.step(action)
        expected = np.concatenate([np.atleast_1d(part) for part in wanted.observation.values()])
        state = theirs.physics.data.qpos.copy(), ours.simulation.qpos[0].copy()
        rows.append((expected, observations[0], wanted.reward, rewards[0], *state))
    return [np.array(column) for column in zip(*rows, strict=True)]


def test_states_follow_dm_control_bit_for_bit(walked):
    *_, theirs, ours = walked
    np.testing.assert_array_equal(theirs, ours)
    assert np.ptp(theirs[:, 2]) > 0.5  # it did move


def test_observation_and_reward_are_dm_controls(walked):
    observation, ours, reward, our_reward, *_ = walked
    assert observation.shape == ours.shape == (300, 67)
    np.testing.assert_allclose(ours, observation, atol=1e-6, rtol=1e-6)
    np.testing.assert_allclose(our_reward, reward, atol=1e-6)
    assert reward.max() > 0.05


def test_the_speed_target_is_the_demonstrators():
    env = make_vec("Humanoid", 1)
    env.reset()
    slow, fast = (BatchedEnv("Humanoid", 1, speed_m_s=speed) for speed in (0.1, 10.0))
    for other in (slow, fast):
        other.reset()
    (action,) = actions(1)
    ours, slow_reward, fast_reward = (e.step(action)[1][0] for e in (env, slow, fast))
    assert fast_reward < ours < slow_reward


def test_an_episode_ends_at_a_fall_and_its_info_says_so():
    env = make_vec("Humanoid", 2, seed=1)
    env.reset()
    start = env.simulation.read().qpos[0, :2].copy()
    total = 0.0
    n_steps = 0
    for action in actions(200, 2):
        n_steps += 1
        before = env.simulation.read()
        observations, rewards, dones, infos = env.step(action)
        total += float(rewards[0])
        if dones[0]:
            break
    assert before.head_m[0] >= 1.0  # the step before it stood
    info = infos[0]
    assert info["terminal_observation"][21] < 1.0  # the head's height
    assert not info["TimeLimit.truncated"]
    episode = info["episode"]
    assert episode["l"] == n_steps
    assert episode["r"] == pytest.approx(total, rel=1e-5)
    assert episode["upright"] == n_steps / 1000
    # skeletal features are those of the state that ended the episode, then of the new start
    assert info["skeletal_features"][16] == pytest.approx(info["terminal_observation"][21])
    assert env.reset_infos[0]["skeletal_features"][16] == pytest.approx(observations[0, 21])
    assert observations[0, 21] > 1.4
    np.testing.assert_allclose(start, 0.0)


def test_the_step_limit_is_a_truncation():
    standing = dataclasses.replace(bodies.get("Humanoid"), fall_head_m=-1.0)
    env = BatchedEnv(standing, 1, max_steps=3)
    env.reset()
    ends = [env.step(np.zeros((1, 21)))[2:] for _ in range(3)]
    assert [bool(done[0]) for done, _ in ends] == [False, False, True]
    assert ends[-1][1][0]["TimeLimit.truncated"]


@pytest.mark.parametrize("name", ["Humanoid", "HumanoidR"])
def test_speed_is_the_straight_way_over_the_time(name: str):
    env = make_vec(name, 1)
    env.reset()
    places = [env.simulation.read().qpos[0, :2]]
    for action in actions(300):
        env.simulation.advance(action)  # the same steps, without the episode's bookkeeping
        places.append(env.simulation.read().qpos[0, :2])
        if env.simulation.read().head_m[0] < 1.0:
            break
    again = make_vec(name, 1)
    again.reset()
    for action in actions(300):
        *_, dones, infos = again.step(action)
        if dones[0]:
            break
    seconds = (len(places) - 1) * 0.025
    expected = np.linalg.norm(places[-1] - places[0]) / seconds
    assert infos[0]["episode"]["speed_m_s"] == pytest.approx(expected)


def test_features_beside_the_observation_are_g_of_the_state():
    env = make_vec("HumanoidR", 3)
    env.reset()
    for action in actions(10, 3):
        *_, infos = env.step(action)
    now = env.simulation
    expected = skeletal_features(*seen(now.model, env.body.skeleton, now.qpos, now.qvel))
    found = np.array([info["skeletal_features"] for info in infos])
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert found.shape == (3, len(FEATURES))


def test_a_seed_fixes_everything_whatever_happened_before():
    def roll(env: BatchedEnv) -> list[np.ndarray]:
        env.seed(7)
        return [env.reset(), *(env.step(action)[0] for action in actions(80, 3))]

    used = make_vec("Humanoid", 3, seed=3)
    used.reset()
    for action in actions(5, 3):
        used.step(action)
    fresh, again = roll(make_vec("Humanoid", 3)), roll(used)
    threaded = roll(make_vec("Humanoid", 3, n_threads=2))
    for a, b, c in zip(fresh, again, threaded, strict=True):
        np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(a, c)
    other = make_vec("Humanoid", 3, seed=8)
    assert not np.array_equal(other.reset(), fresh[0])


def test_observations_are_those_of_the_present_states_also_after_falls():
    env = make_vec("Humanoid", 3, seed=1)
    env.reset()
    n_falls = 0
    for action in actions(60, 3):
        observations, _, dones, _ = env.step(action)
        reading = env.simulation.read()
        np.testing.assert_array_equal(observations, observe(reading, reading.features()))
        n_falls += dones.sum()
    assert n_falls >= 3
    chosen = env.simulation.read(np.array([2, 0]))
    for part, whole in zip(chosen[:-1], env.simulation.read()[:-1], strict=True):  # arrays
        np.testing.assert_array_equal(part, whole[[2, 0]])
    assert not np.array_equal(chosen.qpos[0], chosen.qpos[1])


def test_a_reading_does_not_change_when_the_simulation_goes_on():
    env = make_vec("Humanoid", 2)
    env.reset()
    reading = env.simulation.read()
    kept = [part.copy() for part in reading[:-1]]  # arrays, and the vertical, which is fixed
    env.step(actions(1, 2)[0])
    for part, before in zip(reading[:-1], kept, strict=True):
        np.testing.assert_array_equal(part, before)
    assert not np.array_equal(env.simulation.read().qpos, reading.qpos)


def test_the_single_environment_is_the_batch_of_one():
    starts = np.array([bodies.get("Humanoid").standing_pose]), np.full((1, 27), 0.3)
    single, batch = SingleEnv("Humanoid", starts=starts), make_vec("Humanoid", 1, starts=starts)
    first, info = single.reset(seed=0)
    np.testing.assert_array_equal(first, batch.reset()[0])
    np.testing.assert_array_equal(
        info["skeletal_features"], batch.reset_infos[0]["skeletal_features"]
    )
    for action in actions(100, scale=3.0):  # beyond the range: both clip
        a, b = single.step(action[0]), batch.step(action)
        assert a[1] == pytest.approx(b[1][0])
        assert a[2] == b[2][0]
        if a[2]:
            break
        np.testing.assert_array_equal(a[0], b[0][0])
    assert a[2]  # it fell, in both
    np.testing.assert_array_equal(a[0], b[3][0]["terminal_observation"])


def test_episodes_start_from_given_states():
    body = bodies.get("Humanoid")
    poses = np.array([body.standing_pose, body.standing_pose])
    poses[:, 0] = 5.0, 6.0
    env = make_vec("Humanoid", 8, starts=(poses, np.zeros((2, 27))))
    env.reset()
    assert set(env.simulation.read().qpos[:, 0]) == {5.0, 6.0}


def test_a_placed_state_remembers_nothing():
    simulation, fresh = (Simulation(bodies.get("Humanoid"), 2) for _ in range(2))
    for row in actions(5, 2):
        simulation.advance(row)
    pose = np.array(simulation.body.standing_pose)
    for each in (simulation, fresh):
        each.place(1, pose, np.full(27, 0.1))
    ours, theirs = simulation.data(1), fresh.data(1)
    for field in ("time", "qpos", "qvel", "ctrl", "qacc_warmstart", "xpos", "subtree_linvel"):
        np.testing.assert_array_equal(getattr(ours, field), getattr(theirs, field))
    assert simulation.data(0).time > 0  # the other one goes on


def test_arms_are_scaled_and_nothing_else():
    plain, scaled = (
        mujoco.MjModel.from_xml_string(bodies.get(name).model_xml())
        for name in ("Humanoid", "HumanoidR")
    )
    arms = [f"{side}_{link}" for side in ("left", "right") for link in ARM]
    for index in range(1, plain.nbody):
        name = plain.body(index).name
        same_place = np.array_equal(plain.body_pos[index], scaled.body_pos[index])
        assert same_place == (name not in arms or name.endswith("upper_arm")), name
        same_mass = plain.body_mass[index] == scaled.body_mass[index]
        assert same_mass == (name not in arms or name.endswith("hand")), name
    for side, factor in humanoid.ARM_FACTORS.items():
        for link in ARM[1:]:
            ratio = scaled.body(f"{side}_{link}").pos / plain.body(f"{side}_{link}").pos
            np.testing.assert_allclose(ratio, factor, rtol=1e-5)
    assert scaled.body("right_lower_arm").mass > plain.body("right_lower_arm").mass
    assert scaled.body("left_lower_arm").mass < plain.body("left_lower_arm").mass
    np.testing.assert_array_equal(plain.actuator_gear, scaled.actuator_gear)


def test_distances_are_the_papers():
    body = bodies.get("Humanoid")
    model = mujoco.MjModel.from_xml_string(body.model_xml())
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    torso = data.body("torso").xpos
    assert np.linalg.norm(data.body("left_foot").xpos - torso) == pytest.approx(1.26, abs=0.005)
    assert np.linalg.norm(data.body("left_hand").xpos - torso) == pytest.approx(0.40, abs=0.005)


def test_standing_pose_has_its_soles_on_the_floor():
    simulation = Simulation(bodies.get("Humanoid"), 1)
    simulation.place(0, np.array(simulation.body.standing_pose), np.zeros(27))
    data = simulation.data()
    assert data.ncon == 0 or abs(data.contact.dist).max() < 1e-6
    lowered = np.array(simulation.body.standing_pose)
    lowered[2] -= 1e-3
    simulation.place(0, lowered, np.zeros(27))
    assert simulation.data().ncon > 0


def test_bad_input_is_refused():
    env = make_vec("Humanoid", 2)
    with pytest.raises(SilemError, match="step before reset"):
        env.step(np.zeros((2, 21)))
    env.reset()
    with pytest.raises(SilemError, match=r"actions of shape \(2, 20\); expected \(2, 21\)"):
        env.step(np.zeros((2, 20)))
    with pytest.raises(SilemError, match="NaN"):
        env.step(np.full((2, 21), np.nan))
    with pytest.raises(SilemError, match="n_threads must be a whole number from 1 to"):
        make_vec("Humanoid", n_threads=0)
    for make in (make_vec, SingleEnv):
        with pytest.raises(SilemError, match="speed_m_s must be a finite number above 0, not 0"):
            make("Humanoid", speed_m_s=0)
    with pytest.raises(SilemError, match="'HC0' is simulated by bullet, not by mujoco"):
        bodies.of_kind("HC0", MujocoBody)
    with pytest.raises(SilemError, match="arm scaled by -1"):
        humanoid.model(left_arm=-1)
    single = SingleEnv("Humanoid", render_mode="rgb_array")
    with pytest.raises(SilemError, match="render before reset"):
        single.render()


@pytest.mark.parametrize("field", ["qpos", "qvel"])
def test_physics_that_explodes_ends_the_episode_without_reward(field: str):
    env = make_vec("Humanoid", 3)
    env.reset()
    env.step(np.zeros((3, 21)))
    getattr(env.simulation, field)[1, 0] = 1e12
    _, rewards, dones, infos = env.step(np.zeros((3, 21)))
    assert dones.tolist() == [False, True, False]
    assert rewards[1] == 0.0 and rewards[[0, 2]].min() > 0
    assert not infos[1]["TimeLimit.truncated"]
    assert np.isfinite(infos[1]["terminal_observation"]).all()
    assert not env.step(np.zeros((3, 21)))[2].any()


@pytest.mark.parametrize("name", ["HumanoidR", "Atlas"])
def test_the_batch_steps_bit_for_bit_as_mj_step_does(name: str):
    """A control step is mj_step2, mj_step four times, mj_step1, as in dm_control."""
    body = dataclasses.replace(bodies.get(name), fall_head_m=-1.0)  # falls are part of it
    env = make_vec(body, 3, seed=2)
    env.reset()
    model = mujoco.MjModel.from_xml_string(body.model_xml())
    singles = [mujoco.MjData(model) for _ in range(3)]
    for index, data in enumerate(singles):
        data.qpos[:], data.qvel[:] = env.simulation.qpos[index], env.simulation.qvel[index]
        mujoco.mj_forward(model, data)
    n_substeps = body.n_substeps
    for rows in actions(100, 3, body.action_size):
        env.step(rows)
        for data, row in zip(singles, rows, strict=True):
            data.ctrl[:] = row
            mujoco.mj_step2(model, data)
            mujoco.mj_step(model, data, n_substeps - 1)
            mujoco.mj_step1(model, data)
            mujoco.mj_subtreeVel(model, data)
    reading, landmarks = env.simulation.read(), Landmarks(model, body.skeleton)
    for index, data in enumerate(singles):
        np.testing.assert_array_equal(reading.qpos[index], data.qpos)
        np.testing.assert_array_equal(reading.qvel[index], data.qvel)
        np.testing.assert_array_equal(reading.points[index], data.xpos[landmarks.ids])
        np.testing.assert_array_equal(reading.com_velocity[index], data.subtree_linvel[1])
    assert np.ptp(reading.head_m) > 0.01
    mujoco.mj_step(model, singles[0])  # a whole step more is another state
    assert not np.array_equal(reading.qpos[0], singles[0].qpos)


def test_a_stepped_model_lacks_only_what_is_drawn_and_weighs_nothing():
    ghost = '<geom name="ghost" type="sphere" size="0.1" contype="0" conaffinity="0"/>'
    heavy = bodies.get("Humanoid").model_xml().replace("</body>", f"{ghost}</body>", 1)
    humanoid = dataclasses.replace(bodies.get("Humanoid"), build=lambda: heavy)
    for body, n_fewer in ((bodies.get("Atlas"), 59), (humanoid, 0)):
        plain, stepped = mujoco.MjModel.from_xml_string(body.model_xml()), stepped_model(body)
        assert plain.ngeom - stepped.ngeom == n_fewer
        assert plain.npair == stepped.npair
        for field in ("body_mass", "body_inertia", "body_ipos", "body_iquat"):
            np.testing.assert_array_equal(getattr(plain, field), getattr(stepped, field))
    plain = mujoco.MjModel.from_xml_string(bodies.get("Humanoid").model_xml())
    assert stepped.body_mass.sum() > plain.body_mass.sum() + 1  # what leaving it out would miss
