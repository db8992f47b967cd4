"""What a run is: frozen configurations with one strict door, `RunConfig.create`.

A budget changes counts only (steps, environments, trials, episodes). The hyper-parameters come
from the paper's tables where they are named there; the comments say which values the paper leaves
open. A configuration holds exactly the hyper-parameters that its method uses, so that the
identity of an expert's run does not depend on how discriminators are trained.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from silem import bodies
from silem.errors import SilemError, choose

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

ORIGINAL_BODIES = {"halfcheetah": "HC0", "ant": "Ant0"}
"""Per family the body whose expert demonstrates (Section 5 of the paper)."""

TRIAL_SEEDS = (0, 1, 2, 3, 4)
"""The trials' root seeds, fixed before any run was made."""

DEMONSTRATOR_SEED = TRIAL_SEEDS[0]
"""The trial of the expert whose policy is recorded as demonstrations."""


def _check_positive_int(name: str, value: Any) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise SilemError(f"{name} must be a positive whole number, not {value!r}")


@dataclass(frozen=True)
class Budget:
    """How much a run may spend. Changes counts, nothing else."""

    name: str
    n_envs: int
    steps_per_iteration: int  # all environments together
    n_iterations: int
    n_trials: int
    n_eval_episodes: int
    checkpoint_every: int  # iterations; episodes start anew at every checkpoint

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            if field.name != "name":
                _check_positive_int(f"budget {field.name}", getattr(self, field.name))
        if self.steps_per_iteration % self.n_envs:
            raise SilemError(
                f"budget {self.name!r}: {self.steps_per_iteration} steps per iteration do not"
                f" divide among {self.n_envs} environments"
            )

    @property
    def n_steps(self) -> int:
        """Environment steps of the whole training."""
        return self.n_iterations * self.steps_per_iteration

    @property
    def is_evidence(self) -> bool:
        """Whether finished runs are published to the committed results."""
        return self.name in ("book", "paper")

    def with_iterations(self, n_iterations: int) -> Budget:
        """Return this budget with another number of iterations, and a name that says so."""
        return dataclasses.replace(
            self, name=f"{self.name}-{n_iterations}", n_iterations=n_iterations
        )


BUDGETS = {
    budget.name: budget
    for budget in (
        # seconds: tests, and the notebooks' defaults
        Budget("tiny", 2, 256, 4, 1, 2, 2),
        # minutes: to see it learn
        Budget("quick", 8, 2048, 60, 1, 10, 20),
        # the committed evidence
        Budget("book", 8, 2048, 400, 5, 100, 25),
        # the paper's iterations (Table 3) and evaluation episodes (Section 5)
        Budget("paper", 8, 2048, 2000, 5, 1000, 25),
    )
}

_POLICY = ("ppo", *TRANSFORMS)
_DISCRIMINATOR = tuple(TRANSFORMS)
_TRANSFORM = tuple(method for method, kind in TRANSFORMS.items() if kind != "identity")


def _used_by(methods: tuple[str, ...], default: Any) -> Any:
    return dataclasses.field(default=default, metadata={"methods": methods})


@dataclass(frozen=True)
class HyperParameters:
    """Every hyper-parameter of learning; a method uses some of them (see `used_by`)."""

    # Table 3 ("Common hyper-parameters ... Ant and HalfCheetah"); Adam's epsilon and the policy's
    # size from the supplement's text. The learning rate falls linearly to 0.
    learning_rate: float = _used_by(_POLICY, 2e-4)
    clip_range: float = _used_by(_POLICY, 0.2)
    gamma: float = _used_by(_POLICY, 0.99)
    gae_lambda: float = _used_by(_POLICY, 0.95)
    n_epochs: int = _used_by(_POLICY, 10)  # N_P
    minibatch_size: int = _used_by(_POLICY, 64)  # N_Pmb
    adam_eps: float = _used_by(_POLICY, 1e-5)
    policy_hidden: tuple[int, ...] = _used_by(_POLICY, (64, 64))
    # The supplement's grid; the best combination of each cell is filled in by `RunConfig.create`.
    disc_hidden: tuple[int, ...] = _used_by(_DISCRIMINATOR, (128, 128, 128))
    window: int = _used_by(_DISCRIMINATOR, 4)  # states per window (Section 4)
    n_trajectories: int = _used_by(_DISCRIMINATOR, 20)  # n
    n_disc_updates: int = _used_by(_DISCRIMINATOR, 10)  # N_D
    n_transform_updates: int = _used_by(_TRANSFORM, 5)  # N_G
    transform_lr_decay: float = _used_by(_TRANSFORM, 0.999)  # d, per iteration
    # Left open by the paper.
    disc_learning_rate: float = _used_by(_DISCRIMINATOR, 3e-4)
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
            _check_positive_int(f"each size in {name}", size)
        return tuple(value)
    if isinstance(default, int):
        _check_positive_int(name, value)
        return value
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise SilemError(f"{name} must be a number, not {value!r}")
    lowest_allowed = value >= 0 if name in _MAY_BE_ZERO else value > 0
    limit = 1.0 if name in _AT_MOST_ONE else float("inf")
    if not lowest_allowed or not value <= limit or value == float("inf"):
        raise SilemError(f"{name} is out of range: {value!r}")
    return float(value)


def best_combination(body: str, method: str, demonstrations: str) -> dict[str, Any]:
    """Return the supplement's best combination for a cell, or {} where its tables have none."""
    from silem import paper  # the paper's tables name bodies and methods of this module

    return paper.best_combination(body, method, demonstrations)


