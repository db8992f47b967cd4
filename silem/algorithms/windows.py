"""Windows o_t = (g(s_t), ..., g(s_t+n)) over skeletal features, never across an episode's end.

A window ends at the state a transition leads to, so its reward speaks of the action taken. The
first windows of an episode repeat its first state until there are enough states.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.wrappers import NormalizeObservation
from stable_baselines3.common.vec_env import VecEnv, unwrap_vec_normalize

from silem.util.errors import SilemError

INFO_KEY = "skeletal_features"


def episode_windows(features: np.ndarray, window: int) -> np.ndarray:
    """Cut an episode's features (T + 1, F) into windows (T, W, F); row t ends at state t + 1.

    Raises SilemError if the episode has fewer than two states or the window is not positive.
    """
    if window < 1:
        raise SilemError(f"window must be at least 1 state, got {window}")
    if features.ndim != 2 or len(features) < 2:
        raise SilemError(f"an episode needs (T + 1, F) features, T >= 1; got {features.shape}")
    last = np.arange(1, len(features))
    states = last[:, None] + np.arange(1 - window, 1)[None, :]
    return features[np.maximum(states, 0)]


def marked(windows: np.ndarray) -> np.ndarray:
    """Return windows (..., F) with one feature more, 0: no state of theirs is absorbing."""
    return np.concatenate([windows, np.zeros_like(windows[..., :1])], axis=-1)


def absorbing_windows(last: np.ndarray) -> np.ndarray:
    """Return the windows (W, W, F + 1) of an episode that has ended, after its last one, (W, F).

    It stays in the absorbing state, which has no features but a mark that tells it from all others
    (Kostrikov et al., 2019). Row k ends k + 1 states after the terminal one, and the last row
    holds the absorbing state alone, as all windows after it would.
    """
    states = np.concatenate([marked(last), np.zeros_like(marked(last))])
    states[len(last) :, -1] = 1.0
    return episode_windows(states, len(last))[-len(last) :]


class LearnerFeatures:
    """g for the learner: its observation, or what the environment's ``info`` holds beside it.

    Environments that supply ``info["skeletal_features"]`` (F,) from ``reset`` and ``step`` have a
    g of their own; for all others g is the identity. Which of the two holds is decided at the
    first reset, for all environments and for good. F must be that of the demonstrations.
    """

    def __init__(self, n_features: int) -> None:
        self.n_features = n_features
        self._in_infos: bool | None = None

    def first(self, env: VecEnv, observations: Any) -> np.ndarray:
        """Return the features (E, F) of the states the environments are in after a reset.

        Raises SilemError: features are of another width, come from some environments or calls only,
        or there are none: observations that are no arrays, or that change by themselves.
        """
        infos = env.unwrapped.reset_infos
        if self._in_infos is None:
            self._in_infos = any(INFO_KEY in info for info in infos)
        if not self._in_infos:
            _check_observations(env)
        return self._read(observations, infos, "reset", range(env.num_envs))

    def reached(
        self, env: VecEnv, observations: Any, dones: np.ndarray, infos: list[dict[str, Any]]
    ) -> tuple[np.ndarray, dict[int, np.ndarray]]:
        """Return the features (E, F) of the states a step led to, terminal ones included.

        With them, per environment whose episode ended, come the features (F,) of the new
        episode's first state. ``observations``, ``dones`` and ``infos`` are the step's. Raises as
        :meth:`first`.
        """
        ended = np.flatnonzero(dones).tolist()
        terminal = observations
        if ended and not self._in_infos:
            terminal = np.array(observations)
            for i in ended:
                terminal[i] = infos[i]["terminal_observation"]
        reached = self._read(terminal, infos, "step", range(len(dones)))
        if not ended:
            return reached, {}
        first = self._read(observations, env.unwrapped.reset_infos, "reset", ended)
        return reached, dict(zip(ended, first, strict=True))

    def _read(self, observations: Any, infos: Any, call: str, which: Sequence[int]) -> np.ndarray:
        """Return the features (len(which), F) of some environments."""
        for i in which:
            if (INFO_KEY in infos[i]) != self._in_infos:
                has = "lacks" if self._in_infos else "supplies"
                raise SilemError(
                    f"environment {i} {has} info[{INFO_KEY!r}] at {call}, unlike at the first"
                    " reset; every environment must supply it from both reset and step, or none"
                )
        rows = [infos[i][INFO_KEY] if self._in_infos else observations[i] for i in which]
        try:
            features = np.array(rows)
        except ValueError as error:  # of several lengths
            raise SilemError(f"the learner's skeletal features are no vectors: {error}") from error
        if features.dtype.kind not in "fiu":
            kind = features.dtype
            raise SilemError(
                f"the learner's skeletal features are no vectors of numbers but {kind}"
            )
        features = features.astype(np.float32, copy=False).reshape(len(which), -1)
        if features.shape[1] != self.n_features:
            raise SilemError(
                f"the demonstrations have {self.n_features} features per state, the learner's "
                f"environment supplies {features.shape[1]}; both need the same features g(s)"
            )
        return features


def _check_observations(env: VecEnv) -> None:
    """Raise SilemError unless the observations can serve as features."""
    if isinstance(env.observation_space, spaces.Dict):
        raise SilemError(
            "a dictionary of observations is no vector of features; the environment must supply"
            f" info[{INFO_KEY!r}] from reset and step"
        )
    wrapper, remedy = unwrap_vec_normalize(env), "leave it away"
    changes = "NormalizeObservation" if any(env.env_is_wrapped(NormalizeObservation)) else ""
    if wrapper is not None and wrapper.norm_obs:
        changes, remedy = "VecNormalize", f"{remedy} or pass it norm_obs=False"
    if changes:
        raise SilemError(
            f"{changes} changes the observations that are compared with the demonstrations as"
            f" it goes; {remedy} (the policy normalises its observations itself), or have the"
            f" environment supply info[{INFO_KEY!r}]"
        )
