"""Humanoids that learn to walk: E behind one stable-baselines3 VecEnv, or one by itself."""

from __future__ import annotations

from typing import Any

import numpy as np
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from silem.bodies import MujocoBody
from silem.envs.base import BatchedEnv, Filmed, SingleEnv
from silem.envs.mujoco.simulator import Simulation, StartStates, start_state
from silem.envs.mujoco.task import Reading, observation_space, observe, rewards, target_speed
from silem.util.errors import SilemError


class _Walker(Filmed):
    """What both have: states that start somewhere, are stepped, and earn by their speed.

    Attributes:
        simulation: The states.
    """

    body: MujocoBody
    simulation: Simulation
    _kind = MujocoBody
    _space = staticmethod(observation_space)

    def _prepare(
        self,
        n: int,
        *,
        n_threads: int = 1,
        speed_m_s: float | None = None,
        starts: StartStates | None = None,
        **options: Any,
    ) -> None:
        super()._prepare(n, **options)
        if n_threads < 1:
            raise SilemError(f"{n_threads} threads; allowed: whole numbers from 1")
        self._speed_m_s, self._starts = target_speed(self.body, speed_m_s), starts
        self.simulation = Simulation(self.body, n, min(n, n_threads))

    def _qpos(self) -> np.ndarray:
        return self.simulation.qpos[0]

    def _move(self, actions: np.ndarray) -> tuple[Reading, np.ndarray, np.ndarray]:
        """Step by actions (E, A); return what is read, what is earned (E,), and who fell (E,)."""
        actions = actions.clip(-1.0, 1.0)
        failed = self.simulation.advance(actions)
        reading = self.simulation.read()
        earned = rewards(reading, actions, self.body.standing_head_m, self._speed_m_s)
        if np.count_nonzero(failed):
            earned[failed] = 0.0
        return reading, earned, failed | (reading.head_m < self.body.fall_head_m)


class MujocoEnv(_Walker, SingleEnv):
    """One humanoid that learns to walk; its options are `MujocoVecEnv`'s."""

    def _begin(self) -> tuple[np.ndarray, dict[str, Any]]:
        self.simulation.place(0, *start_state(self.np_random, self.body, self._starts))
        reading = self.simulation.read()
        features = reading.features()
        return observe(reading, features)[0], {"skeletal_features": features[0]}

    def _advance(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, dict[str, Any]]:
        reading, earned, fallen = self._move(action[None])
        features = reading.features()
        info = {"skeletal_features": features[0]}
        return observe(reading, features)[0], float(earned[0]), bool(fallen[0]), info


class MujocoVecEnv(_Walker, BatchedEnv):
    """E humanoids with the same body that learn to walk.

    Skeletal features g(s) (F,) are in the infos of `reset` and `step` under "skeletal_features".
    An episode ends when the head is below the body's `fall_head_m`. `speed_m_s` of an episode is
    the straight distance covered over the time it took; `upright` is the share of `max_steps`
    that passed before a fall.

    Args:
        n_threads: Threads that step the simulations; results do not depend on it.
        speed_m_s: Speed that earns the full reward; None means the body's.
        starts: States that episodes start from; None means the standing pose, small noise.
    """

    def _prepare(self, n: int, **options: Any) -> None:
        super()._prepare(n, **options)
        self._length, self._return = np.zeros(n, dtype=int), np.zeros(n)
        self._start_xy = np.zeros((n, 2))

    def _restart(self, is_seeded: bool) -> np.ndarray:
        self._begin(np.arange(self.num_envs))
        reading = self.simulation.read()
        features = reading.features()
        self.reset_infos = [{"skeletal_features": row} for row in features]
        return observe(reading, features)

    def _advance(self, actions: np.ndarray) -> VecEnvStepReturn:
        reading, earned, fallen = self._move(actions)
        self._length += 1
        self._return += earned
        dones = fallen | (self._length >= self.max_steps)
        ended = dones.nonzero()[0]
        lasts = [self._summary(reading, index) for index in ended.tolist()]
        if lasts:  # ended states and their successors in one go: what counts are NumPy's calls
            self._begin(ended)
            reading = reading.joined(self.simulation.read(ended))
        features = reading.features()
        observations = observe(reading, features)
        infos = [{"skeletal_features": row} for row in features[: self.num_envs]]
        for index, last, row in zip(ended.tolist(), lasts, features[self.num_envs :], strict=True):
            infos[index] |= self._last_info(observations[index].copy(), bool(fallen[index]), last)
            self.reset_infos[index] = {"skeletal_features": row}
        observations[ended] = observations[self.num_envs :]
        return observations[: self.num_envs], earned.astype(np.float32), dones, infos

    def _summary(self, reading: Reading, index: int) -> dict[str, Any]:
        """Sum up an environment's episode, which ends with its state in a reading."""
        seconds = self._length[index] * self.body.control_step_s
        way = reading.qpos[index, :2] - self._start_xy[index]
        return {
            "r": float(self._return[index]),
            "l": int(self._length[index]),
            "speed_m_s": float(np.hypot(*way) / seconds),
            "upright": float(self._length[index] / self.max_steps),
        }

    def _begin(self, indices: np.ndarray) -> None:
        """Start an episode in some environments."""
        states = [start_state(self._generators[i], self.body, self._starts) for i in indices]
        qpos, qvel = map(np.array, zip(*states, strict=True))
        self.simulation.place(indices, qpos, qvel)
        self._length[indices], self._return[indices] = 0, 0.0
        self._start_xy[indices] = qpos[:, :2]
