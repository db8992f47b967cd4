"""The runs' records as one table, checked: what every figure, table and verdict reads.

A figure's runs are those that a study plans: its cells with the supplement's hyper-parameters, one
budget, and the trial seeds that were fixed beforehand. Planned runs that are not there are listed
as missing and runs of other settings as set aside; neither is passed over in silence.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from silem import bodies, files, paths
from silem.config import BUDGETS, METHODS, ORIGINAL_BODIES, TRIAL_SEEDS, RunConfig
from silem.errors import SilemError, choose
from silem.report.validation import validate
from silem.study import runs
from silem.study.curve import COLUMNS as CURVE_COLUMNS
from silem.study.record import CURVE, RECORD, TRANSFORM, RunRecord
from silem.study.studies import cells, study_configs

KEYS = ["body", "method", "demonstrations", "seed"]
COLUMNS = [
    "run_id", *KEYS, "return_mean", "return_std", "normalised", "expert_return", "speed_m_s",
    "upright", "disc_reward", "n_eval_episodes", "n_iterations", "n_steps", "steps_per_s",
    "wall_time_s", "commit", "dirty", "command", "returns", "folder",
]  # fmt: skip


def load_records(study: str = "halfcheetah", budget: str = "book") -> pd.DataFrame:
    """Load a study's finished runs at one budget, one row per run.

    A run counts if it is one that the study plans (see the module). At the budgets whose runs are
    evidence only the published records count, and only the seeds fixed beforehand; at the smaller
    ones also the working folder's, with any seed. The random policy counts once per body, because
    every evaluation meets the same episodes.

    Args:
        study: The study.
        budget: The budget.

    Returns:
        One row per run with `COLUMNS`. ``return_mean`` is the ground-truth return over the
        evaluation episodes; ``normalised`` divides it by ``expert_return``, the mean return of the
        same body's PPO experts in the table (paper, Figure 2), and is NaN where there is none or
        where it is not positive, so that a ratio would mean nothing; ``disc_reward`` is the
        discriminator's reward of an episode. ``attrs`` holds ``study``, ``budget``, ``missing``
        (a list of dicts with `KEYS`, ``run_id`` and ``command``) and ``set_aside`` (run ids).

    Raises:
        SilemError: Unknown study or budget, or a record that `silem.report.validation` refuses.
    """
    choose("budget", budget, BUDGETS)
    planned = {c.run_id: c for c in study_configs(study, budget) if not _is_copy(c)}
    rows, set_aside = [], []
    for record in _records(study, budget):
        if _is_planned(record, study, budget):
            rows.append(_row(record))
        elif not _is_copy(record.run_config()):
            set_aside.append(record.run_id)
    frame = pd.DataFrame(rows, columns=COLUMNS)
    frame = _with_scores(frame.sort_values(KEYS, key=_order).reset_index(drop=True))
    present = set(frame["run_id"])
    missing = [_keys(c) for run_id, c in planned.items() if run_id not in present]
    frame.attrs = {"study": study, "budget": budget, "missing": missing, "set_aside": set_aside}
    return frame


def context(frame: pd.DataFrame) -> tuple[str, str]:
    """Return a table's study and budget.

    Raises:
        SilemError: The table was put together from several budgets, or not by `load_records`.
    """
    if "budget" not in frame.attrs:
        raise SilemError("not a table of one study at one budget: load it with load_records")
    for body, group in frame.groupby("body"):
        counts = group.loc[group["method"] != "random", "n_iterations"].unique()
        if len(counts) > 1:
            raise SilemError(f"mixed budgets on {body}: runs of {sorted(counts)} iterations")
    return frame.attrs["study"], frame.attrs["budget"]


def select(
    frame: pd.DataFrame, methods: Sequence[str], names: Sequence[str] | None = None
) -> pd.DataFrame:
    """Keep some methods' runs, and some bodies'; the missing runs are narrowed alike.

    Args:
        frame: Runs of one study at one budget.
        methods: The methods to keep.
        names: The bodies to keep; None keeps all.
    """
    context(frame)

    def keeps(method: str, body: str) -> bool:
        return method in methods and (names is None or body in names)

    kept = [keeps(row.method, row.body) for row in frame.itertuples()]
    missing = [run for run in frame.attrs["missing"] if keeps(run["method"], run["body"])]
    narrowed = frame[np.array(kept, dtype=bool)].reset_index(drop=True)
    narrowed.attrs = frame.attrs | {"missing": missing}
    if names is not None:
        narrowed.attrs["bodies"] = list(names)
    return narrowed


def missing_runs(frame: pd.DataFrame) -> pd.DataFrame:
    """List the planned runs that are not in a table, with the command that makes each."""
    return pd.DataFrame(frame.attrs["missing"], columns=[*KEYS, "run_id", "command"])


def body_names(frame: pd.DataFrame) -> list[str]:
    """List the bodies of a table's study, or those selected, in the registry's order."""
    study, _ = context(frame)
    known = {cell.body for cell in cells(study)}
    kept = known & set(frame.attrs.get("bodies", known))
    return [name for name in bodies.names() if name in kept]


def original_body(frame: pd.DataFrame) -> str:
    """Return the body whose expert demonstrates to the others, e.g. HC0."""
    return ORIGINAL_BODIES[bodies.get(body_names(frame)[0]).family]


def is_planned(frame: pd.DataFrame, method: str, body: str) -> bool:
    """Tell whether a table's study has a cell for a method on a body."""
    study, _ = context(frame)
    return any(cell.method == method and cell.body == body for cell in cells(study))


