"""Studies: which runs the figures are made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from silem import paper
from silem.study import runs
from silem.study.config import TRIAL_SEEDS, RunConfig
from silem.study.settings import BUDGETS, Budget, budget_named
from silem.util.errors import SilemError, choose


@dataclass(frozen=True)
class Cell:
    """One entry of a study's figures: a method on a body, from some expert, over all trials.

    ``overrides`` are the hyper-parameters that differ from the supplement's best combination,
    ``n_iterations`` what differs from the budget's.
    """

    study: str
    method: str
    body: str
    demonstrations: str | None = None
    overrides: tuple[tuple[str, Any], ...] = ()
    n_iterations: int | None = None

    def config(self, budget: str | Budget, seed: int) -> RunConfig:
        """Return one trial's configuration."""
        budget = budget_named(budget)
        if self.n_iterations is not None and budget.is_evidence:
            budget = BUDGETS[budget.base_name].with_iterations(self.n_iterations)
        return RunConfig.create(
            self.body, self.method, self.demonstrations, budget, seed,
            study=self.study, **dict(self.overrides),
        )  # fmt: skip


@dataclass(frozen=True)
class Study:
    """Cells that are read together.

    Attributes:
        cells: Experts first.
        seeds: The trials' root seeds, fixed before any run was made.
        about: What the study is for, in one sentence.
    """

    cells: tuple[Cell, ...]
    seeds: tuple[int, ...] = TRIAL_SEEDS
    about: str = ""


SEARCH_SEEDS = (100,)
"""Root seeds of the search for open settings: none of them is a trial's."""

_HALF_CHEETAHS = ("HC0", "HC1", "HC2")
_HUMANOIDS = ("Humanoid", "HumanoidR", "Atlas")
_FIGURE_2B, _FIGURE_3B, _NO_PENALTY = "halfcheetah", "humanoids", "no-gradient-penalty"
_HUMANOIDS_NO_PENALTY = "humanoids-no-gradient-penalty"
_STARTS, _DEMONSTRATORS, _SEARCH = "demonstration-starts", "demonstrators", "open-settings"
_FIDELITY = "fidelity"
# The paper gives PPO 8000 iterations on humanoids, with a learning rate of 1e-4 and a clip range of
# 0.1. The book's budget is a fraction of that, so it takes the larger steps of the paper's other
# bodies, for every method alike.
_LARGER_STEPS = tuple((name, paper.common()[name]) for name in ("learning_rate", "clip_range"))

_Settings = tuple[tuple[str, Any], ...]
# The search of the settings that the paper leaves open, in stages: each stage starts from what the
# one before chose, and is added here, with what it starts from, before its runs are made. Both
# methods get the same number of runs. The rule for choosing: highest mean over HC1 and HC2 of the
# return over the mean return of the body's five experts; within 2 % of the best, the value that is
# nearer to the paper's, else to the default (page "How the open settings were found").
_SILEM_SEARCH: tuple[_Settings, ...] = (
    # 1. T's rate
    *((("transform_learning_rate", rate),) for rate in (1e-5, 3e-5, 1e-4, 3e-4, 1e-3)),
)
_SILEM_MINUS_SEARCH: tuple[_Settings, ...] = (
    # 1. what SILEM-minus has in its place: D's penalty and rate
    *((("gradient_penalty", weight),) for weight in (0.1, 0.3, 1.0)),
    *((("disc_learning_rate", rate),) for rate in (3e-4, 3e-3)),
)


def _search(method: str, settings: tuple[_Settings, ...]) -> tuple[Cell, ...]:
    return tuple(
        Cell(_SEARCH, method, body, "HC0", chosen) for chosen in settings for body in ("HC1", "HC2")
    )


