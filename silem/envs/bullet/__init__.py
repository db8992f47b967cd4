"""Bodies that PyBullet steps: E clients behind one stable-baselines3 VecEnv, or one by itself."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from silem.bodies import BulletBody
from silem.envs.base import BatchedEnv, Filmed, SingleEnv
from silem.envs.bullet.simulator import Simulator, start_angles
from silem.envs.bullet.task import LocomotionTask, as_observations, observation_space


class _Runner(Filmed):
    """What both have: clients with a body in each, and its task.

    Attributes:
        simulators: The clients; none before the first `reset` and after `close`.
    """

    body: BulletBody
    simulators: Sequence[Simulator] = ()
    _kind = BulletBody
    _space = staticmethod(observation_space)

    def _build(self, n: int, max_steps: float = math.inf) -> None:
        self.simulators = [Simulator(self.body) for _ in range(n)]
        limits = self.simulators[0].limits
        self._tasks = [LocomotionTask(self.body, limits, max_steps) for _ in range(n)]

    def _start(self, generator: np.random.Generator, index: int = 0) -> np.ndarray:
        """Start an episode and return its first observation (O,)."""
        state = self.simulators[index].reset(start_angles(generator, self.body))
        return as_observations(self._tasks[index].begin(state))

    def _qpos(self) -> np.ndarray:
        return self.simulators[0].qpos()

    def close(self) -> None:
        """Disconnect all clients; closing twice is allowed."""
        super().close()
        for simulator in self.simulators:
            simulator.close()
        self.simulators = ()


class BulletEnv(_Runner, SingleEnv):
    """One body on its track; the simulator is built by the first `reset`."""

    def _begin(self) -> tuple[np.ndarray, dict[str, Any]]:
        if not self.simulators:
            self._build(1)
        return self._start(self.np_random), {}

    def _advance(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, dict[str, Any]]:
        row, simulator = action.tolist(), self.simulators[0]
        simulator.advance(row)
        observation, reward, fallen = self._tasks[0].step(row, simulator.read())
        return as_observations(observation), reward, fallen, {}


class BulletVecEnv(_Runner, BatchedEnv):
    """E PyBullet clients with the same body, stepped in turn in one process.

    `speed_m_s` of an episode is the torso's mean forward speed. A `reset()` after `seed(s)` builds
    all clients afresh.
    """

    def _restart(self, is_seeded: bool) -> np.ndarray:
        if is_seeded or not self.simulators:
            self.close()
            self._build(self.num_envs, self.max_steps)
        self.reset_infos = [{} for _ in range(self.num_envs)]
        return np.stack([self._start(g, index) for index, g in enumerate(self._generators)])

    def _advance(self, actions: np.ndarray) -> VecEnvStepReturn:
        rows = actions.tolist()
        # One kind of work after the other, so that its code is still in the processor's caches.
        for simulator, action in zip(self.simulators, rows, strict=True):
            simulator.advance(action)
        states = [simulator.read() for simulator in self.simulators]
        moves = zip(self._tasks, rows, states, strict=True)
        results = [task.step(action, state) for task, action, state in moves]
        raw_observations, rewards, dones = zip(*results, strict=True)
        observations = as_observations(raw_observations)
        infos: list[dict[str, Any]] = [{} for _ in dones]
        if True in dones:
            for index in np.flatnonzero(dones).tolist():
                task, last = self._tasks[index], observations[index].copy()
                infos[index] = self._last_info(last, task.terminated, task.summary())
                observations[index] = self._start(self._generators[index], index)
        return observations, np.array(rewards, dtype=np.float32), np.array(dones), infos
