"""Page "How the open settings were found": the search's runs, T's travel, and the search before.

The search is the study "open-settings". What was tried before it was recorded as curves in
``data/search``, one entry per exploratory run; it is history, and no result rests on it.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
import pandas as pd
from pandas.io.formats.style import Styler

from silem.report import results, style, tables, transforms
from silem.report.style import QUANTITIES, number
from silem.study.settings import HyperParameters
from silem.study.studies import SEARCHED_FROM
from silem.util import files, paths
from silem.util.errors import SilemError, choose

NEAR_BEST = 0.02
"""Settings whose score is within this share of the best are as good; the nearer to the paper's, or
to the default, is taken (`silem.study.studies`)."""

_NEAR_BOUND = 0.1


def settings(frame: pd.DataFrame) -> pd.DataFrame:
    """Return what the search tried, a row for each method and setting, in the plan's order.

    Columns are ``method``, ``setting`` (in words), ``first`` (the search began from it), ``in_use``
    (it is what the study has now), a body's mean score each, ``score`` (their mean, NaN while a
    body's run is missing) and ``near`` (within `NEAR_BEST` of the method's best).
    """
    names, keys = results.body_names(frame), ["method", "setting", "first", "in_use"]
    tried = tables.searched(frame, SEARCHED_FROM)
    score = tried.groupby([*keys, "body"], sort=False)["normalised"].mean()
    table = score.unstack().reindex(score.index.droplevel("body").unique()).reset_index()
    table["score"] = table[names].mean(axis=1, skipna=False)
    best = table.groupby("method")["score"].transform("max")
    return table.assign(near=table["score"] >= best - NEAR_BEST * best.abs())


def found(frame: pd.DataFrame) -> Styler:
    """Return the score of every setting on each body, and their mean, by which it is judged.

    The best of a method is bold, with those within `NEAR_BEST` of it; an arrow marks what the study
    has now. A setting without runs is there all the same.
    """
    table, names, write = settings(frame), results.body_names(frame), partial(number, digits=2)
    mean = table["score"].map(write)
    shown = {
        "method": table["method"].map(lambda name: style.METHODS[name].short),
        "setting": table["in_use"].map({True: "→ ", False: ""}) + table["setting"],
        **{body: table[body].map(write) for body in names},
        "mean": mean.mask(table["near"], "<strong>" + mean + "</strong>"),
    }
    near = "Scores (1: the mean of the body's own PPO experts); bold: best, or within"
    caption = f"{near} {100 * NEAR_BEST:g} % of it; →: in the study now; –: no run"
    return tables.styled(pd.DataFrame(shown), caption)


def travel_allowed(hyper: HyperParameters, n_iterations: int) -> float:
    """Return how far T's entries can go: Adam's steps are about as long as its rate."""
    iterations = np.arange(n_iterations)
    rates = hyper.transform_learning_rate * hyper.transform_lr_decay**iterations
    return float(hyper.n_transform_updates * rates.sum())


def travel(frames: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Return how far the affine transforms of some tables' runs went, a row each.

    Columns are ``run_id``, ``body``, ``allowed`` (`travel_allowed`), ``A`` and ``b``: the largest
    distances of an entry of A from 1 and of b from 0.
    """
    learned = transforms.learned(results.joined(frames))
    learned = learned.set_index(["run_id", "body"])[["A", "b"]].astype(float)
    far = (learned - [1.0, 0.0]).abs().groupby(level=[0, 1], sort=False).max().reset_index()
    configs = [results.find(run_id).run_config for run_id in far["run_id"]]
    return far.assign(allowed=[travel_allowed(c.hyper, c.budget.n_iterations) for c in configs])


def travel_table(table: pd.DataFrame) -> pd.DataFrame:
    """Return, as text, how far the transforms of each body and bound went, and how many stop there.

    Those are at their bound whose largest entry is within a tenth of it.
    """
    rows = []
    for (body, allowed), runs in table.groupby(["body", "allowed"]):
        row = {"body": body, "runs": str(len(runs)), "rate of T × its steps": f"{allowed:.3g}"}
        for entry, title in (("A", "largest |A − 1|"), ("b", "largest |b|")):
            row[title] = f"{runs[entry].median():.2g}, at most {runs[entry].max():.2g}"
        there = runs[["A", "b"]].max(axis=1) > (1 - _NEAR_BOUND) * allowed
        rows.append(row | {"at their bound": str(there.sum())})
    return pd.DataFrame(rows or [{"body": style.DASH, "runs": "no run"}])


def load(family: str = "halfcheetah", method: str | None = None) -> pd.DataFrame:
    """Return a family's exploratory runs of ``data/search``, of one method or of all."""
    choose("family", family, ("halfcheetah", "humanoids"))
    path = paths.REPO / "data" / "search" / f"{family}.json"
    rows = []
    for entry in files.read_json(path):
        if missing := {"name", "body", "method", "schedule", "columns", "rows"} - entry.keys():
            raise SilemError(f"{path.name}: an entry lacks {', '.join(sorted(missing))}")
        curve = pd.DataFrame(entry.pop("rows"), columns=entry.pop("columns")).astype(float)
        rows.append(entry | {"curve": curve})
    return pd.DataFrame([row for row in rows if method in (None, row["method"])])


def prototype() -> pd.DataFrame:
    """Return, as text, what a prototype was seen to do before any run was recorded."""
    return pd.DataFrame(files.read_json(paths.REPO / "data" / "search" / "prototype.json"))


def at(frame: pd.DataFrame, name: str, iteration: int, quantity: str) -> float:
    """Return one number of one exploratory run, for a sentence; SilemError if it has none."""
    runs = dict(zip(frame["name"], frame["curve"], strict=True))
    curve = runs[choose("exploratory run", name, runs)].set_index("iteration")
    if iteration not in curve.index:
        raise SilemError(f"the curve of {name} has no row at iteration {iteration}")
    return float(curve.loc[iteration, quantity])


def table(frame: pd.DataFrame) -> pd.DataFrame:
    """Return, as text, what was varied and what it led to, best return first in each method."""
    last = pd.DataFrame([curve.iloc[-1] for curve in frame["curve"]], index=frame.index)
    ordered = frame.join(last).sort_values(
        ["body", "method", "return_mean"], ascending=[True, True, False]
    )
    about = {"name", "body", "method", "schedule", "curve"}
    varied = [name for name in frame if name not in about and frame[name].nunique() > 1]
    rows = []
    for run in ordered.to_dict("records"):
        told = {"body": run["body"], "method": style.METHODS[run["method"]].short}
        row = {"run": run["name"].replace("_", "_<wbr>")}
        row |= {name: value for name, value in told.items() if frame[name].nunique() > 1}
        row |= dict(tables.setting(name, run[name]) for name in varied)
        row["iterations"] = f"{run['iteration']:,.0f} of {run['schedule']:,}"
        for name, (heading, digits) in QUANTITIES.items():
            if name in last and last[name].notna().any():
                row[heading] = number(run[name], digits)
        rows.append(row)
    return pd.DataFrame(rows)