STUDIES = {
    _FIGURE_2B: Study(
        (
            *(Cell(_FIGURE_2B, "ppo", body) for body in _HALF_CHEETAHS),
            *(Cell(_FIGURE_2B, "silem", body, "HC0") for body in _HALF_CHEETAHS),
            *(Cell(_FIGURE_2B, "silem-minus", body, "HC0") for body in _HALF_CHEETAHS),
            *(Cell(_FIGURE_2B, "silem-minus-own", body, body) for body in _HALF_CHEETAHS),
            Cell(_FIGURE_2B, "silem-mlp", "HC0", "HC0"),
            *(Cell(_FIGURE_2B, "random", body) for body in _HALF_CHEETAHS),
        ),
        about="Figure 2b and Table 1",
    ),
    _FIGURE_3B: Study(
        tuple(
            Cell(_FIGURE_3B, method, body, overrides=() if method == "random" else _LARGER_STEPS)
            for method in ("ppo", "silem", "silem-minus", "peng20", "tpil", "random")
            for body in _HUMANOIDS
        ),
        about="Figures 3b, 4a and 4b",
    ),
    _HUMANOIDS_NO_PENALTY: Study(
        tuple(
            Cell(
                _HUMANOIDS_NO_PENALTY,
                method,
                body,
                overrides=(*_LARGER_STEPS, ("gradient_penalty", 0.0)),
            )
            for body in _HUMANOIDS
            for method in ("silem", "silem-minus")
        ),
        TRIAL_SEEDS[:2],
        "humanoids with the paper's loss for D, which has no gradient penalty",
    ),
    _STARTS: Study(
        (
            Cell(
                _STARTS,
                "silem",
                "Humanoid",
                overrides=(*_LARGER_STEPS, ("starts", "demonstration")),
            ),
        ),
        TRIAL_SEEDS[:1],
        "episodes that start from the demonstration's states, which the paper argues against",
    ),
    _NO_PENALTY: Study(
        tuple(
            Cell(_NO_PENALTY, method, body, "HC0", (("gradient_penalty", 0.0),))
            for method in ("silem", "silem-minus")
            for body in _HALF_CHEETAHS
        ),
        TRIAL_SEEDS[:3],
        "HalfCheetah with the paper's loss for D, which has no gradient penalty",
    ),
    _DEMONSTRATORS: Study(
        tuple(
            Cell(_DEMONSTRATORS, method, body, f"HC0_s{trial}")
            for body in ("HC1", "HC2")
            for trial in TRIAL_SEEDS
            for method in ("silem", "silem-minus")
        ),
        TRIAL_SEEDS[:1],
        "each of HC0's five experts as the demonstrator",
    ),
    _FIDELITY: Study(
        (
            *(
                Cell(_FIDELITY, "ppo", body, n_iterations=paper.common()["n_iterations"])
                for body in ("HC1", "HC2")
            ),
            Cell(_FIDELITY, "ppo", "HC0", overrides=(("clip_actions", False),)),
            Cell(_FIDELITY, "ppo", "HC0", overrides=(("anneal_clip", True),)),
        ),
        TRIAL_SEEDS[:1],
        "experts at the paper's own number of iterations, and with what differs from ppo1",
    ),
    _SEARCH: Study(
        (*_search("silem", _SILEM_SEARCH), *_search("silem-minus", _SILEM_MINUS_SEARCH)),
        SEARCH_SEEDS,
        "what the paper leaves open, on HC1 and HC2",
    ),
}


def cells(study: str) -> list[Cell]:
    """Return a study's cells, experts first.

    Raises:
        SilemError: There is no such study.
    """
    return list(STUDIES[choose("study", study, STUDIES)].cells)


def seeds_of(study: str, budget: Budget, n_trials: int | None = None) -> tuple[int, ...]:
    """Return the root seeds of a study's trials; None means as many as budget and study have.

    Raises:
        SilemError: There is no such study, or it has fewer trials than wanted.
    """
    seeds = STUDIES[choose("study", study, STUDIES)].seeds
    if n_trials is None:
        return seeds[: budget.n_trials]
    if not 1 <= n_trials <= len(seeds):
        raise SilemError(f"trials of {study} must be 1 to {len(seeds)}, not {n_trials}")
    return seeds[:n_trials]


def study_configs(
    study: str, budget: str | Budget, n_trials: int | None = None, **only: Sequence[str] | None
) -> list[RunConfig]:
    """Return the runs of a study: the first trial of every cell before any second.

    Args:
        study: The study.
        budget: A budget's name, or a `Budget`.
        n_trials: Trials per cell; None means as many as the budget and the study have.
        **only: ``method=[...]`` and ``body=[...]`` keep those cells alone.

    Raises:
        SilemError: An unknown study or budget, or more trials than there are fixed seeds.
    """
    budget = budget_named(budget)
    seeds = seeds_of(study, budget, n_trials)
    for name, wanted in only.items():
        allowed = dict.fromkeys(getattr(cell, name) for cell in cells(study))
        for value in wanted or ():
            choose(name, value, allowed)
    kept = [
        cell
        for cell in cells(study)
        if all(getattr(cell, name) in wanted for name, wanted in only.items() if wanted)
    ]
    return [cell.config(budget, seed) for seed in seeds for cell in kept]


def status_table(study: str, budget: Budget) -> str:
    """Return a text table of a study's cells by trials: finished, running, part or missing."""
    seeds = seeds_of(study, budget)
    lines = [f"{study}, budget {budget.name}, trials by seed:"]
    lines.append(f"{'':34}" + "".join(f"{seed:<10}" for seed in seeds))
    for cell in cells(study):
        source = f" from {cell.demonstrations}" if cell.demonstrations else ""
        states = [runs.state(cell.config(budget, seed)) for seed in seeds]
        settings = "".join(f" {name}={value}" for name, value in cell.overrides)
        name = f"{cell.method} {cell.body}{source}{settings if study == _SEARCH else ''}"
        lines.append(f"{name:34}" + "".join(f"{state:<10}" for state in states))
    return "\n".join(lines)
