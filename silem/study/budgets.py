"""Budgets: how much a run may spend. They change counts, nothing else."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from silem import paper
from silem.util.errors import SilemError

LARGEST = 10**9
"""More of anything cannot be run through."""


def check_positive_int(name: str, value: Any) -> None:
    """Raise SilemError unless a value is a whole number from 1 to `LARGEST`."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise SilemError(f"{name} must be a positive whole number, not {value!r}")
    if value > LARGEST:
        raise SilemError(f"{name} must be a positive whole number up to {LARGEST}")


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
        if not isinstance(self.name, str):
            raise SilemError(f"the name of a budget must be text, not {self.name!r}")
        for field in dataclasses.fields(self):
            if field.name != "name":
                check_positive_int(f"budget {field.name}", getattr(self, field.name))
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
        return self.base_name in ("book", "paper")

    @property
    def base_name(self) -> str:
        """Name of the budget that this one is, or that it has other iterations than."""
        return self.name.partition("-")[0]

    def with_iterations(self, n_iterations: int) -> Budget:
        """Return this budget with another number of iterations, and a name that says so."""
        return dataclasses.replace(
            self, name=f"{self.name}-{n_iterations}", n_iterations=n_iterations
        )


_PPO = paper.common("halfcheetah")  # the supplement's common settings for the PyBullet bodies
_STEPS, _TRIALS = _PPO["steps_per_iteration"], paper.number("n_trials")

BUDGETS = {
    budget.name: budget
    for budget in (
        # seconds: tests, and the notebooks' defaults
        Budget("tiny", 2, 256, 4, 1, 2, 2),
        # minutes: to see it learn
        Budget("quick", 8, _STEPS, 60, 1, 10, 20),
        # the committed evidence
        Budget("book", 8, _STEPS, 800, _TRIALS, 100, 25),
        Budget(
            "paper", 8, _STEPS, _PPO["n_iterations"], _TRIALS, paper.number("n_eval_episodes"), 25
        ),
    )
}

_MUJOCO = paper.common("humanoid")
HUMANOIDS: dict[str, dict[str, int]] = {
    "tiny": {},
    "quick": {"n_envs": 16, "steps_per_iteration": _MUJOCO["steps_per_iteration"]},
    "book": {
        "n_envs": 16,
        "steps_per_iteration": _MUJOCO["steps_per_iteration"],
        "n_iterations": 2000,
    },
    "paper": {
        "n_envs": 16,
        "steps_per_iteration": _MUJOCO["steps_per_iteration"],
        "n_iterations": _MUJOCO["n_iterations"],
    },
}
"""What each budget counts differently for humanoids."""


def of_family(budget: Budget, family: str) -> Budget:
    """Return a budget with the counts it has on a family, the same for every body and method.

    A budget with a number of iterations of its own keeps that; one that is not among `BUDGETS`
    stays as it is.
    """
    base = BUDGETS.get(budget.base_name)
    if base is None or budget not in (base, base.with_iterations(budget.n_iterations)):
        return budget
    counts: dict[str, Any] = dict(HUMANOIDS[base.name]) if family == "humanoid" else {}
    if budget != base:
        counts.pop("n_iterations", None)
    return dataclasses.replace(budget, **counts)
