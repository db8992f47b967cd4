"""Observation and reward equal those of PyBullet's own tasks, as the public package has them."""

from __future__ import annotations

import gymnasium
import numpy as np
import pybullet_envs_gymnasium  # noqa: F401  registers the public environments
import pytest

from silem.envs import SingleEnv

PEERS = {"HC0": "HalfCheetahBulletEnv-v0", "Ant0": "AntBulletEnv-v0"}
STEPS = 300


def public_env(name: str, seed: int) -> tuple[gymnasium.Env, np.ndarray]:
    """The public environment at its second reset.

    Its first reset lacks the floor among the parts whose mean place measures progress.
    """
    env = gymnasium.make(name, disable_env_checker=True).unwrapped
    env.reset(seed=seed)
    env._p.setPhysicsEngineParameter(deterministicOverlappingPairs=1)
    return env, env.reset(seed=seed)[0]


def largest_differences(ours: str, peer: str, seed: int) -> tuple[float, float, bool]:
    """Largest difference of observations and of rewards, and whether all ends agree."""
    theirs, their_observation = public_env(peer, seed)
    env = SingleEnv(ours)
    observation, _ = env.reset(seed=seed)
    observations, rewards, ends = [np.abs(observation - their_observation).max()], [], []
    rng = np.random.default_rng(seed)
    for _ in range(STEPS):
        action = rng.uniform(-1.5, 1.5, env.action_space.shape).astype(np.float32)
        observation, reward, ended, *_ = env.step(action)
        their_observation, their_reward, they_ended, *_ = theirs.step(action)
        observations.append(np.abs(observation - their_observation).max())
        rewards.append(abs(reward - their_reward))
        ends.append(ended == they_ended)
    theirs.close()
    env.close()
    return float(max(observations)), float(max(rewards)), all(ends)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("body", list(PEERS))
def test_parity_over_300_steps(body: str, seed: int):
    observation, reward, ends_agree = largest_differences(body, PEERS[body], seed)
    assert observation <= 1e-5
    assert reward <= 1e-5
    assert ends_agree


def test_another_body_is_told_apart():
    observation, reward, _ = largest_differences("HC1", PEERS["HC0"], 0)
    assert observation > 0.1
    assert reward > 0.1
