"""The runs' records as one table, checked: what every figure, table and verdict reads.

A figure's runs are those that a study plans: its cells with the supplement's hyper-parameters, one
budget, and the trial seeds that were fixed beforehand. Planned runs that are not there are listed
as missing and runs of other settings as set aside; neither is passed over in silence. Everywhere
`frame` is such a table, of one study at one budget, and a cell a method on a body.
"""

import base64
import dataclasses
from collections.abc import Iterator, Sequence
from html import escape
from itertools import chain, product
from typing import Any

import numpy as np
import pandas as pd
from IPython.display import HTML

from silem import bodies
from silem.report import style
from silem.study import runs
from silem.study.config import SEARCH, TRIAL_SEEDS, RunConfig
from silem.study.runs import CURVE, CURVE_COLUMNS, TRANSFORM, RunRecord
from silem.study.settings import BUDGETS, FAMILIES, METHODS
from silem.study.studies import cells, experts, folder_of, narrowed, study_configs
from silem.study.verify import check
from silem.util import files
from silem.util.errors import SilemError, choose

_KEYS = ["body", "method", "demonstrations", "seed"]
_EVALUATED = ["return_mean", "speed_m_s", "upright"]
COLUMNS = [
    *_KEYS, "run_id", "command", *_EVALUATED, "steps", "disc_reward", "n_iterations",
    "n_steps", "wall_time_s", "processor_time_s", "commit", "dirty", "returns", "expert_return",
    "normalised",
]  # fmt: skip
PAPER_LOSS = {
    "halfcheetah": "no-gradient-penalty", "humanoids": "humanoids-no-gradient-penalty",
}  # fmt: skip
"""The study that has a study's cells with the paper's loss for D, without our gradient penalty."""

_WITHOUT_D = ("ppo", "random")


class _Kept(list[Any]):
    """What a table carries along: pandas copies ``attrs`` deeply in everything that it does."""

    def __deepcopy__(self, memo: dict[int, Any]) -> "_Kept":
        return self


def load_records(
    study: str = "halfcheetah", budget: str = "book", n_iterations: int = 0, **which: Any
) -> pd.DataFrame:
    """Load a study's finished runs at one budget, one row per run; SilemError for a broken record.

    At the budgets whose runs are evidence only the published records count, and only the seeds
    fixed beforehand; at the smaller ones also the working folder's, with any seed. The random
    policy counts once per body, because every evaluation meets the same episodes. A search,
    STUDY/BODY/METHOD, is a study too: `which` is what else `study_configs` takes, and
    `n_iterations`, if not 0, stands for the budget's.

    Returns:
        `COLUMNS`. ``return_mean`` is the ground-truth return over the evaluation episodes,
        ``normalised`` its ratio to ``expert_return``, the mean return of the same body's PPO
        experts (paper, Figure 2), NaN where that is not above zero; ``disc_reward`` and ``steps``
        (NaN where a record does not say) are of an episode. ``attrs`` holds ``study``, ``budget``,
        ``missing`` (what was planned, a list of dicts) and ``set_aside`` (run ids).
    """
    choose("budget", budget, BUDGETS)
    sized = BUDGETS[budget].with_iterations(n_iterations) if n_iterations else BUDGETS[budget]
    plans = [plan for plan in study_configs(study, sized, **which) if not _is_copy(plan)]
    planned, rows, set_aside = {plan.run_id for plan in plans}, [], []
    for record in _records(folder_of(study), budget):
        config = record.run_config
        if _is_copy(config):
            continue
        if record.run_id in planned or _is_of_other_seed(config, plans):
            rows.append(_row(record, config))
        else:
            set_aside.append(record.run_id)
    frame = pd.DataFrame(rows, columns=COLUMNS[:-2])
    frame = frame.astype(dict.fromkeys(("disc_reward", "steps", "processor_time_s"), float))
    frame = frame.sort_values(_KEYS, key=_order, ignore_index=True)
    made = set(frame["run_id"])
    missing = _Kept(_keys(plan) for plan in plans if plan.run_id not in made)
    frame = _with_scores(frame, study, budget)
    frame.attrs = {"study": study, "budget": budget, "missing": missing}
    frame.attrs["set_aside"] = _Kept(sorted(set_aside))
    return frame


