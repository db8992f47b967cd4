"""Environments: `make_vec` for batches, the Gymnasium ids `silem/HC0-v0` ... for single ones.

The simulators, and PyTorch with stable-baselines3, are imported with the first class asked for.
"""

import functools
import importlib
from typing import TYPE_CHECKING, Any

from silem import bodies
from silem.bodies import Body
from silem.util.errors import COUNT, SilemError

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecEnv

    from silem.envs.base import BatchedEnv, SingleEnv
    from silem.envs.camera import Camera

_MODULES = {"BatchedEnv": "base", "SingleEnv": "base", "WithFeatures": "base", "Camera": "camera"}

__all__ = ["BatchedEnv", "Camera", "SingleEnv", "WithFeatures", "make_vec"]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"silem.envs.{_MODULES[name]}"), name)


def make_vec(
    body: Body | str, n_envs: int = 4, seed: int = 0, max_steps: int | None = None, **options: Any
) -> "VecEnv":
    """Make E environments with the same body, stepped as one.

    Args:
        body: A body or its name, for example "HC2", or the id of a Gymnasium environment.
        n_envs: E, at least 1.
        seed: Root of all environments' random streams.
        max_steps: Steps after which an episode is cut off; None means the body's.
        **options: A Gymnasium environment's own, or a humanoid's: `n_threads` that step it
            (results do not depend on them), `speed_m_s` that earns the full reward (None means
            the body's), as `starts` states that episodes start from, positions (S, nq) and
            velocities (S, nv) (None means the standing pose, small noise), and as `bodies` E
            humanoids of other lengths, one for each environment in the place of `body`.

    Raises SilemError if an argument is not allowed; the message says what is.
    """
    found = bodies.get(body) if isinstance(body, str) else body
    make = _batch_of_gymnasium if found.engine == "gymnasium" else __getattr__("BatchedEnv")
    return make(found, n_envs=n_envs, seed=seed, max_steps=max_steps, **options)


def _batch_of_gymnasium(
    body: Body, n_envs: int, seed: int, max_steps: int | None, **options: Any
) -> "VecEnv":
    """Make E environments of a Gymnasium id: stable-baselines3's own batch, one after another."""
    import gymnasium
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv

    COUNT.check("n_envs", n_envs)
    limit = body.max_steps if max_steps is None else max_steps
    make = functools.partial(gymnasium.make, body.name, max_episode_steps=limit, **options)
    try:
        env = DummyVecEnv([lambda: Monitor(make()) for _ in range(n_envs)])
    except (gymnasium.error.Error, TypeError, ImportError) as error:
        raise SilemError(f"{body.name} cannot be made: {error}") from error
    env.seed(seed)
    return env
