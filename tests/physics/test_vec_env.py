"""The batched environment: repeatable, honest about how episodes end, strict about its input."""

from __future__ import annotations

import hashlib
import math
import subprocess
import sys

import numpy as np
import pybullet
import pytest
from stable_baselines3.common.vec_env import VecEnv

from silem import bodies
from silem.bodies import BulletBody
from silem.envs import BatchedEnv, SingleEnv, make_vec
from silem.util.errors import SilemError
from silem.util.paths import REPO

STEPS = 120
SHORT = 50  # steps per episode, so that a rollout resets twice


def rollout(env: VecEnv, steps: int = STEPS) -> np.ndarray:
    """Reset and step with fixed actions: (T + 1, E, O + 1), observations and rewards."""
    rng = np.random.default_rng(1)
    observations = env.reset()
    rows = [np.column_stack([observations, np.zeros(env.num_envs)])]
    for _ in range(steps):
        actions = rng.uniform(-1, 1, (8, env.action_space.shape[0])).astype(np.float32)
        observations, rewards, _, _ = env.step(actions[: env.num_envs])
        rows.append(np.column_stack([observations, rewards]))
    return np.stack(rows)


def digest(body: str) -> str:
    return hashlib.sha256(rollout(make_vec(body, 2, seed=7, max_steps=SHORT)).tobytes()).hexdigest()


def fall(env: BatchedEnv, index: int = 0) -> None:
    """Put an Ant's torso just above the floor, and below the height of the alive rule."""
    simulator = env.simulation.clients[index]
    pybullet.resetBasePositionAndOrientation(
        simulator.robot, (0, 0, 0.255), (0, 0, 0, 1), physicsClientId=simulator.client
    )


@pytest.mark.parametrize("body", ["HC2", "Ant0"])
def test_seed_and_reset_forget_the_past(body: str):
    env = make_vec(body, 3, seed=7, max_steps=SHORT)
    first = rollout(env)
    second = rollout(env)
    client = env.simulation.clients[0]
    pybullet.setGravity(0, 0, -1, physicsClientId=client.client)  # no trick is remembered either
    env.seed(7)
    np.testing.assert_array_equal(rollout(env), first)
    np.testing.assert_array_equal(rollout(make_vec(body, 3, seed=7, max_steps=SHORT)), first)
    assert np.abs(second - first).max() > 0.1  # without a seed the streams go on
    assert np.abs(rollout(make_vec(body, 3, seed=8, max_steps=SHORT)) - first).max() > 0.1


@pytest.mark.parametrize("body", ["HC0", "Ant6"])
def test_another_process_computes_the_same_bits(body: str):
    code = f"from tests.physics.test_vec_env import digest; print(digest({body!r}))"
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=REPO, capture_output=True, text=True, check=True
    )
    assert result.stdout.split()[-1] == digest(body)


def test_environments_do_not_depend_on_their_number():
    one, three = (rollout(make_vec("HC0", n, seed=3, max_steps=SHORT)) for n in (1, 3))
    np.testing.assert_array_equal(three[:, :1], one)
    assert np.abs(three[:, 0] - three[:, 1]).max() > 0.1


def test_single_environment_is_the_same_simulation():
    batched = make_vec("Ant2", 1)
    single = SingleEnv("Ant2")
    single.reset(seed=0)
    single.np_random = np.random.default_rng(np.random.SeedSequence(0).spawn(1)[0])
    np.testing.assert_array_equal(single.reset()[0], batched.reset()[0])
    for action in np.random.default_rng(0).uniform(-1, 1, (50, 8)).astype(np.float32):
        observation, reward, ended, *_ = single.step(action)
        observations, rewards, dones, _ = batched.step(action[None])
        np.testing.assert_array_equal(observation, observations[0])
        assert np.float32(reward) == rewards[0]
        assert ended == dones[0]


@pytest.mark.parametrize("body", ["HC0", "Ant0"])
def test_shapes_types_and_ownership(body: str):
    env = make_vec(body, 2)
    before = env.reset()
    kept = before.copy()
    observations, rewards, dones, infos = env.step(np.zeros((2, env.action_space.shape[0])))
    assert observations.shape == (2, *env.observation_space.shape)
    assert observations.dtype == rewards.dtype == np.float32
    assert rewards.shape == (2,)
    assert dones.dtype == bool
    assert infos == [{}, {}]
    np.testing.assert_array_equal(before, kept)  # a step leaves earlier arrays alone
    assert env.observation_space.contains(observations[0])


def test_time_limit_is_no_termination():
    env = make_vec("HC0", 2, max_steps=5)
    env.reset()
    for _ in range(4):
        last, _, dones, infos = env.step(np.ones((2, 6)))
        assert not dones.any()
    observations, _, dones, infos = env.step(np.ones((2, 6)))
    assert dones.all()
    for index, info in enumerate(infos):
        assert info["TimeLimit.truncated"] is True
        assert info["episode"]["l"] == 5
        terminal = info["terminal_observation"]
        # The terminal observation goes on from the last one, the returned one starts anew.
        assert np.abs(terminal - last[index]).max() < 3
        assert np.abs(terminal[8:20:2] - last[index][8:20:2]).max() < 0.5
        np.testing.assert_array_equal(observations[index][9:20:2], 0)  # at rest
        assert np.abs(terminal[9:20:2]).max() > 0.1
    assert env.step(np.ones((2, 6)))[3] == [{}, {}]


