"""E humanoids that learn to walk, behind one stable-baselines3 VecEnv."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from silem.bodies import Body, MujocoBody
from silem.envs.base import MAX_STEPS, BatchedEnv
from silem.envs.mujoco import task as walking
from silem.envs.mujoco.camera import MujocoCamera
from silem.envs.mujoco.simulator import Simulation, StartStates, body_of, start_state
from silem.envs.mujoco.task import Reading
from silem.motion.features import FEATURES, skeletal_features
from silem.util.errors import SilemError


def spaces(body: MujocoBody) -> tuple[gymnasium.spaces.Box, gymnasium.spaces.Box]:
    """Return a body's observation space and action space."""
    size = (walking.observation_size(body),)
    observation = gymnasium.spaces.Box(-np.inf, np.inf, size, np.float32)
    return observation, gymnasium.spaces.Box(-1.0, 1.0, (body.action_size,), np.float32)


class MujocoVecEnv(BatchedEnv):
    """E humanoids with the same body that learn to walk.

    Skeletal features g(s) (F,) are in the infos of `reset` and `step` under "skeletal_features".
    An episode ends when the head is below the body's `fall_head_m`. `speed_m_s` of an episode is
    the straight distance covered over the time it took; `upright` is the share of `max_steps`
    that passed before a fall.

    Attributes:
        body: The body.
        simulation: The E states; None after `close`.
        skeletal_features: g(s) of the states that the last step reached, (E, F); where an episode
            ended, the last state's.
    """

    def __init__(
        self,
        body: Body | str,
        n_envs: int = 4,
        seed: int = 0,
        max_steps: int = MAX_STEPS,
        *,
        n_threads: int = 1,
        speed_m_s: float = walking.DEMONSTRATOR_SPEED_M_S,
        starts: StartStates | None = None,
        render_mode: str | None = "rgb_array",
    ) -> None:
        """Make the environments.

        Args:
            body: A body or its name.
            n_envs: E, at least 1.
            seed: Root of all environments' random streams.
            max_steps: Steps after which an episode is cut off.
            n_threads: Threads that step the simulations; results do not depend on it.
            speed_m_s: Speed that earns the full reward.
            starts: States that episodes start from; None means the standing pose, small noise.
            render_mode: "rgb_array" or None.

        Raises:
            SilemError: If an argument is not allowed.
        """
        self.body = body_of(body)
        self.render_mode = render_mode
        if n_threads < 1 or speed_m_s <= 0:
            raise SilemError(f"{n_threads} threads, {speed_m_s} m/s: both must be above 0")
        self._speed_m_s, self._starts = speed_m_s, starts
        self._has_episodes = False
        super().__init__(n_envs, spaces(self.body), seed, max_steps)
        self.simulation = Simulation(self.body, self.num_envs, min(n_threads, self.num_envs))
        self._length = np.zeros(self.num_envs, dtype=int)
        self._return = np.zeros(self.num_envs)
        self._start_xy = np.zeros((self.num_envs, 2))
        self.skeletal_features = np.zeros((self.num_envs, len(FEATURES)), dtype=np.float32)

    def reset(self) -> np.ndarray:
        """Start a new episode in every environment.

        Returns:
            (E, O) first observations, float32.
        """
        if self._next_generators:
            self._generators, self._next_generators = self._next_generators, []
        for index in range(self.num_envs):
            self._begin(index)
        self._actions, self._has_episodes = None, True
        reading = self.simulation.read()
        self.skeletal_features = features_of(reading)
        self.reset_infos = [{"skeletal_features": row} for row in self.skeletal_features]
        return walking.observe(reading, self.skeletal_features)

    def step_wait(self) -> VecEnvStepReturn:
        """Step every environment by one control step.

        Returns:
            Observations (E, O) and rewards (E,), float32, dones (E,) and E infos.

        Raises:
            SilemError: If the environments were not reset, or there is no action.
        """
        actions = self._take_actions().clip(-1.0, 1.0)
        failed = np.array(self.simulation.advance(actions))
        reading = self.simulation.read()
        rewards = walking.rewards(reading, actions, self.body.standing_head_m, self._speed_m_s)
        rewards[failed] = 0.0
        self.skeletal_features = features_of(reading)
        observations = walking.observe(reading, self.skeletal_features)
        self._length += 1
        self._return += rewards
        fallen = failed | (reading.head_m < self.body.fall_head_m)
        dones = fallen | (self._length >= self.max_steps)
        infos = [{"skeletal_features": row} for row in self.skeletal_features]
        if dones.any():
            self._end(reading, observations, fallen, dones, infos)
        return observations, rewards.astype(np.float32), dones, infos

    def _end(
        self,
        reading: Reading,
        observations: np.ndarray,
        fallen: np.ndarray,
        dones: np.ndarray,
        infos: list[dict[str, Any]],
    ) -> None:
        """Fill in the infos of episodes that ended, and start the next ones in their place."""
        ended = np.flatnonzero(dones).tolist()
        for index in ended:
            seconds = self._length[index] * self.body.control_step_s
            way = reading.qpos[index, :2] - self._start_xy[index]
            infos[index] |= {
                "terminal_observation": observations[index].copy(),
                "TimeLimit.truncated": not fallen[index],
                "episode": {
                    "r": float(self._return[index]),
                    "l": int(self._length[index]),
                    "t": self._since_built_s(),
                    "speed_m_s": float(np.hypot(*way) / seconds),
                    "upright": float(self._length[index] / self.max_steps),
                },
            }
            self._begin(index)
        fresh = self.simulation.read(ended)
        features = features_of(fresh)
        observations[ended] = walking.observe(fresh, features)
        for index, row in zip(ended, features, strict=True):
            self.reset_infos[index] = {"skeletal_features": row}

    def _begin(self, index: int) -> None:
        """Start an episode in one environment."""
        qpos, qvel = start_state(self._generators[index], self.body, self._starts)
        self.simulation.place(index, qpos, qvel)
        self._length[index], self._return[index], self._start_xy[index] = 0, 0.0, qpos[:2]

    def _is_reset(self) -> bool:
        return self._has_episodes

    def _make_camera(self) -> MujocoCamera:
        return MujocoCamera(self.simulation, *self.picture_size)

    def close(self) -> None:
        """End the threads and the renderer; closing twice is allowed."""
        self.simulation.close()
        if isinstance(self._camera, MujocoCamera):
            self._camera.close()
        self._camera = None


def features_of(reading: Reading) -> np.ndarray:
    """Return the skeletal features (E, F) of what a simulation holds."""
    return skeletal_features(reading.points, reading.torso_axes, reading.com_velocity)
