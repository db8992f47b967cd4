"""Any Gymnasium environment as a batch: stable-baselines3's own, one environment after another."""

from __future__ import annotations

import functools
from typing import Any

import gymnasium
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from silem.bodies import Body
from silem.util.errors import SilemError


def make_batch(
    body: Body, n_envs: int = 4, seed: int = 0, max_steps: int | None = None, **options: Any
) -> VecEnv:
    """Make E environments of a Gymnasium id.

    Args:
        body: A `GymnasiumBody`.
        n_envs: E.
        seed: Root of all environments' random streams.
        max_steps: Steps after which an episode is cut off; None means the environment's own.
        **options: What the environment takes.

    Raises:
        SilemError: If there are no environments, or the environment cannot be made.
    """
    if n_envs < 1:
        raise SilemError(f"n_envs is {n_envs!r}; allowed: whole numbers from 1")
    limit = body.max_steps if max_steps is None else max_steps
    make = functools.partial(gymnasium.make, body.name, max_episode_steps=limit, **options)
    try:
        env = DummyVecEnv([lambda: Monitor(make()) for _ in range(n_envs)])
    except (gymnasium.error.Error, TypeError, ImportError) as error:
        raise SilemError(f"{body.name} cannot be made: {error}") from error
    env.seed(seed)
    return env
