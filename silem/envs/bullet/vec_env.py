"""E PyBullet clients behind one stable-baselines3 VecEnv."""

from __future__ import annotations

from typing import Any

import numpy as np
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from silem.bodies import Body, BulletBody
from silem.envs.base import BatchedEnv
from silem.envs.bullet.camera import Camera
from silem.envs.bullet.simulator import Simulator, body_of, start_angles
from silem.envs.bullet.task import LocomotionTask, as_observations, observation_space


class BulletVecEnv(BatchedEnv):
    """E PyBullet clients with the same body, stepped in turn in one process.

    `speed_m_s` of an episode is the torso's mean forward speed. A `reset()` after `seed(s)` builds
    all clients afresh.

    Attributes:
        simulators: The E simulators; empty before the first `reset` and after `close`.
    """

    body: BulletBody

    def __init__(
        self,
        body: Body | str,
        n_envs: int = 4,
        seed: int = 0,
        max_steps: int | None = None,
        render_mode: str | None = "rgb_array",
    ) -> None:
        """Make the environments; the clients are built by the first `reset`.

        Args:
            body: A body or its name.
            n_envs: E, at least 1.
            seed: Root of all environments' random streams.
            max_steps: Steps after which an episode is cut off; None means the body's.
            render_mode: "rgb_array" or None.

        Raises:
            SilemError: If an argument is not allowed.
        """
        learner = body_of(body)
        self.simulators: list[Simulator] = []
        space = observation_space(learner)
        super().__init__(learner, space, n_envs, seed, max_steps, render_mode)

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

    def close(self) -> None:
        """Disconnect all clients; closing twice is allowed."""
        super().close()
        for simulator in self.simulators:
            simulator.close()
        self.simulators = []

    def _is_reset(self) -> bool:
        return bool(self.simulators)

    def _make_camera(self) -> Camera:
        return Camera(self.simulators[0], *self.picture_size)

    def _begin(self, index: int) -> np.ndarray:
        """Start an episode of one environment and return its first observation (O,)."""
        angles = start_angles(self._generators[index], self.body)
        state = self.simulators[index].reset(angles)
        return as_observations(self._tasks[index].begin(state))
