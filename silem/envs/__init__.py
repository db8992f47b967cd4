"""Environments: `make_vec` for batches, the Gymnasium ids `silem/HC0-v0` ... for single ones.

The simulators, and PyTorch with stable-baselines3, are imported with the first class asked for.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

import gymnasium

from silem import bodies
from silem.bodies import Body, Entry

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecEnv

    from silem.envs.base import BatchedEnv, SingleEnv
    from silem.envs.bullet.camera import Camera
    from silem.envs.bullet.single_env import BulletEnv
    from silem.envs.bullet.vec_env import BulletVecEnv
    from silem.envs.mujoco.camera import MujocoCamera
    from silem.envs.mujoco.single_env import MujocoEnv
    from silem.envs.mujoco.vec_env import MujocoVecEnv

_MODULES = {
    "BatchedEnv": "silem.envs.base",
    "BulletEnv": "silem.envs.bullet.single_env",
    "BulletVecEnv": "silem.envs.bullet.vec_env",
    "Camera": "silem.envs.bullet.camera",
    "MujocoCamera": "silem.envs.mujoco.camera",
    "MujocoEnv": "silem.envs.mujoco.single_env",
    "MujocoVecEnv": "silem.envs.mujoco.vec_env",
    "SingleEnv": "silem.envs.base",
}
_BATCHES = {
    "bullet": ("silem.envs.bullet.vec_env", "BulletVecEnv"),
    "mujoco": ("silem.envs.mujoco.vec_env", "MujocoVecEnv"),
    "gymnasium": ("silem.envs.any", "make_batch"),
}
_SINGLE = {"bullet": "BulletEnv", "mujoco": "MujocoEnv"}

__all__ = [
    "BatchedEnv",
    "BulletEnv",
    "BulletVecEnv",
    "Camera",
    "MujocoCamera",
    "MujocoEnv",
    "MujocoVecEnv",
    "SingleEnv",
    "make_vec",
]


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
        n_envs: E.
        seed: Root of all environments' random streams.
        max_steps: Steps after which an episode is cut off; None means the body's.
        **options: What the body's simulator takes beside: see `MujocoVecEnv`.

    Raises:
        SilemError: If an argument is not allowed; the message says what is.
    """
    found = bodies.get(body) if isinstance(body, str) else body
    module, name = _BATCHES[found.engine]
    make = getattr(importlib.import_module(module), name)
    env: VecEnv = make(found, n_envs=n_envs, seed=seed, max_steps=max_steps, **options)
    return env


def _register_id(body: Body | Entry) -> None:
    """Give a body its Gymnasium id, `silem/<name>-v0`, unless it is Gymnasium's own."""
    if body.engine not in _SINGLE:
        return
    name = _SINGLE[body.engine]
    key = f"silem/{body.name}-v0"
    gymnasium.registry.pop(key, None)  # a body's that this one replaces
    gymnasium.register(
        key,
        entry_point=f"{_MODULES[name]}:{name}",
        max_episode_steps=body.max_steps,
        kwargs={"body": body.name},
    )


bodies.watch(_register_id)
