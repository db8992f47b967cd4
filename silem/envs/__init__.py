"""Environments."""

from __future__ import annotations

from silem.envs.bullet import BulletVecEnv, MAX_STEPS

__all__ = ["BulletVecEnv", "make_vec"]


def make_vec(body: str, n_envs: int = 4, seed: int = 0, max_steps: int = MAX_STEPS) -> BulletVecEnv:
    """Make a vectorised environment of a body."""
    return BulletVecEnv(body, n_envs=n_envs, seed=seed, max_steps=max_steps)