@dataclass(frozen=True)
class RunConfig:
    """One run: everything that its result depends on, and nothing else."""

    study: str
    body: str  # the learner's
    method: str
    demonstrations: str  # the expert's body; "" where the method needs none
    budget: Budget
    hyper: HyperParameters
    seed: int

    @classmethod
    def create(
        cls,
        body: str,
        method: str,
        demonstrations: str | None = None,
        budget: str | Budget = "tiny",
        seed: int = 0,
        study: str | None = None,
        **hyper_overrides: Any,
    ) -> RunConfig:
        """Make a checked configuration; the one door to `RunConfig`.

        Args:
            body: The learner's body.
            method: One of `METHODS`.
            demonstrations: The expert's body. None means the family's original body, or the
                learner's own for ``silem-minus-own``.
            budget: One of `BUDGETS`, or a `Budget` of your own.
            seed: The root seed of every random stream of the run.
            study: The folder the run belongs to; None means the body's family.
            **hyper_overrides: Hyper-parameters that replace the supplement's best combination
                for this cell.

        Raises:
            SilemError: Anything unknown, of the wrong type, out of range, or of no use to the
                method.
        """
        choose("body", body, bodies.names())
        choose("method", method, METHODS)
        family = bodies.get(body).family
        demonstrations = _demonstrations(body, method, family, demonstrations)
        if isinstance(budget, str):
            budget = BUDGETS[choose("budget", budget, BUDGETS)]
        if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < 2**31:
            raise SilemError(f"seed must be a whole number from 0 to 2**31 - 1, not {seed!r}")
        study = family if study is None else study
        if not re.fullmatch(r"[a-z0-9][a-z0-9_-]*", study):
            raise SilemError(f"study must be of a-z, 0-9, - and _, not {study!r}")
        used = HyperParameters.names_used_by(method)
        for name in hyper_overrides:
            choose(f"hyper-parameter of {method}", name, used)
        best = best_combination(body, method, demonstrations) if used else {}
        values = {name: value for name, value in best.items() if name in used} | hyper_overrides
        hyper = HyperParameters(**values)
        steps, minibatch = budget.steps_per_iteration, hyper.minibatch_size
        if used and steps % minibatch:
            raise SilemError(f"minibatch_size {minibatch} does not divide {steps} steps")
        return cls(study, body, method, demonstrations, budget, hyper, seed)

    @property
    def transform(self) -> str | None:
        """The state transformer's kind, or None where the method does not imitate."""
        return TRANSFORMS.get(self.method)

    @property
    def run_id(self) -> str:
        """A readable name that ends in a hash of the configuration alone."""
        content = self.to_dict()
        del content["budget"]["n_trials"]  # how many others are run changes nothing in this one
        text = json.dumps(content, sort_keys=True)
        source = f"_from_{self.demonstrations}" if self.demonstrations else ""
        digest = hashlib.sha256(text.encode()).hexdigest()[:8]
        return f"{self.method}_{self.body}{source}_{self.budget.name}_s{self.seed}_{digest}"

    @property
    def command(self) -> str:
        """The command line that makes this run, or goes on with it."""
        words = ["python -m silem run", f"--body {self.body}", f"--method {self.method}"]
        if self.demonstrations:
            words.append(f"--demonstrations {self.demonstrations}")
        name, _, iterations = self.budget.name.partition("-")
        words.append(f"--budget {name}" + (f" --iterations {iterations}" if iterations else ""))
        words.append(f"--seed {self.seed}")
        if self.study != bodies.get(self.body).family:
            words.append(f"--study {self.study}")
        default = RunConfig.create(self.body, self.method, self.demonstrations or None)
        for name in HyperParameters.names_used_by(self.method):
            value = getattr(self.hyper, name)
            if value != getattr(default.hyper, name):
                text = ",".join(map(str, value)) if isinstance(value, tuple) else repr(value)
                words.append(f"--set {name}={text}")
        return " ".join(words)

    def to_dict(self) -> dict[str, Any]:
        """Return the configuration as plain JSON types, with the used hyper-parameters only."""
        hyper = {
            name: list(value) if isinstance(value, tuple) else value
            for name in HyperParameters.names_used_by(self.method)
            for value in [getattr(self.hyper, name)]
        }
        return {
            "study": self.study,
            "body": self.body,
            "method": self.method,
            "demonstrations": self.demonstrations,
            "budget": dataclasses.asdict(self.budget),
            "hyper": hyper,
            "seed": self.seed,
        }

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> RunConfig:
        """Rebuild a configuration from `to_dict`, through the same checks.

        Raises:
            SilemError: A key is missing or unknown, or a value is not allowed.
        """
        keys = [field.name for field in dataclasses.fields(cls)]
        try:
            for key in content:
                choose("configuration key", key, keys)
            budget = Budget(**content["budget"])
            return cls.create(
                content["body"],
                content["method"],
                content["demonstrations"] or None,
                budget,
                content["seed"],
                content["study"],
                **content["hyper"],
            )
        except (KeyError, TypeError) as error:
            raise SilemError(f"no valid run configuration: {error}") from error


def _demonstrations(body: str, method: str, family: str, demonstrations: str | None) -> str:
    if method not in TRANSFORMS:
        if demonstrations:
            raise SilemError(f"method {method!r} uses no demonstrations")
        return ""
    if method == "silem-minus-own":
        if demonstrations not in (None, body):
            raise SilemError(f"silem-minus-own of {body} imitates {body}, not {demonstrations}")
        return body
    return choose(
        "demonstrations", demonstrations or ORIGINAL_BODIES[family], bodies.names()
    )
