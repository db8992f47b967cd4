"""N PyBullet clients behind one stable-baselines3 VecEnv."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from silem import bodies
from silem.bodies import Body, BulletBody
from silem.envs.base import MAX_STEPS, BatchedEnv
from silem.envs.bullet.camera import Camera
from silem.envs.bullet.simulator import Simulator
from silem.envs.bullet.task import OBSERVATION_BOUND, LocomotionTask, as_observations

JOINT_NOISE_RAD = 0.1  # joints start within +- this of the model's pose


def spaces(body: BulletBody) -> tuple[gymnasium.spaces.Box, gymnasium.spaces.Box]:
    """Return a body's observation space and action space."""
    observation = gymnasium.spaces.Box(
        -OBSERVATION_BOUND, OBSERVATION_BOUND, (body.observation_size,), np.float32
    )
    return observation, gymnasium.spaces.Box(-1.0, 1.0, (body.action_size,), np.float32)


def start_angles(generator: np.random.Generator, body: BulletBody) -> list[float]:
    """Draw (J,) joint angles in rad for an episode's start."""
    angles = generator.uniform(-JOINT_NOISE_RAD, JOINT_NOISE_RAD, body.action_size)
    return angles.tolist()


class BulletVecEnv(BatchedEnv):
    """E PyBullet clients with the same body, stepped in turn in one process.

    `speed_m_s` of an episode is the torso's mean forward speed. A `reset()` after `seed(s)` builds
    all clients afresh.

    Attributes:
        body: The body.
        simulators: The E simulators; empty before the first `reset` and after `close`.
    """

    def __init__(
        self,
        body: Body | str,
        n_envs: int = 4,
        seed: int = 0,
        max_steps: int = MAX_STEPS,
        render_mode: str | None = "rgb_array",
    ) -> None:
        """Make the environments; the clients are built by the first `reset`.

        Args:
            body: A body or its name.
            n_envs: E, at least 1.
            seed: Root of all environments' random streams.
            max_steps: Steps after which an episode is cut off.
            render_mode: "rgb_array" or None.

        Raises:
            SilemError: If an argument is not allowed.
        """
        self.body = bodies.of_kind(body, BulletBody)
        self.render_mode = render_mode
        self.simulators: list[Simulator] = []
        super().__init__(n_envs, spaces(self.body), seed, max_steps)

    def reset(self) -> np.ndarray:
        """Start a new episode in every environment.

        Returns:
            (E, O) first observations, float32.
        """
        if self._next_generators or not self.simulators:
            self._rebuild()
        self.reset_infos = [{} for _ in range(self.num_envs)]
        self._actions = None
        return np.stack([self._begin(index) for index in range(self.num_envs)])

    def step_wait(self) -> VecEnvStepReturn:
        """Step every environment by one control step.

        Returns:
            Observations (E, O) and rewards (E,), float32, dones (E,) and E infos.

        Raises:
            SilemError: If the environments were not reset, or there is no action.
        """
        actions = self._take_actions().tolist()
        # One kind of work after the other, so that its code is still in the processor's caches.
        for simulator, action in zip(self.simulators, actions, strict=True):
            simulator.advance(action)
        states = [simulator.read() for simulator in self.simulators]
        moves = zip(self._tasks, actions, states, strict=True)
        results = [task.step(action, state) for task, action, state in moves]
        raw_observations, rewards, dones = zip(*results, strict=True)
        observations = as_observations(raw_observations)
        infos: list[dict[str, Any]] = [{} for _ in dones]
        if True in dones:
            for index in np.flatnonzero(dones).tolist():
                infos[index] = self._last_info(index, observations[index].copy())
                observations[index] = self._begin(index)
        return observations, np.array(rewards, dtype=np.float32), np.array(dones), infos

    def close(self) -> None:
        """Disconnect all clients; closing twice is allowed."""
        for simulator in self.simulators:
            simulator.close()
        self.simulators, self._camera = [], None

    def _is_reset(self) -> bool:
        return bool(self.simulators)

    def _make_camera(self) -> Camera:
        return Camera(self.simulators[0], *self.picture_size)

    def _rebuild(self) -> None:
        """Build all clients afresh, with the random streams of the latest seed."""
        self.close()
        self._generators = self._next_generators or self._generators
        self._next_generators = []
        self.simulators = [Simulator(self.body) for _ in range(self.num_envs)]
        self._tasks = [
            LocomotionTask(self.body, sim.limits, self.max_steps) for sim in self.simulators
        ]

    def _begin(self, index: int) -> np.ndarray:
        """Start an episode of one environment and return its first observation (O,)."""
        angles = start_angles(self._generators[index], self.body)
        state = self.simulators[index].reset(angles)
        return as_observations(self._tasks[index].begin(state))

    def _last_info(self, index: int, observation: np.ndarray) -> dict[str, Any]:
        """Return the info of an episode that has just ended with this observation (O,)."""
        task = self._tasks[index]
        return {
            "terminal_observation": observation,
            "TimeLimit.truncated": not task.terminated,
            "episode": task.summary() | {"t": self._since_built_s()},
        }
