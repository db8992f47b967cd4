"""Methods, and the hyper-parameters that each of them uses.

The values are the paper's (`silem.paper`) where it names them; a comment marks those it leaves
open.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from silem import paper
from silem.study.budgets import check_positive_int
from silem.util.errors import SilemError, choose

METHODS = (
    "ppo", "random", "silem", "silem-minus", "silem-minus-own", "silem-mlp", "tpil", "peng20",
)  # fmt: skip
"""``ppo`` is an expert (true reward); ``random`` is the untrained Gaussian
policy, whose raw actions the task charges, and is only evaluated;
``silem-minus-own`` is SILEM-minus from the learner's own body's expert; ``tpil`` is third-person
imitation learning; ``peng20`` is SILEM-minus from demonstrations retargeted to the learner's body
by inverse kinematics."""

TRANSFORMS = {
    "silem": "affine",
    "silem-minus": "identity",
    "silem-minus-own": "identity",
    "silem-mlp": "mlp",
    "peng20": "identity",
}
"""The state transformer of each method that has SILEM's structure."""

IMITATORS = (*TRANSFORMS, "tpil")
"""The methods that learn from demonstrations."""

STARTS = ("standing", "demonstration")
"""What episodes of a humanoid start from: the standing pose with small noise, or states of the
demonstration retargeted to the learner's body (off by default: the paper argues against needing
them)."""

L2_FORMS = ("deviation", "plain")

_PPO = paper.common("halfcheetah")  # the supplement's common settings for the PyBullet bodies
_BEST = paper.best_combination("HC0", "silem", "HC0")
_POLICY = ("ppo", *IMITATORS)
_DISCRIMINATOR = IMITATORS
_TRANSFORM = tuple(method for method, kind in TRANSFORMS.items() if kind != "identity")


def _used_by(methods: tuple[str, ...], default: Any, *, optional: bool = False) -> Any:
    """Declare a hyper-parameter; an optional one is no part of a run's identity at its default."""
    return dataclasses.field(default=default, metadata={"methods": methods, "optional": optional})


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
    # logarithm of the policy's standard deviation at the start; the paper leaves it open
    log_std_init: float = _used_by(_POLICY, 0.0, optional=True)
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
    # Of the humanoids alone; 0 where they do not apply.
    transform_l2_scale: float = _used_by(("silem",), 0.0, optional=True)  # w_d
    transform_l2_bias: float = _used_by(("silem",), 0.0, optional=True)  # w_b
    transform_l2_form: str = _used_by(("silem",), L2_FORMS[0], optional=True)
    gradient_reversal_coef: float = _used_by(("tpil",), 1.0)  # C_g
    ankle_range_rad: float = _used_by(METHODS, 0.0, optional=True)  # a, of Atlas
    starts: str = _used_by(_POLICY, STARTS[0], optional=True)
    # Of the random policy: standard deviation of its raw actions, as an untrained policy's is.
    action_std: float = _used_by(("random",), 1.0)

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

    def of_method(self, method: str) -> dict[str, Any]:
        """Return what identifies a run of a method: the values it uses, by name.

        Optional hyper-parameters are left out at their defaults.
        """
        fields = {field.name: field for field in dataclasses.fields(self)}
        values = {name: getattr(self, name) for name in self.names_used_by(method)}
        return {
            name: value
            for name, value in values.items()
            if not (fields[name].metadata["optional"] and value == fields[name].default)
        }


_CHOICES = {"starts": STARTS, "transform_l2_form": L2_FORMS}
_MAY_BE_ZERO = (
    "disc_entropy_coef", "gradient_penalty", "transform_l2_scale", "transform_l2_bias",
    "gradient_reversal_coef", "ankle_range_rad",
)  # fmt: skip
_LOWER_BOUNDS = {"log_std_init": -float("inf")}
_AT_MOST_ONE = ("gamma", "gae_lambda", "transform_lr_decay")


def _checked(name: str, default: Any, value: Any) -> Any:
    """Return a hyper-parameter's value in its field's type, or raise SilemError."""
    if name in _CHOICES:
        return choose(name, value, _CHOICES[name])
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
    lowest_allowed = value > _LOWER_BOUNDS.get(name, 0) or (value == 0 and name in _MAY_BE_ZERO)
    limit = 1.0 if name in _AT_MOST_ONE else float("inf")
    if not lowest_allowed or not value <= limit or value == float("inf"):
        raise SilemError(f"{name} is out of range: {value!r}")
    return float(value)
