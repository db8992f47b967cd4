"""The page of what the book cost: runs, steps, hours, counted from the published records."""

import dataclasses
from typing import Any

import numpy as np
import pandas as pd
from pandas.io.formats.style import Styler

from silem import bodies
from silem.report import style
from silem.report.style import DASH, number
from silem.report.tables import styled
from silem.study.runs import RECORD, RunRecord, git, recorded
from silem.study.studies import STUDIES, study_configs

_COLUMNS = ("study", "family", "method", "cell", "steps", "wall_time_s", "processor_time_s",
            "speed", "processor", "date")  # fmt: skip


def runs(budget: str = "book") -> pd.DataFrame:
    """Return every published run and every one that a study plans at a budget, a row each.

    Steps are in millions. What only a record tells, the times among it, is NaN where there is none.
    """
    made = {folder.name: RunRecord.load(folder) for folder in recorded()}
    dates, rows = _published(), list[dict[str, Any]]()
    plans = [plan for study in STUDIES for plan in study_configs(study, budget)]
    every = {c.run_id: c for c in [*plans, *(record.run_config for record in made.values())]}
    for run_id, config in every.items():  # searches after the studies
        row: dict[str, Any] = {
            "study": config.study,
            "family": bodies.get(config.body).family,
            "method": config.method,
            "cell": dataclasses.replace(config, seed=0).run_id,
            "steps": config.budget.n_steps / 1e6 if config.method != "random" else 0.0,
        }
        if record := made.get(run_id):
            row |= {
                "wall_time_s": record.wall_time_s,
                "processor_time_s": record.processor_time_s,
                "speed": record.training["steps_per_s"],
                "processor": record.provenance.get("machine", {}).get("processor", "not recorded"),
                "date": dates.get(run_id),
            }
        rows.append(row)
    frame = pd.DataFrame(rows, columns=_COLUMNS)
    return frame.astype(dict.fromkeys(("wall_time_s", "processor_time_s", "speed"), float))


def _split(runs: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the runs that are made, and those that are not."""
    made = runs["wall_time_s"].notna()
    return runs[made], runs[~made]


def hours_left(left: pd.DataFrame, made: pd.DataFrame) -> float:
    """Estimate the hours that some runs will take, from what a step of the like has taken."""
    trained = made[made["steps"] > 0]
    known = trained.groupby(["family", "method"])[["wall_time_s", "steps"]].sum()
    if known.empty:
        return np.nan
    like = known["wall_time_s"].sum() / known["steps"].sum()  # where no run is of that kind
    keys = pd.MultiIndex.from_frame(left[["family", "method"]])
    per_step = (known["wall_time_s"] / known["steps"]).reindex(keys).fillna(like).to_numpy()
    return float(left["steps"].to_numpy() @ per_step) / 3600


def counts(runs: pd.DataFrame) -> dict[str, float]:
    """Return what sentences count: runs, those missing, million steps, hours."""
    made, missing = _split(runs)
    hours = made["wall_time_s"] / 3600
    counted = {"runs": len(made), "missing": len(missing), "steps": made["steps"].sum()}
    counted |= {"hours": hours.sum(), "hours_left": round(hours_left(missing, made), 0)}
    counted |= {"random": sum(made["steps"] == 0), "random_missing": sum(missing["steps"] == 0)}
    return counted | {"largest": hours.max()}


def by_study(runs: pd.DataFrame) -> Styler:
    """Return, for each study: runs, trials of a cell, steps, hours and dates."""
    rows, (everything, _) = [], _split(runs)
    for study, group in [*runs.groupby("study", sort=False), ("all", runs)]:
        made, missing = _split(group)
        row = {"study": study, "runs": len(made), "missing": len(missing)}
        row |= {"trials of a cell": _span(made.groupby("cell").size())}
        row |= {"million steps": number(made["steps"].sum(), 1)} | _hours(made)
        row |= {"hours left": number(hours_left(missing, everything), 1)}
        rows.append(row | {"published": _span(made["date"].dropna())})
    return styled(pd.DataFrame(rows))


def by_method(runs: pd.DataFrame) -> Styler:
    """Return what one run of each method takes: steps, hours, steps a second."""
    made, _ = _split(runs)
    trained, rows = made[made["method"] != "random"], []
    for (family, method, steps), alike in trained.groupby(["family", "method", "steps"]):
        row = {"family": family, "method": style.method(str(method), "").label}
        row |= {"million steps": number(float(steps), 1), "runs": len(alike)}
        row |= {"hours, mean": number(alike["wall_time_s"].mean() / 3600, 2)}
        rows.append(row | {"steps a second, mean": number(alike["speed"].mean())})
    return styled(pd.DataFrame(rows or [{"runs": "no run"}]))


def by_processor(runs: pd.DataFrame) -> Styler:
    """Return which processors made the runs."""
    groups = _split(runs)[0].groupby("processor")
    rows = [{"processor": name, "runs": len(alike)} | _hours(alike) for name, alike in groups]
    return styled(pd.DataFrame(rows or [{"runs": "no run"}]))


def _hours(runs: pd.DataFrame) -> dict[str, str]:
    """Return hours by the clock, and those of a processor of the runs that counted them."""
    counted = runs["processor_time_s"].dropna() / 3600
    of = f"{number(counted.sum(), 1)} ({len(counted)})" if len(counted) else DASH
    clock = number(runs["wall_time_s"].sum() / 3600, 1)
    return {"hours by the clock": clock, "hours of a processor (runs that counted)": of}


def _span(values: pd.Series) -> str:
    if values.empty:
        return DASH
    low, high = values.min(), values.max()
    return f"{low}" if low == high else f"{low} to {high}"


def _published() -> dict[str, str]:
    """Return the day on which each run's record was committed; nothing where there is no git."""
    log = git("log", "--diff-filter=A", "--format=%cs", "--name-only", "--", "data/results") or ""
    dates, day = {}, ""
    for line in filter(None, log.splitlines()):
        if line.endswith(RECORD):
            dates[line.split("/")[-2]] = day
        elif "/" not in line:
            day = line.replace("-", "\N{NON-BREAKING HYPHEN}")
    return dates
