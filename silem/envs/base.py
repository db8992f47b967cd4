"""What every batch of environments has in common: arguments, seeds, and what it refuses."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices

from silem.bodies.registry import MAX_STEPS as MAX_STEPS
from silem.envs.filmed import Filmed
from silem.util.errors import SilemError, choose


def check_actions(actions: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return actions of the given shape as float32.

    Raises:
        SilemError: If the shape is another, or a number is not finite.
    """
    try:
        array = np.asarray(actions, dtype=np.float32)
    except (TypeError, ValueError) as error:
        raise SilemError(f"actions are not numbers: {error}") from error
    if array.shape != shape:
        raise SilemError(f"actions of shape {array.shape}; expected {shape}")
    if not math.isfinite(float(array.sum())):
        raise SilemError("actions contain NaN or infinity")
    return array


class BatchedEnv(Filmed, VecEnv):
    """E environments with the same body, behind one object.

    An environment that ends is reset at once, as stable-baselines3 expects. Its info then holds
    `terminal_observation` (O,), `TimeLimit.truncated` (whether only the step limit ended it) and
    `episode`: return `r`, length `l`, seconds since the environments were built `t`, mean speed
    `speed_m_s`, and share of the steps upright `upright`.

    After `seed(s)`, `reset()` makes everything that follows equal, bit for bit, to a newly made
    instance with that seed, whatever happened before.

    Attributes:
        max_steps: Steps after which an episode is cut off.
    """

    def __init__(
        self,
        n_envs: int,
        spaces: tuple[gymnasium.Space[Any], gymnasium.Space[Any]],
        seed: int,
        max_steps: int,
    ) -> None:
        for name, value in (("n_envs", n_envs), ("max_steps", max_steps)):
            if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
                raise SilemError(f"{name} is {value!r}; allowed: whole numbers from 1")
        self.max_steps = int(max_steps)
        self._generators: list[np.random.Generator] = []
        self._built_at = time.perf_counter()
        self._actions: np.ndarray | None = None
        super().__init__(int(n_envs), *spaces)
        self.seed(seed)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Set the root seed; it takes effect at the next `reset`.

        Args:
            seed: Root of all environments' random streams; None draws one.

        Raises:
            SilemError: If the seed is negative or not a whole number.
        """
        if seed is not None and (not isinstance(seed, int | np.integer) or seed < 0):
            raise SilemError(f"seed is {seed!r}; allowed: whole numbers from 0")
        root = np.random.SeedSequence(None if seed is None else int(seed))
        self._next_generators = [np.random.default_rng(s) for s in root.spawn(self.num_envs)]
        return [seed] * self.num_envs

    def step_async(self, actions: np.ndarray) -> None:
        """Take (E, A) actions for the next `step_wait`.

        Raises:
            SilemError: If they have another shape or are not finite.
        """
        self._actions = check_actions(actions, (self.num_envs, *(self.action_space.shape or ())))

    def _take_actions(self) -> np.ndarray:
        """Return the actions (E, A) to step with; raises SilemError where there can be no step."""
        if self._actions is None or not self._is_reset():
            raise SilemError("step before reset, or step_wait without step_async")
        actions, self._actions = self._actions, None
        return actions

    def render(self, mode: str | None = None) -> np.ndarray:
        """Return a picture (H, W, 3), uint8, of the first environment.

        Args:
            mode: "rgb_array" or None, which means the same.

        Raises:
            SilemError: For any other mode, before the first reset, or where nothing can be drawn.
        """
        choose("render mode", mode or "rgb_array", ["rgb_array"])
        return self._picture()

    def get_images(self) -> Sequence[np.ndarray | None]:
        """Return the picture of the first environment, the only one that is drawn."""
        return [self.render()]

    def _since_built_s(self) -> float:
        return time.perf_counter() - self._built_at

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute, which all environments share, once per index."""
        value = getattr(self, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Refuse: the environments share their attributes.

        Raises:
            SilemError: Always.
        """
        raise SilemError(f"{attr_name!r} of a {type(self).__name__} cannot be set per environment")

    def env_method(
        self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any
    ) -> list[Any]:
        """Refuse: there are no separate environment objects to call.

        Raises:
            SilemError: Always.
        """
        raise SilemError(
            f"a {type(self).__name__} has no environments with a method {method_name!r}"
        )

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper], indices: VecEnvIndices = None
    ) -> list[bool]:
        """Return False once per index: there are no wrappers."""
        return [False for _ in self._get_indices(indices)]
