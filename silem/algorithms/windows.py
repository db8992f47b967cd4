"""Windows o_t = (g(s_t), ..., g(s_t+n)) over skeletal features, never across an episode's end.

A window ends at the state a transition leads to, so its reward speaks of the action taken. The
first windows of an episode repeat its first state until there are enough states.
"""

from __future__ import annotations

import numpy as np

from silem.util.errors import SilemError


def episode_windows(features: np.ndarray, window: int) -> np.ndarray:
    """Cut one episode into windows.

    Args:
        features: Skeletal features of an episode's T + 1 states, (T + 1, F).
        window: Number of states W in a window, at least 1.

    Returns:
        Windows (T, W, F); row t ends at state t + 1.

    Raises:
        SilemError: If the episode has fewer than two states or the window is not positive.
    """
    if window < 1:
        raise SilemError(f"window must be at least 1 state, got {window}")
    if features.ndim != 2 or len(features) < 2:
        raise SilemError(f"an episode needs (T + 1, F) features, T >= 1; got {features.shape}")
    last = np.arange(1, len(features))
    states = last[:, None] + np.arange(1 - window, 1)[None, :]
    return features[np.maximum(states, 0)]


class WindowTracker:
    """The learner's windows, built step by step in E environments.

    Args:
        window: Number of states W in a window.
        first: Features of each environment's first state, (E, F).
    """

    def __init__(self, window: int, first: np.ndarray) -> None:
        self._recent = np.repeat(first[:, None, :], window, axis=1).astype(np.float32)

    def push(self, features: np.ndarray) -> np.ndarray:
        """Append the states (E, F) just reached and return the windows (E, W, F) they end."""
        self._recent[:, :-1] = self._recent[:, 1:]
        self._recent[:, -1] = features
        return self._recent

    def restart(self, environment: int, first: np.ndarray) -> None:
        """Begin a new episode with first state (F,) in one environment."""
        self._recent[environment] = first
