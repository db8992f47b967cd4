"""Environments: `make_vec` for batches, the Gymnasium ids `silem/HC0-v0` ... for single ones.

The simulators, and PyTorch with stable-baselines3, are imported with the first name asked for.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from silem.envs.base import BatchedEnv, SingleEnv, WithFeatures, make_vec
    from silem.envs.camera import Camera

__all__ = ["BatchedEnv", "Camera", "SingleEnv", "WithFeatures", "make_vec"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module("silem.envs.base"), name)
