"""Loading a study's records: which runs count, which are missing, which are set aside."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import Any

import pandas as pd

from silem import bodies
from silem.study import runs
from silem.study.config import TRIAL_SEEDS, RunConfig
from silem.study.demonstrate import experts
from silem.study.record import RECORD, RunRecord
from silem.study.settings import BUDGETS, METHODS
from silem.study.studies import cells, study_configs
from silem.study.verify import check
from silem.util import paths
from silem.util.errors import choose

KEYS = ["body", "method", "demonstrations", "seed"]
_EVALUATED = ("return_mean", "return_std", "speed_m_s", "upright")
_TRAINED = ("n_steps", "steps_per_s")
COLUMNS = [
    *KEYS, "run_id", "command", *_EVALUATED, "disc_reward", "n_iterations", "planned_iterations",
    "stand_in", *_TRAINED, "wall_time_s", "commit", "dirty", "returns", "folder",
    "expert_return", "normalised",
]  # fmt: skip


def load_records(study: str = "halfcheetah", budget: str = "book") -> pd.DataFrame:
    """Load a study's finished runs at one budget, one row per run.

    A run counts if it is one that the study plans (see `silem.report.results`). At the budgets
    whose runs are evidence only the published records count, and only the seeds fixed beforehand;
    at the smaller ones also the working folder's, with any seed. The random policy counts once per
    body, because every evaluation meets the same episodes.

    A planned run that is not finished may be stood in for by the longest run that differs from it
    in nothing but its number of iterations (`Budget.with_iterations`). It is a ``stand_in``, its
    planned run stays listed as missing, and `results.cell` leaves it out.

    Args:
        study: The study.
        budget: The budget.

    Returns:
        One row per run with `COLUMNS`. ``return_mean`` is the ground-truth return over the
        evaluation episodes; ``normalised`` divides it by ``expert_return``, the mean return of the
        same body's PPO experts (paper, Figure 2), which another study may have trained, and is NaN
        where there is none or where it is not positive, so that a ratio would mean nothing;
        ``disc_reward`` is the discriminator's reward of an episode; ``planned_iterations`` are
        those of the study's plan.
        ``attrs`` holds ``study``, ``budget``, ``missing`` (a list of dicts with `KEYS`, ``run_id``
        and ``command``) and ``set_aside`` (run ids).

    Raises:
        SilemError: Unknown study or budget, or a record that `silem.study.verify` refuses.
    """
    choose("budget", budget, BUDGETS)
    plans = [plan for plan in study_configs(study, budget) if not _is_copy(plan)]
    exact: list[tuple[RunRecord, RunConfig]] = []
    others: dict[str, list[RunRecord]] = {}  # of another number of iterations, by the plan's id
    set_aside = []
    for record in _records(study, budget):
        config = record.run_config()
        plan = _plan(config, plans)
        if plan is None:
            set_aside += [] if _is_copy(config) else [record.run_id]
        elif plan.run_id == record.run_id:
            exact.append((record, plan))
        else:
            others.setdefault(plan.run_id, []).append(record)
    done = {plan.run_id for _, plan in exact}
    missing = [plan for plan in plans if plan.run_id not in done]
    for plan in missing:
        if stand_ins := sorted(others.pop(plan.run_id, []), key=_n_iterations):
            exact.append((stand_ins.pop(), plan))
            set_aside += [record.run_id for record in stand_ins]
    set_aside += [record.run_id for records in others.values() for record in records]
    rows = [_row(record, plan) for record, plan in exact]
    frame = pd.DataFrame(rows, columns=COLUMNS).astype({"stand_in": bool})
    frame = frame.sort_values(KEYS, key=_order).reset_index(drop=True)
    frame = _with_scores(frame, study, budget)
    frame.attrs = {"study": study, "budget": budget, "missing": [_keys(plan) for plan in missing]}
    frame.attrs["set_aside"] = set_aside
    return frame


def _records(study: str, budget: str) -> Iterator[RunRecord]:
    """Yield the valid records of a study at a budget, each once, published ones first."""
    folders = [paths.results_dir(study)]
    if not BUDGETS[budget].is_evidence:
        folders.append(paths.runs_dir() / study)
    seen = set[str]()
    for path in (path for folder in folders for path in sorted(folder.glob(f"*/{RECORD}"))):
        if path.parent.name not in seen:
            seen.add(path.parent.name)
            record = check(path.parent)
            if record.run_config().budget.base_name == budget:
                yield record


def _is_copy(config: RunConfig) -> bool:
    """Tell whether a run repeats another: the random policy's trials all meet one seed."""
    return config.method == "random" and config.seed != TRIAL_SEEDS[0]


def _plan(config: RunConfig, plans: Sequence[RunConfig]) -> RunConfig | None:
    """Return the planned run that a run is, whatever its number of iterations; None for others.

    Where runs are no evidence, their seeds need not be planned.
    """
    if _is_copy(config):
        return None
    for plan in plans:
        if (plan.method, plan.body) == (config.method, config.body):
            if not plan.budget.is_evidence:
                plan = dataclasses.replace(plan, seed=config.seed)
            resized = plan.budget.with_iterations(config.budget.n_iterations)
            if config.run_id in (plan.run_id, dataclasses.replace(plan, budget=resized).run_id):
                return plan
    return None


def _n_iterations(record: RunRecord) -> int:
    return int(record.config["budget"]["n_iterations"])


def _row(record: RunRecord, plan: RunConfig) -> dict[str, Any]:
    evaluation, source = record.evaluation, record.provenance
    return {
        **_keys(record.run_config()),
        **{name: evaluation[name] for name in _EVALUATED},
        **{name: record.training[name] for name in _TRAINED},
        "disc_reward": evaluation["disc_reward_mean"],
        "n_iterations": _n_iterations(record),
        "planned_iterations": plan.budget.n_iterations,
        "stand_in": record.run_id != plan.run_id,
        "wall_time_s": record.wall_time_s,
        "commit": source["git_commit"] or "unknown",
        "dirty": source["git_dirty"],
        "returns": tuple(evaluation["returns"]),
        "folder": str(record.folder),
    }


def _keys(config: RunConfig) -> dict[str, Any]:
    return {name: getattr(config, name) for name in (*KEYS, "run_id", "command")}


def _with_scores(frame: pd.DataFrame, study: str, budget: str) -> pd.DataFrame:
    if any(cell.method == "ppo" for cell in cells(study)):
        trained = frame[(frame["method"] == "ppo") & ~frame["stand_in"]]
        level = trained.groupby("body")["return_mean"].mean()
    else:
        level = pd.Series({body: _expert_level(body, budget) for body in frame["body"].unique()})
    expert_return = frame["body"].map(level).astype(float)
    normalised = frame["return_mean"].astype(float) / expert_return.where(expert_return > 0)
    disc_reward = frame["disc_reward"].astype(float)
    return frame.assign(expert_return=expert_return, normalised=normalised, disc_reward=disc_reward)


def _expert_level(body: str, budget: str) -> float:
    """Return the mean return of a body's experts, which another study trains."""
    found = [runs.find(config.run_id) for config in experts(body, budget)]
    returns = [record.evaluation["return_mean"] for record in found if record is not None]
    return sum(returns) / len(returns) if returns else math.nan


def _order(column: pd.Series) -> pd.Series:
    """Sort bodies by the registry and methods as they are declared, not by the alphabet."""
    ranks = {"body": bodies.names(), "method": list(METHODS)}
    if column.name not in ranks:
        return column
    return column.map(ranks[column.name].index)
