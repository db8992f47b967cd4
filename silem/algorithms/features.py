"""Where the learner's skeletal features g(s) come from (Section V)."""

from __future__ import annotations

from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from silem.util.errors import SilemError

INFO_KEY = "skeletal_features"


class LearnerFeatures:
    """g for the learner: its observation, or what the env's ``info`` holds beside it.

    An environment that supplies ``info["skeletal_features"]`` (F,) from ``reset`` and ``step``
    has a g of its own; for every other environment g is the identity.

    Args:
        n_features: F of the demonstrations, which the learner's must equal.
    """

    def __init__(self, n_features: int) -> None:
        self.n_features = n_features

    def first(self, env: VecEnv, observations: Any) -> np.ndarray:
        """Return the features (E, F) of the states the environments are in after a reset."""
        infos = env.unwrapped.reset_infos
        return np.stack([self._of(observations[i], infos[i]) for i in range(env.num_envs)])

    def reached(
        self, env: VecEnv, observations: Any, dones: np.ndarray, infos: list[dict[str, Any]]
    ) -> tuple[np.ndarray, dict[int, np.ndarray]]:
        """Return the features a step led to.

        Args:
            env: The environments.
            observations: What they returned, (E, O): a new episode's first where one ended.
            dones: Which episodes ended, (E,).
            infos: Their infos.

        Returns:
            Features (E, F) of the states reached, terminal ones included, and per environment
            whose episode ended the features (F,) of the new episode's first state.
        """
        ended = np.flatnonzero(dones).tolist()
        if INFO_KEY in infos[0]:
            reached = np.array([info[INFO_KEY] for info in infos], dtype=np.float32)
        else:
            reached = np.array(observations, dtype=np.float32)
            for i in ended:
                reached[i] = infos[i]["terminal_observation"]
        resets = env.unwrapped.reset_infos
        first = {i: self._of(observations[i], resets[i]) for i in ended}
        return self._checked(reached.reshape(len(dones), -1)), first

    def _of(self, observation: Any, info: dict[str, Any]) -> np.ndarray:
        features = info.get(INFO_KEY)
        chosen = observation if features is None else features
        return self._checked(np.asarray(chosen, dtype=np.float32).reshape(-1))

    def _checked(self, features: np.ndarray) -> np.ndarray:
        if features.shape[-1] != self.n_features:
            raise SilemError(
                f"the demonstrations have {self.n_features} features per state, the learner's "
                f"environment supplies {features.shape[-1]}; both need the same features g(s)"
            )
        return features