def paper_loss(frame: pd.DataFrame) -> pd.DataFrame | None:
    """Return a study's runs with the paper's loss for D, where it has any, and those without D."""
    study, budget = context(frame)
    if study not in PAPER_LOSS:
        return None
    other = load_records(PAPER_LOSS[study], budget)
    shared = frame[frame["method"].isin(_WITHOUT_D)]
    both = joined([other, shared])
    both.attrs = other.attrs | {"shared": _WITHOUT_D}
    return both


def joined(frames: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Put tables below each other, each run once; empty ones would change the columns' types."""
    found = pd.concat([f for f in frames if len(f)] or frames[:1])
    return found.drop_duplicates("run_id", ignore_index=True)


def _records(study: str, budget: str) -> Iterator[RunRecord]:
    """Yield the valid records in a study's folder at a budget, each once: published ones first."""
    working = [] if BUDGETS[budget].is_evidence else runs.recorded(study, working=True)
    found = {folder.name: folder for folder in (*working, *runs.recorded(study))}
    for record in (check(found[name], with_files=False) for name in sorted(found)):
        if record.run_config.budget.base_name == budget:
            yield record


def _is_copy(config: RunConfig) -> bool:
    """Tell whether a run repeats another: the random policy's trials all meet one seed."""
    return config.method == "random" and config.seed != TRIAL_SEEDS[0]


def _is_of_other_seed(config: RunConfig, plans: Sequence[RunConfig]) -> bool:
    """Tell whether a run that is no evidence is a planned one but for its seed."""
    alike = (p for p in plans if (p.method, p.body) == (config.method, config.body))
    return not config.budget.is_evidence and any(
        dataclasses.replace(plan, seed=config.seed).run_id == config.run_id for plan in alike
    )


def _keys(config: RunConfig) -> dict[str, Any]:
    return {name: getattr(config, name) for name in (*_KEYS, "run_id", "command")}


def _row(record: RunRecord, config: RunConfig) -> dict[str, Any]:
    evaluation, source = record.evaluation, record.provenance
    return _keys(config) | {
        **{name: evaluation[name] for name in _EVALUATED},
        "steps": evaluation.get("steps_mean", np.nan),
        "disc_reward": evaluation["disc_reward_mean"],
        "n_iterations": config.budget.n_iterations,
        "n_steps": record.training["n_steps"],
        "wall_time_s": record.wall_time_s,
        "processor_time_s": record.processor_time_s,
        "commit": source["git_commit"] or "unknown",
        "dirty": source["git_dirty"],
        "returns": tuple(evaluation["returns"]),
    }


def _with_scores(frame: pd.DataFrame, study: str, budget: str) -> pd.DataFrame:
    """Add the level of each body's experts, which another study may have trained, and the ratio."""
    if any(cell.method == "ppo" for cell in cells(study)):
        known = frame[frame["method"].eq("ppo")]
    else:
        plans = chain.from_iterable(experts(body, budget) for body in frame["body"].unique())
        found = [(plan.body, runs.find(plan.run_id)) for plan in plans]
        returns = [(body, run.evaluation["return_mean"]) for body, run in found if run]
        known = pd.DataFrame(returns, columns=["body", "return_mean"])
    level = known.groupby("body")["return_mean"].mean()
    expert_return = frame["body"].map(level).astype(float)
    normalised = frame["return_mean"].astype(float) / expert_return.where(expert_return > 0)
    return frame.assign(expert_return=expert_return, normalised=normalised)


def _order(column: pd.Series) -> pd.Series:
    """Sort bodies by the registry and methods as they are declared, not by the alphabet."""
    if column.name == "body":
        return column.map(_sorted(set(column)).index)
    return column.map(list(METHODS).index) if column.name == "method" else column


def _sorted(names: set[str]) -> list[str]:
    """Sort bodies as the registry does, then those that their names describe, by their numbers."""

    def numbers(name: str) -> tuple[Any, ...]:
        body = bodies.get(name)
        return body.family, body.slope_deg, body.length[1], name

    known = [name for name in bodies.names() if name in names]
    return known + sorted(names - set(known), key=numbers)


def context(frame: pd.DataFrame) -> tuple[str, str]:
    """Return a table's study and budget; SilemError if it is no such table."""
    if "budget" not in frame.attrs:
        raise SilemError("not a table of one study at one budget: load it with load_records")
    return frame.attrs["study"], frame.attrs["budget"]


def trained(frame: pd.DataFrame) -> pd.DataFrame:
    """Keep the runs that were trained."""
    return frame[frame["method"] != "random"]


def describe(frame: pd.DataFrame) -> str:
    """Say in one line what a table holds: budget, iterations, runs, missing runs."""
    parts = [f"budget {context(frame)[1]}"]
    by_body = trained(frame).groupby("body")["n_iterations"].first()
    if by_body.nunique() == 1:
        parts[0] += f" ({by_body.iloc[0]:,} iterations)"
    elif len(by_body):
        listing = ", ".join(f"{body} {count:,}" for body, count in by_body.items())
        parts[0] += f" (iterations: {listing})"
    parts.append(f"{len(frame)} run{'' if len(frame) == 1 else 's'}")
    if frame.attrs["missing"]:
        parts.append(f"{len(frame.attrs['missing'])} of the planned runs not made yet")
    return ", ".join(parts)


def trace(frame: pd.DataFrame) -> HTML:
    """Return the tracing line of the runs that a figure shows, with folded lists of them.

    The lists are the runs with the command that reruns each, the planned runs that are not made yet
    with the command that makes each, and the runs that were set aside.
    """
    study, budget = context(frame)
    line = describe(frame) + (f"; {commits(frame)}" if len(frame) else "")
    folder = folder_of(study)
    kept = BUDGETS[budget].is_evidence or folder.startswith(SEARCH)
    where = f"records in data/results/{folder}" if kept else "local runs"
    missing, aside = frame.attrs["missing"], [{"run_id": n} for n in frame.attrs["set_aside"]]
    folded = {
        f"the runs, and how to rerun each ({where})": frame.to_dict("records"),
        f"planned runs that are not made yet ({len(missing)})": missing,
        f"runs of other settings or seeds, not shown ({len(aside)})": aside,
    }
    page = f'<div class="silem-trace"><p class="silem-trace-line">{escape(line)}</p>'
    page += links(frame) if len(frame) else ""
    for summary, shown in folded.items():
        texts = [[run[name] for name in ("run_id", "command") if name in run] for run in shown]
        codes = ["<br>".join(f"<code>{escape(text)}</code>" for text in pair) for pair in texts]
        if items := "".join(f"<li>{code}</li>" for code in codes):
            page += f"<details><summary>{escape(summary)}</summary><ul>{items}</ul></details>"
    return HTML(f"{page}</div>")


def links(frame: pd.DataFrame) -> str:
    """Return the line of links under a figure, and what its runs cost.

    The data is a file in the page itself; ``silem.js`` adds the figure and what its buttons do.
    """
    name = frame.attrs.get("figure", f"{frame.attrs['study'].replace('/', '-')}_runs")
    data = base64.b64encode(figure_data(frame).to_csv(index=False).encode()).decode()
    return (
        f'<p class="silem-links" data-name="{name}">'
        f'<a download="{name}.csv" href="data:text/csv;base64,{data}">data (CSV)</a>'
        ' <button type="button" class="silem-copy">copy the commands</button>'
        f" <span>{hours(frame)}</span></p>"
    )


def hours(runs: pd.DataFrame) -> str:
    """Say what some runs cost: processor time, and wall time of runs that did not count it."""
    without = runs[runs["processor_time_s"].isna()]
    wall = f"{without['wall_time_s'].sum() / 3600:.1f} hours of wall time"
    if len(without) == len(runs) > 0:
        return wall
    words = f"{runs['processor_time_s'].sum() / 3600:.1f} CPU hours"
    if len(without):
        older = style.trials(len(without)).replace("trial", "older trial")
        words += f", and {wall} for {older} without a CPU count"
    return words


def figure_data(frame: pd.DataFrame) -> pd.DataFrame:
    """Return what a figure is drawn from: its runs, their curves, or the T that they learned."""
    figure = frame.attrs.get("figure")
    if figure == "learning_curves":
        parts = [load_curve(run).assign(run_id=run) for run in frame["run_id"]]
        return pd.concat(parts, ignore_index=True)
    if figure == "by_feature":
        from silem.report.transforms import learned  # which reads results

        return learned(frame)
    return frame.drop(columns=["returns"])


def commits(frame: pd.DataFrame) -> str:
    """Name the commits that a table's runs were made with, and say where code had been changed."""
    changed = frame["dirty"].eq(True).groupby(frame["commit"], sort=False).any()
    names = [f"{name[:7]}{' with uncommitted changes' * dirty}" for name, dirty in changed.items()]
    return f"commit{'s' if len(names) > 1 else ''} {', '.join(names)}"


def n_trials(frame: pd.DataFrame) -> int:
    """Return how many trials a table's study plans for each cell at its budget."""
    return len(narrowed(frame.attrs["study"], frame.attrs["budget"]).seeds)


def body_names(frame: pd.DataFrame) -> list[str]:
    """List the bodies of a table's study in the registry's order, or those selected in theirs."""
    known = {cell.body for cell in cells(frame.attrs["study"])}
    return [name for name in frame.attrs.get("bodies", _sorted(known)) if name in known]


def original_body(frame: pd.DataFrame) -> str:
    """Return the body whose expert demonstrates to the others, e.g. HC0; "" where a human does."""
    demonstrator = FAMILIES[bodies.get(body_names(frame)[0]).family].original
    return demonstrator if demonstrator in bodies.names() else ""


def can_fall(frame: pd.DataFrame) -> bool:
    """Tell whether episodes of a table's bodies can end early."""
    return bodies.get(body_names(frame)[0]).can_fall


def is_planned(frame: pd.DataFrame, method: str, body: str) -> bool:
    """Tell whether a table's study has a cell, or shares another study's."""
    planned = {(cell.method, cell.body) for cell in cells(frame.attrs["study"])}
    return method in frame.attrs.get("shared", ()) or (method, body) in planned


def select(
    frame: pd.DataFrame, methods: Sequence[str], names: Sequence[str] | None = None
) -> pd.DataFrame:
    """Keep some methods' runs, and some bodies' (None: all), and so of the missing runs."""
    shown = list(names or body_names(frame))
    kept = frame["method"].isin(methods) & frame["body"].isin(shown)
    narrowed = frame[kept].reset_index(drop=True)
    missing = frame.attrs["missing"]
    missing = _Kept(r for r in missing if r["method"] in methods and r["body"] in shown)
    narrowed.attrs = frame.attrs | {"missing": missing, "bodies": shown}
    return narrowed


def cell(frame: pd.DataFrame, method: str, body: str) -> pd.DataFrame:
    """Return the rows of one cell, one per trial."""
    return frame[frame["method"].eq(method) & frame["body"].eq(body)]


def planned(
    frame: pd.DataFrame, methods: Sequence[str] = tuple(style.METHODS)
) -> Iterator[tuple[str, str, pd.DataFrame]]:
    """Yield every cell that is planned, body by body: its body, its method and its runs."""
    for body, method in product(body_names(frame), methods):
        if is_planned(frame, method, body):
            yield body, method, cell(frame, method, body)


def scores(frame: pd.DataFrame, method: str, body: str, column: str = "normalised") -> np.ndarray:
    """Return one cell's values in a column that are known, shape (N,)."""
    return cell(frame, method, body)[column].dropna().to_numpy(dtype=np.float64)


def values(frame: pd.DataFrame, method: str, body: str, quantity: str) -> np.ndarray:
    """Return one cell's values of a quantity that a claim is about, one for each trial, (N,).

    `quantity` is a column; ``"returns"``, the episodes of a policy that is not trained, which are
    its replicates; or an entry of T, the mean over the features whose names begin so: ``"b pitch"``
    of a runner, ``"A left_hand"`` of a humanoid, or a difference, ``"b left_elbow - right_elbow"``.
    """
    from silem.report import transforms  # which reads results

    found = cell(frame, method, body)
    if quantity == "returns":
        return np.array(found["returns"].iloc[0]) if len(found) else np.empty(0)
    key, _, parts = quantity.partition(" ")
    if not parts:
        return scores(frame, method, body, quantity)
    rows = transforms.learned(found)
    one, *other = (
        rows[rows["feature"].str.startswith(part)].groupby("run_id", sort=False)[key].mean()
        for part in parts.replace("_", " ").split(" - ")
    )
    return (one - other[0] if other else one).to_numpy(float)


find = runs.get
"""The record of a finished run; SilemError if there is none."""


def load_curve(run_id: str) -> pd.DataFrame:
    """Load a run's learning curve, its columns `CURVE_COLUMNS`, NaN where blank or not kept."""
    curve = pd.DataFrame(files.read_csv(find(run_id).file(CURVE)))
    if list(curve.columns) != [name for name in CURVE_COLUMNS if name in curve.columns]:
        raise SilemError(f"the curve of {run_id} has columns {', '.join(curve.columns)}")
    return curve.reindex(columns=CURVE_COLUMNS)


def load_transform(run_id: str) -> dict[str, np.ndarray]:
    """Load a run's learned affine transform: ``A`` (F,), the diagonal, and ``b`` (F,)."""
    return files.read_npz(find(run_id).file(TRANSFORM))
