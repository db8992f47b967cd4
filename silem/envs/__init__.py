"""Environments: `make_vec` for batches, the Gymnasium ids `silem/HC0-v0` ... for single ones.

The simulators, and PyTorch with stable-baselines3, are imported with the first class asked for.
"""

from __future__ import annotations

import functools
import importlib
from typing import TYPE_CHECKING, Any

import gymnasium

from silem import bodies
from silem.bodies import Body, Entry
from silem.util.errors import SilemError

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecEnv

    from silem.envs.base import BatchedEnv, SingleEnv
    from silem.envs.bullet import BulletEnv, BulletVecEnv
    from silem.envs.camera import Camera
    from silem.envs.mujoco import MujocoEnv, MujocoVecEnv

_MODULES = {
    "BatchedEnv": "silem.envs.base",
    "BulletEnv": "silem.envs.bullet",
    "BulletVecEnv": "silem.envs.bullet",
    "Camera": "silem.envs.camera",
    "MujocoEnv": "silem.envs.mujoco",
    "MujocoVecEnv": "silem.envs.mujoco",
    "SingleEnv": "silem.envs.base",
}
_NAMES = {"bullet": "Bullet", "mujoco": "Mujoco"}  # of their classes, Env and VecEnv

__all__ = [
    "BatchedEnv", "BulletEnv", "BulletVecEnv", "Camera", "MujocoEnv", "MujocoVecEnv", "SingleEnv",
    "make_vec",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_MODULES[name]), name)


def make_vec(
    body: Body | str, n_envs: int = 4, seed: int = 0, max_steps: int | None = None, **options: Any
) -> VecEnv:
    """Make E environments with the same body, stepped as one.

    Args:
        body: A body or its name, for example "HC2".
        n_envs: How many environments, E.
        seed: Root of all environments' random streams.
        max_steps: Steps after which an episode is cut off; None means the body's.
        **options: What a humanoid's takes beside (see `MujocoVecEnv`), or a Gymnasium environment.

    Raises:
        SilemError: If an argument is not allowed; the message says what is.
    """
    found = bodies.get(body) if isinstance(body, str) else body
    make = _batch_of_gymnasium
    if found.engine in _NAMES:
        make = __getattr__(f"{_NAMES[found.engine]}VecEnv")
    return make(found, n_envs=n_envs, seed=seed, max_steps=max_steps, **options)


def _batch_of_gymnasium(
    body: Body, n_envs: int, seed: int, max_steps: int | None, **options: Any
) -> VecEnv:
    """Make E environments of a Gymnasium id: stable-baselines3's own batch, one after another."""
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv

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


def _register_id(body: Body | Entry) -> None:
    """Give a body its Gymnasium id, `silem/<name>-v0`, unless it is Gymnasium's own."""
    if body.engine not in _NAMES:
        return
    name = f"{_NAMES[body.engine]}Env"
    key = f"silem/{body.name}-v0"
    gymnasium.registry.pop(key, None)  # a body's that this one replaces
    gymnasium.register(
        key,
        entry_point=f"{_MODULES[name]}:{name}",
        max_episode_steps=body.max_steps,
        kwargs={"body": body.name},
    )


bodies.watch(_register_id)
