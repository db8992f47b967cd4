"""Studies: which runs the figures are made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from silem import paper
from silem.study import runs
from silem.study.config import BUDGETS, TRIAL_SEEDS, Budget, RunConfig
from silem.util.errors import SilemError, choose


@dataclass(frozen=True)
class Cell:
    """One entry of a study's figures: a method on a body, from some expert, over all trials.

    ``overrides`` are the hyper-parameters that differ from the supplement's best combination.
    """

    study: str
    method: str
    body: str
    demonstrations: str | None = None
    overrides: tuple[tuple[str, Any], ...] = ()

    def config(self, budget: str | Budget, seed: int) -> RunConfig:
        """Return one trial's configuration."""
        return RunConfig.create(
            self.body, self.method, self.demonstrations, budget, seed,
            study=self.study, **dict(self.overrides),
        )  # fmt: skip


_HALF_CHEETAHS = ("HC0", "HC1", "HC2")
_HUMANOIDS = ("Humanoid", "HumanoidR", "Atlas")
_FIGURE_2B, _FIGURE_3B, _NO_PENALTY = "halfcheetah", "humanoids", "no-gradient-penalty"
_STARTS = "demonstration-starts"
# The paper gives PPO 8000 iterations on humanoids, with a learning rate of 1e-4 and a clip range of
# 0.1. The book's budget is a fraction of that, so it takes the larger steps of the paper's other
# bodies, for every method alike.
_LARGER_STEPS = tuple((name, paper.common()[name]) for name in ("learning_rate", "clip_range"))
_STUDIES = {
    # Figure 2b and Table 1
    _FIGURE_2B: (
        *(Cell(_FIGURE_2B, "ppo", body) for body in _HALF_CHEETAHS),
        *(Cell(_FIGURE_2B, "silem", body, "HC0") for body in _HALF_CHEETAHS),
        *(Cell(_FIGURE_2B, "silem-minus", body, "HC0") for body in _HALF_CHEETAHS),
        *(Cell(_FIGURE_2B, "silem-minus-own", body, body) for body in _HALF_CHEETAHS),
        Cell(_FIGURE_2B, "silem-mlp", "HC0", "HC0"),
        *(Cell(_FIGURE_2B, "random", body) for body in _HALF_CHEETAHS),
    ),
    # Figures 3b, 4a and 4b
    _FIGURE_3B: tuple(
        Cell(_FIGURE_3B, method, body, overrides=() if method == "random" else _LARGER_STEPS)
        for method in ("ppo", "silem", "silem-minus", "peng20", "tpil", "random")
        for body in _HUMANOIDS
    ),
    # episodes that start from the demonstration's states, which the paper argues against needing
    _STARTS: (
        Cell(_STARTS, "silem", "Humanoid", overrides=(*_LARGER_STEPS, ("starts", "demonstration"))),
    ),
    # HalfCheetah with the paper's loss for D, which has no gradient penalty: page "Deviations"
    _NO_PENALTY: tuple(
        Cell(_NO_PENALTY, method, body, "HC0", (("gradient_penalty", 0.0),))
        for method in ("silem", "silem-minus")
        for body in _HALF_CHEETAHS
    ),
}


def cells(study: str) -> list[Cell]:
    """Return a study's cells, experts first.

    Raises:
        SilemError: There is no such study.
    """
    return list(_STUDIES[choose("study", study, _STUDIES)])


def study_configs(
    study: str, budget: str | Budget, n_trials: int | None = None, **only: Sequence[str] | None
) -> list[RunConfig]:
    """Return the runs of a study: the first trial of every cell before any second.

    Args:
        study: The study.
        budget: A budget's name, or a `Budget`.
        n_trials: Trials per cell; None means the budget's own number.
        **only: ``method=[...]`` and ``body=[...]`` keep those cells alone.

    Raises:
        SilemError: An unknown study or budget, or more trials than there are fixed seeds.
    """
    if isinstance(budget, str):
        budget = BUDGETS[choose("budget", budget, BUDGETS)]
    n_trials = budget.n_trials if n_trials is None else n_trials
    if not 1 <= n_trials <= len(TRIAL_SEEDS):
        raise SilemError(f"trials must be 1 to {len(TRIAL_SEEDS)}, not {n_trials}")
    for name, wanted in only.items():
        allowed = dict.fromkeys(getattr(cell, name) for cell in cells(study))
        for value in wanted or ():
            choose(name, value, allowed)
    kept = [
        cell
        for cell in cells(study)
        if all(getattr(cell, name) in wanted for name, wanted in only.items() if wanted)
    ]
    return [cell.config(budget, seed) for seed in TRIAL_SEEDS[:n_trials] for cell in kept]


def status_table(study: str, budget: Budget) -> str:
    """Return a text table of a study's cells by trials: finished, running, part or missing."""
    seeds = TRIAL_SEEDS[: budget.n_trials]
    lines = [f"{study}, budget {budget.name}, trials by seed:"]
    lines.append(f"{'':34}" + "".join(f"{seed:<10}" for seed in seeds))
    for cell in cells(study):
        source = f" from {cell.demonstrations}" if cell.demonstrations else ""
        states = [runs.state(cell.config(budget, seed)) for seed in seeds]
        name = f"{cell.method} {cell.body}{source}"
        lines.append(f"{name:34}" + "".join(f"{state:<10}" for state in states))
    return "\n".join(lines)
