"""A point mass on a line, the smallest thing that can imitate an expert."""

from __future__ import annotations

import gymnasium as gym
import numpy as np


class PointMass(gym.Env):
    """A point on a line that observes place and speed; the expert moves at constant speed."""

    observation_space = gym.spaces.Box(-np.inf, np.inf, (2,))
    action_space = gym.spaces.Box(-1, 1, (1,))

    def __init__(self) -> None:
        self.state = np.zeros(2, dtype=np.float32)

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple:
        super().reset(seed=seed)
        self.state, self.steps = np.zeros(2, dtype=np.float32), 0
        return self.state.copy(), {}

    def step(self, action: np.ndarray) -> tuple:
        self.state[1] = 0.8 * self.state[1] + 0.2 * float(action[0])
        self.state[0] = 0.9 * self.state[0] + 0.1 * self.state[1]
        self.steps += 1
        return self.state.copy(), float(self.state[1]), False, self.steps == 50, {}


def expert_of_point_mass() -> list[np.ndarray]:
    env = PointMass()
    states = [env.reset()[0]]
    for _ in range(50):
        states.append(env.step(np.array([1.0]))[0])
    return [np.array(states)]
