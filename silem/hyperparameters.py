"""Methods, and the hyper-parameters that each of them uses.

The values are the paper's (`silem.paper`) where it names them; a comment marks those it leaves
open.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from silem import paper
from silem.budgets import check_positive_int
from silem.errors import SilemError

METHODS = ("ppo", "random", "silem", "silem-minus", "silem-minus-own", "silem-mlp")
"""``ppo`` is an expert (true reward); ``random`` acts uniformly at random and is only evaluated;
``silem-minus-own`` is SILEM-minus from the learner's own body's expert."""

TRANSFORMS = {
    "silem": "affine",
    "silem-minus": "identity",
    "silem-minus-own": "identity",
    "silem-mlp": "mlp",
}
"""The state transformer of each imitation method."""

_PPO = paper.common("halfcheetah")  # the supplement's common settings for the PyBullet bodies
_BEST = paper.best_combination("HC0", "silem", "HC0")
_POLICY = ("ppo", *TRANSFORMS)
_DISCRIMINATOR = tuple(TRANSFORMS)
_TRANSFORM = tuple(method for method, kind in TRANSFORMS.items() if kind != "identity")


def _used_by(methods: tuple[str, ...], default: Any) -> Any:
    return dataclasses.field(default=default, metadata={"methods": methods})


@dataclass(frozen=True)
class HyperParameters:
    """Every hyper-parameter of learning; a method uses some of them (see `names_used_by`)."""

    # The supplement's common PPO settings. The learning rate falls linearly to 0; Adam's epsilon
    # is that of OpenAI baselines, as the supplement says.
    learning_rate: float = _used_by(_POLICY, _PPO["learning_rate"])
    clip_range: float = _used_by(_POLICY, _PPO["clip_range"])
    gamma: float = _used_by(_POLICY, _PPO["gamma"])
    gae_lambda: float = _used_by(_POLICY, _PPO["gae_lambda"])
    n_epochs: int = _used_by(_POLICY, _PPO["n_epochs"])  # N_P
    minibatch_size: int = _used_by(_POLICY, _PPO["minibatch_size"])  # N_Pmb
    adam_eps: float = _used_by(_POLICY, 1e-5)
    policy_hidden: tuple[int, ...] = _used_by(_POLICY, tuple(paper.number("policy_hidden")))
    # The supplement's grid; `RunConfig.create` fills in the best combination of each cell.
    disc_hidden: tuple[int, ...] = _used_by(_DISCRIMINATOR, tuple(paper.number("disc_hidden")))
    window: int = _used_by(_DISCRIMINATOR, paper.number("window"))  # states per window
    n_trajectories: int = _used_by(_DISCRIMINATOR, _BEST["n_trajectories"])  # n
    n_disc_updates: int = _used_by(_DISCRIMINATOR, _BEST["n_disc_updates"])  # N_D
    n_transform_updates: int = _used_by(_TRANSFORM, _BEST["n_transform_updates"])  # N_G
    transform_lr_decay: float = _used_by(_TRANSFORM, _BEST["transform_lr_decay"])  # d
    # Left open by the paper.
    disc_learning_rate: float = _used_by(_DISCRIMINATOR, 1e-3)
    transform_learning_rate: float = _used_by(_TRANSFORM, 1e-4)
    disc_entropy_coef: float = _used_by(_DISCRIMINATOR, 1e-3)
    gradient_penalty: float = _used_by(_DISCRIMINATOR, 1.0)  # 0 switches it off

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = _checked(field.name, field.default, getattr(self, field.name))
            object.__setattr__(self, field.name, value)

    @staticmethod
    def names_used_by(method: str) -> list[str]:
        """Return the names of the hyper-parameters that a method uses, in the class's order."""
        return [
            field.name
            for field in dataclasses.fields(HyperParameters)
            if method in field.metadata["methods"]
        ]


_MAY_BE_ZERO = ("disc_entropy_coef", "gradient_penalty")
_AT_MOST_ONE = ("gamma", "gae_lambda", "transform_lr_decay")


def _checked(name: str, default: Any, value: Any) -> Any:
    """Return a hyper-parameter's value in its field's type, or raise SilemError."""
    if isinstance(default, tuple):
        if not isinstance(value, list | tuple) or not value:
            raise SilemError(f"{name} must be a list of layer sizes, not {value!r}")
        for size in value:
            check_positive_int(f"each size in {name}", size)
        return tuple(value)
    if isinstance(default, int):
        check_positive_int(name, value)
        return value
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise SilemError(f"{name} must be a number, not {value!r}")
    lowest_allowed = value >= 0 if name in _MAY_BE_ZERO else value > 0
    limit = 1.0 if name in _AT_MOST_ONE else float("inf")
    if not lowest_allowed or not value <= limit or value == float("inf"):
        raise SilemError(f"{name} is out of range: {value!r}")
    return float(value)
