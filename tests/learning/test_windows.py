"""Windows at episode boundaries, by hand."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3.common.vec_env import DummyVecEnv

from silem import SILEM, SilemError
from silem.algorithms.gaifo import LearnerFeatures, episode_windows


def test_episode_windows_by_hand() -> None:
    features = np.array([[10.0], [11.0], [12.0], [13.0], [14.0]])
    expected = [[10, 10, 10, 11], [10, 10, 11, 12], [10, 11, 12, 13], [11, 12, 13, 14]]
    np.testing.assert_array_equal(episode_windows(features, 4)[:, :, 0], expected)


class Counter(gym.Env):
    """Observes (episode, steps into it); episodes last three steps, then truncate."""

    observation_space = gym.spaces.Box(-1e6, 1e6, (2,))
    action_space = gym.spaces.Box(-1, 1, (1,))

    def __init__(self) -> None:
        self.episode, self.steps = 0, 0

    def _observation(self) -> np.ndarray:
        return np.array([self.episode, self.steps], dtype=np.float32)

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple:
        super().reset(seed=seed)
        self.episode, self.steps = self.episode + 1, 0
        return self._observation(), {}

    def step(self, action: np.ndarray) -> tuple:
        self.steps += 1
        return self._observation(), 0.0, False, self.steps == 3, {}


class CounterWithFeatures(Counter):
    """The same, with skeletal features of its own: minus the observation, and a constant."""

    def _info(self) -> dict:
        return {"skeletal_features": np.append(-self._observation(), 7.0)}

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple:
        return super().reset(seed=seed)[0], self._info()

    def step(self, action: np.ndarray) -> tuple:
        return *super().step(action)[:4], self._info()


def collected_windows(env: type[gym.Env], n_features: int, n_iterations: int) -> np.ndarray:
    demos = [np.zeros((5, n_features), dtype=np.float32)]
    model = SILEM(
        "MlpPolicy", DummyVecEnv([env]), demos, n_steps=5, batch_size=5, n_disc_updates=5, seed=0
    )
    model.learn(5 * n_iterations)
    return model._windows[:, 0]


def test_windows_stop_at_episode_ends_and_go_on_over_rollouts() -> None:
    """Rollouts of 5 steps over episodes of 3: the second rollout begins within an episode."""
    episodes_and_steps = collected_windows(Counter, 2, n_iterations=2)
    expected = [
        [(2, 0), (2, 1), (2, 2), (2, 3)],  # its states before the rollout are remembered
        [(3, 0), (3, 0), (3, 0), (3, 1)],
        [(3, 0), (3, 0), (3, 1), (3, 2)],
        [(3, 0), (3, 1), (3, 2), (3, 3)],  # the terminal state itself ends a window
        [(4, 0), (4, 0), (4, 0), (4, 1)],
    ]
    np.testing.assert_array_equal(episodes_and_steps, expected)


def test_rollouts_windows_equal_those_of_the_whole_episode() -> None:
    """What is built step by step in two environments, and what is cut from an episode at once."""
    env = DummyVecEnv([lambda: gym.make("Pendulum-v1")] * 2)
    demos = [np.zeros((5, 3), dtype=np.float32)]
    model = SILEM("MlpPolicy", env, demos, n_steps=9, batch_size=9, seed=0).learn(18)
    episodes = [*model.rollout_buffer.observations, model._last_obs]
    for environment in range(2):
        expected = episode_windows(np.array([states[environment] for states in episodes]), 4)
        np.testing.assert_array_equal(model._windows[:, environment], expected)


def test_features_of_the_environment_replace_the_observation() -> None:
    windows = collected_windows(CounterWithFeatures, 3, n_iterations=1)
    plain = collected_windows(Counter, 2, n_iterations=1)
    np.testing.assert_array_equal(windows[..., :2], -plain)
    assert (windows[..., 2] == 7.0).all()


def test_other_feature_width_is_refused() -> None:
    with pytest.raises(SilemError, match=r"3 features per state.*supplies 2"):
        collected_windows(Counter, 3, n_iterations=1)


class Diverging(Counter):
    """From its second episode on it observes what is not a number."""

    def step(self, action: np.ndarray) -> tuple:
        observation, *rest = super().step(action)
        return observation * (np.nan if self.episode == 2 else 1.0), *rest


def test_features_that_are_not_numbers_stop_the_training() -> None:
    model = SILEM(
        "MlpPolicy",
        DummyVecEnv([Diverging]),
        [np.zeros((5, 2))],
        n_steps=6,
        batch_size=6,
        n_disc_updates=6,
        seed=0,
    )
    before = model.state_arrays()
    with pytest.raises(SilemError, match="skeletal features hold NaN"):
        model.learn(6)
    for name, array in model.state_arrays().items():
        np.testing.assert_array_equal(array, before[name])


def test_features_of_ended_episodes_are_the_last_states() -> None:
    """Two environments out of step: one batch holds a terminal and a running state."""
    env = DummyVecEnv([CounterWithFeatures, CounterWithFeatures])
    env.reset()
    env.envs[1].steps = 1
    of_learner = LearnerFeatures(3)
    of_learner.first(env, np.zeros((2, 2)))
    observations = np.zeros((2, 2))
    for _ in range(2):
        observations, _, dones, infos = env.step(np.zeros((2, 1)))
    reached, first = of_learner.reached(env, observations, dones, infos)
    assert dones.tolist() == [False, True]
    np.testing.assert_array_equal(reached, [[-1, -2, 7], [-1, -3, 7]])
    assert list(first) == [1]
    np.testing.assert_array_equal(first[1], [-2, 0, 7])