def test_an_ant_that_falls_terminates_and_a_cheetah_does_not():
    env = make_vec("Ant0", 2)
    env.reset()
    fall(env, 1)
    _, rewards, dones, infos = env.step(np.zeros((2, 8)))
    assert dones.tolist() == [False, True]
    assert infos[1]["TimeLimit.truncated"] is False
    assert infos[1]["episode"]["upright"] == 0
    assert infos[0] == {}
    at_limit = make_vec("Ant0", 1, max_steps=1)
    at_limit.reset()
    fall(at_limit)
    assert at_limit.step(np.zeros((1, 8)))[3][0]["TimeLimit.truncated"] is False

    cheetah = make_vec("HC0", 1)
    cheetah.reset()
    simulator = cheetah.simulation.clients[0]
    pybullet.resetJointState(simulator.robot, 2, math.pi / 2, physicsClientId=simulator.client)
    fallen, dones = [], []
    for _ in range(5):
        _, rewards, done, _ = cheetah.step(np.zeros((1, 6)))
        fallen.append(rewards[0] < 0)
        dones.append(done[0])
    assert any(fallen)
    assert not any(dones)


def test_episode_tells_return_length_and_speed():
    steps = 60
    env = make_vec("HC0", 1, seed=1, max_steps=steps)
    env.reset()
    simulator = env.simulation.clients[0]
    start, total = simulator.read().parts[0][0], 0.0
    rng = np.random.default_rng(0)
    for _ in range(steps):
        end = simulator.read().parts[0][0]  # before the last step, after which it is reset
        _, rewards, dones, infos = env.step(rng.uniform(-1, 1, (1, 6)))
        total += float(rewards[0])
    assert dones[0]
    episode = infos[0]["episode"]
    assert episode["r"] == pytest.approx(total, rel=1e-5)
    assert episode["l"] == steps
    assert abs(end - start) > 0.05
    assert episode["speed_m_s"] == pytest.approx(
        (end - start) / (steps * BulletBody.control_step_s), abs=0.1
    )
    assert episode["t"] > 0


def test_episode_tells_the_share_of_steps_upright():
    env = make_vec("HC0", 1, max_steps=40)
    env.reset()
    bonuses = []
    for step in range(40):
        if step == 20:  # on its back from here on: the progress of a step is small against 2
            simulator = env.simulation.clients[0]
            pybullet.resetJointState(simulator.robot, 2, 2.0, physicsClientId=simulator.client)
        observations, _, _, infos = env.step(np.zeros((1, 6)))
        last = infos[0].get("terminal_observation", observations[0])
        bonuses.append(abs(last[7]) < 1.0)
    assert infos[0]["episode"]["upright"] <= np.mean(bonuses) < 1
    assert infos[0]["episode"]["upright"] > 0


def test_actions_beyond_one_cost_more_but_pull_no_harder():
    one, five = make_vec("HC0", 1), make_vec("HC0", 1)
    one.reset()
    five.reset()
    action = np.array([[1, -1, 1, -1, 1, -1]], dtype=np.float32)
    observation, reward, *_ = one.step(action)
    stronger, lower, *_ = five.step(5 * action)
    np.testing.assert_array_equal(observation, stronger)
    assert lower[0] < reward[0] - 0.1 * (25 - 1) + 1e-3  # the stall cost alone


def test_exploded_physics_end_the_episode():
    env = make_vec("HC0", 1)
    env.reset()
    task, state = env.simulation.tasks[0], env.simulation.clients[0].read()
    broken = state._replace(velocity=(math.nan, 0.0, 0.0), parts=[(math.nan,) * 3] * 5)
    observation, reward, ended = task.step([0.0] * 6, broken)
    assert ended
    assert observation == [0.0] * 26
    assert reward == -1.0
    assert math.isfinite(task.way_m)
    assert np.isfinite(env.reset()).all()
    assert np.isfinite(env.step(np.zeros((1, 6)))[0]).all()


def test_bad_input_is_refused_before_anything_moves():
    env = make_vec("HC0", 2)
    with pytest.raises(SilemError, match="step before reset"):
        env.step(np.zeros((2, 6)))
    before = env.reset()
    with pytest.raises(SilemError, match=r"actions of shape \(2, 5\); expected \(2, 6\)"):
        env.step(np.zeros((2, 5)))
    with pytest.raises(SilemError, match="NaN or infinity"):
        env.step(np.array([[0] * 6, [0] * 5 + [np.nan]]))
    with pytest.raises(SilemError, match="NaN or infinity"):
        env.step(np.full((2, 6), np.inf))
    with pytest.raises(SilemError, match="not numbers"):
        env.step([["a"] * 6] * 2)
    height = [simulator.read().parts[0][2] for simulator in env.simulation.clients]
    assert height == pytest.approx([0.7, 0.7])
    assert np.isfinite(before).all()
    for argument in ({"n_envs": 0}, {"n_envs": 1.5}, {"max_steps": 0}, {"seed": -1}):
        with pytest.raises(SilemError, match=next(iter(argument))):
            make_vec("HC0", **argument)
    with pytest.raises(SilemError, match="unknown body 'HC7'; allowed: HC0"):
        make_vec("HC7")
    with pytest.raises(SilemError, match="'Humanoid' is simulated by mujoco, not by bullet"):
        bodies.of_kind("Humanoid", BulletBody)
    with pytest.raises(SilemError, match="unknown simulator 'gymnasium'; allowed: bullet, mujoco"):
        BatchedEnv("Pendulum-v1")


def test_clients_are_given_back():
    def connected() -> int:
        return sum(pybullet.isConnected(client) for client in range(64))

    before = connected()
    env = make_vec("HC0", 2)
    env.reset()
    assert connected() == before + 2
    env.close()
    env.close()
    assert connected() == before
    assert env.reset().shape == (2, 26)  # a closed environment can be used again
    del env  # nor is one lost that nobody closes
    assert connected() == before
