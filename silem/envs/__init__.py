"""Environments: `make_vec` for batches, the Gymnasium ids `silem/HC0-v0` ... for single ones."""

from __future__ import annotations

import gymnasium

from silem import bodies
from silem.envs.bullet import MAX_STEPS, BulletVecEnv
from silem.envs.rendering import Camera
from silem.envs.single import BulletEnv

__all__ = ["BulletEnv", "BulletVecEnv", "Camera", "make_vec", "register_gymnasium_ids"]


def make_vec(body: str, n_envs: int = 4, seed: int = 0, max_steps: int = MAX_STEPS) -> BulletVecEnv:
    """Make E environments with the same body, stepped as one.

    Args:
        body: Name of the body, for example "HC2".
        n_envs: E.
        seed: Root of all environments' random streams.
        max_steps: Steps after which an episode is cut off.

    Raises:
        SilemError: If an argument is not allowed; the message says what is.
    """
    return BulletVecEnv(body, n_envs=n_envs, seed=seed, max_steps=max_steps)


def register_gymnasium_ids() -> None:
    """Register `silem/<body>-v0` for every body that has no id yet."""
    for name in bodies.names():
        if f"silem/{name}-v0" not in gymnasium.registry:
            gymnasium.register(
                f"silem/{name}-v0",
                entry_point="silem.envs.single:BulletEnv",
                max_episode_steps=MAX_STEPS,
                kwargs={"body": name},
            )


register_gymnasium_ids()