def cell(frame: pd.DataFrame, method: str, body: str) -> pd.DataFrame:
    """Return the rows of one cell: a method on a body, one row per trial."""
    return frame[(frame["method"] == method) & (frame["body"] == body)]


def scores(frame: pd.DataFrame, method: str, body: str, column: str = "normalised") -> np.ndarray:
    """Return one cell's values in a column that are known, shape (N,)."""
    return cell(frame, method, body)[column].dropna().to_numpy(dtype=np.float64)


def load_curve(run_id: str) -> pd.DataFrame:
    """Load a run's learning curve (columns of `silem.study.curve`), NaN where blank.

    Raises:
        SilemError: There is no such run, or its curve is not the file that was recorded.
    """
    curve = pd.read_csv(find(run_id).file(CURVE))
    if tuple(curve.columns) != CURVE_COLUMNS:
        raise SilemError(f"the curve of {run_id} has columns {', '.join(curve.columns)}")
    return curve


def load_transform(run_id: str) -> dict[str, np.ndarray]:
    """Load a run's learned affine transform: ``A`` (F,), the diagonal, and ``b`` (F,).

    Raises:
        SilemError: There is no such run, it learned no affine transform, or the file is damaged.
    """
    return files.read_npz(find(run_id).file(TRANSFORM))


def find(run_id: str) -> RunRecord:
    """Return the record of a finished run.

    Raises:
        SilemError: There is none.
    """
    record = runs.find(run_id)
    if record is None:
        raise SilemError(f"there is no finished run {run_id!r}")
    return record


def _records(study: str, budget: str) -> Iterator[RunRecord]:
    """Yield the valid records of a study at a budget, each once, published ones first."""
    folders = [paths.results_dir(study)]
    if not is_evidence(budget):
        folders.append(paths.runs_dir() / study)
    seen = set()
    for folder in folders:
        for path in sorted(folder.glob(f"*/{RECORD}")):
            name = _budget_name(path)
            if path.parent.name not in seen and name.partition("-")[0] == budget:
                seen.add(path.parent.name)
                yield validate(path.parent)


def _budget_name(path: Path) -> str:
    content = files.read_json(path)
    try:
        return str(content["config"]["budget"]["name"])
    except (KeyError, TypeError) as error:
        raise SilemError(f"{path} is no run record: it names no budget") from error


def _is_copy(config: RunConfig) -> bool:
    """Tell whether a run repeats another: the random policy's trials all meet one seed."""
    return config.method == "random" and config.seed != TRIAL_SEEDS[0]


def _is_planned(record: RunRecord, study: str, budget: str) -> bool:
    """Tell whether a record is of a planned configuration, and not one of other settings."""
    config = record.run_config()
    if _is_copy(config) or (is_evidence(budget) and config.seed not in TRIAL_SEEDS):
        return False
    return any(
        cell.config(budget, config.seed).run_id == record.run_id
        for cell in cells(study)
        if (cell.method, cell.body) == (config.method, config.body)
    )


def _row(record: RunRecord) -> dict[str, Any]:
    evaluation, training, source = record.evaluation, record.training, record.provenance
    return {
        **_keys(record.run_config()),
        "return_mean": evaluation["return_mean"],
        "return_std": evaluation["return_std"],
        "speed_m_s": evaluation["speed_m_s"],
        "upright": evaluation["upright"],
        "disc_reward": evaluation["disc_reward_mean"],
        "n_eval_episodes": evaluation["n_episodes"],
        "n_iterations": record.config["budget"]["n_iterations"],
        "n_steps": training["n_steps"],
        "steps_per_s": training["steps_per_s"],
        "wall_time_s": record.wall_time_s,
        "commit": source["git_commit"] or "unknown",
        "dirty": source["git_dirty"],
        "returns": tuple(evaluation["returns"]),
        "folder": str(record.folder),
    }


def _keys(config: RunConfig) -> dict[str, Any]:
    return {
        "body": config.body,
        "method": config.method,
        "demonstrations": config.demonstrations,
        "seed": config.seed,
        "run_id": config.run_id,
        "command": config.command,
    }


def _with_scores(frame: pd.DataFrame) -> pd.DataFrame:
    experts = frame[frame["method"] == "ppo"].groupby("body")["return_mean"].mean()
    expert_return = frame["body"].map(experts).astype(float)
    normalised = frame["return_mean"].astype(float) / expert_return.where(expert_return > 0)
    disc_reward = frame["disc_reward"].astype(float)
    return frame.assign(expert_return=expert_return, normalised=normalised, disc_reward=disc_reward)


def _order(column: pd.Series) -> pd.Series:
    """Sort bodies by the registry and methods as they are declared, not by the alphabet."""
    ranks = {"body": bodies.names(), "method": list(METHODS)}
    if column.name not in ranks:
        return column
    return column.map(ranks[column.name].index)


def describe(frame: pd.DataFrame) -> str:
    """Say in one line what a table holds: budget, iterations, runs, missing runs."""
    _, budget = context(frame)
    parts = [f"budget {budget}"]
    counts = sorted(frame.loc[frame["method"] != "random", "n_iterations"].unique())
    if counts:
        parts[0] += f" ({' or '.join(f'{count:,}' for count in counts)} iterations)"
    parts.append(f"{len(frame)} run{'' if len(frame) == 1 else 's'}")
    if frame.attrs["missing"]:
        parts.append(f"{len(frame.attrs['missing'])} of the planned runs not made yet")
    return ", ".join(parts)


def is_evidence(budget: str) -> bool:
    """Tell whether a budget's runs are published and may decide a claim."""
    return BUDGETS[budget].is_evidence
