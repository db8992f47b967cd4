"""Environments: `make_vec` for batches, the Gymnasium ids `silem/HC0-v0` ... for single ones."""

from __future__ import annotations

from typing import Any

from silem import bodies
from silem.bodies import Body
from silem.envs.base import MAX_STEPS, BatchedEnv
from silem.envs.bullet.camera import Camera
from silem.envs.bullet.single_env import BulletEnv
from silem.envs.bullet.vec_env import BulletVecEnv
from silem.envs.mujoco.camera import MujocoCamera
from silem.envs.mujoco.single_env import MujocoEnv
from silem.envs.mujoco.vec_env import MujocoVecEnv

__all__ = [
    "BatchedEnv",
    "BulletEnv",
    "BulletVecEnv",
    "Camera",
    "MujocoCamera",
    "MujocoEnv",
    "MujocoVecEnv",
    "make_vec",
]


def make_vec(
    body: Body | str, n_envs: int = 4, seed: int = 0, max_steps: int = MAX_STEPS, **options: Any
) -> BatchedEnv:
    """Make E environments with the same body, stepped as one.

    Args:
        body: A body or its name, for example "HC2".
        n_envs: E.
        seed: Root of all environments' random streams.
        max_steps: Steps after which an episode is cut off.
        **options: What the body's simulator takes beside: see `MujocoVecEnv`.

    Raises:
        SilemError: If an argument is not allowed; the message says what is.
    """
    found = bodies.get(body) if isinstance(body, str) else body
    make = MujocoVecEnv if found.engine == "mujoco" else BulletVecEnv
    return make(found, n_envs=n_envs, seed=seed, max_steps=max_steps, **options)
