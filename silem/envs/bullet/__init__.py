"""Bodies that PyBullet steps: E clients behind one stable-baselines3 VecEnv, or one by itself."""

from __future__ import annotations

from typing import Any

import numpy as np
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from silem.bodies import BulletBody
from silem.envs.base import BatchedEnv, Filmed, SingleEnv
from silem.envs.bullet.simulator import Simulator, start_angles
from silem.envs.bullet.task import LocomotionTask, as_observations, observation_space


class _Runner(Filmed):
    """What both have: a body of PyBullet's."""

    body: BulletBody
    _kind = BulletBody
    _space = staticmethod(observation_space)


class BulletEnv(_Runner, SingleEnv):
    """One body on its track; the simulator is built by the first `reset`."""

    _simulator: Simulator | None = None

    def _begin(self) -> tuple[np.ndarray, dict[str, Any]]:
        if self._simulator is None:
            self._simulator = Simulator(self.body)
            self._task = LocomotionTask(self.body, self._simulator.limits)
        state = self._simulator.reset(start_angles(self.np_random, self.body))
        return as_observations(self._task.begin(state)), {}

    def _advance(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, dict[str, Any]]:
        assert self._simulator is not None
        row = action.tolist()
        self._simulator.advance(row)
        observation, reward, fallen = self._task.step(row, self._simulator.read())
        return as_observations(observation), reward, fallen, {}

    def _is_reset(self) -> bool:
        return self._simulator is not None

    def _qpos(self) -> np.ndarray:
        assert self._simulator is not None
        return self._simulator.qpos()

    def close(self) -> None:
        """Disconnect the simulator; closing twice is allowed."""
        super().close()
        if self._simulator is not None:
            self._simulator.close()
        self._simulator = None


class BulletVecEnv(_Runner, BatchedEnv):
    """E PyBullet clients with the same body, stepped in turn in one process.

    `speed_m_s` of an episode is the torso's mean forward speed. A `reset()` after `seed(s)` builds
    all clients afresh.

    Attributes:
        simulators: The E simulators; empty before the first `reset` and after `close`.
    """

    simulators: list[Simulator] = []  # noqa: RUF012  replaced, never changed

    def _restart(self, is_seeded: bool) -> np.ndarray:
        if is_seeded or not self.simulators:
            self.close()
            self.simulators = [Simulator(self.body) for _ in range(self.num_envs)]
            self._tasks = [
                LocomotionTask(self.body, sim.limits, self.max_steps) for sim in self.simulators
            ]
        self.reset_infos = [{} for _ in range(self.num_envs)]
        return np.stack([self._begin(index) for index in range(self.num_envs)])

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
                observations[index] = self._begin(index)
        return observations, np.array(rewards, dtype=np.float32), np.array(dones), infos

    def _begin(self, index: int) -> np.ndarray:
        """Start an episode of one environment and return its first observation (O,)."""
        angles = start_angles(self._generators[index], self.body)
        return as_observations(self._tasks[index].begin(self.simulators[index].reset(angles)))

    def _is_reset(self) -> bool:
        return bool(self.simulators)

    def _qpos(self) -> np.ndarray:
        return self.simulators[0].qpos()

    def close(self) -> None:
        """Disconnect all clients; closing twice is allowed."""
        super().close()
        for simulator in self.simulators:
            simulator.close()
        self.simulators = []
