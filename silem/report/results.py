"""The runs' records as one table, checked: what every figure, table and verdict reads.

A figure's runs are those that a study plans: its cells with the supplement's hyper-parameters, one
budget, and the trial seeds that were fixed beforehand. Planned runs that are not there are listed
as missing and runs of other settings as set aside; neither is passed over in silence.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from silem import bodies
from silem.motion.features import FEATURES
from silem.report.loading import COLUMNS, KEYS, load_records
from silem.study import runs
from silem.study.record import CURVE, CURVE_COLUMNS, TRANSFORM, RunRecord
from silem.study.settings import BUDGETS, FAMILIES
from silem.study.studies import cells, seeds_of
from silem.util import files
from silem.util.errors import SilemError

__all__ = [
    "COLUMNS", "KEYS", "against_best", "body_names", "cell", "context", "describe", "find",
    "is_evidence", "is_planned", "load_curve", "load_records", "load_transform",
    "n_trials", "original_body", "paper_loss", "planned_methods", "scores", "select", "stand_ins",
    "upright_label", "values",
]  # fmt: skip

PAPER_LOSS = {
    "halfcheetah": "no-gradient-penalty", "humanoids": "humanoids-no-gradient-penalty",
}  # fmt: skip
"""The study that has a study's cells with the paper's loss for D, without our gradient penalty."""


def context(frame: pd.DataFrame) -> tuple[str, str]:
    """Return a table's study and budget.

    Raises:
        SilemError: The table was put together from several budgets, or not by `load_records`.
    """
    if "budget" not in frame.attrs:
        raise SilemError("not a table of one study at one budget: load it with load_records")
    for body, group in frame.groupby("body"):
        full = (group["method"] != "random") & ~group["stand_in"]
        counts = group.loc[full, "n_iterations"].unique()
        if len(counts) > 1:
            raise SilemError(f"mixed budgets on {body}: runs of {sorted(counts)} iterations")
    return frame.attrs["study"], frame.attrs["budget"]


def select(
    frame: pd.DataFrame,
    methods: Sequence[str],
    names: Sequence[str] | None = None,
    *,
    with_stand_ins: bool = True,
) -> pd.DataFrame:
    """Keep some methods' runs, and some bodies'; the missing runs are narrowed alike.

    Args:
        frame: Runs of one study at one budget.
        methods: The methods to keep.
        names: The bodies to keep, in the order in which figures show them; None keeps all.
        with_stand_ins: Keep the runs of another number of iterations than planned.
    """
    context(frame)

    def keeps(method: str, body: str) -> bool:
        return method in methods and (names is None or body in names)

    kept = [
        keeps(row.method, row.body) and (with_stand_ins or not row.stand_in)
        for row in frame.itertuples()
    ]
    missing = [run for run in frame.attrs["missing"] if keeps(run["method"], run["body"])]
    narrowed = frame[np.array(kept, dtype=bool)].reset_index(drop=True)
    narrowed.attrs = frame.attrs | {"missing": missing}
    if names is not None:
        narrowed.attrs["bodies"] = list(names)
    return narrowed


def paper_loss(frame: pd.DataFrame) -> pd.DataFrame | None:
    """Return a study's runs with the paper's loss for D; None where no study plans any.

    Experts and the random policy, which have no discriminator, are the same runs in both.
    """
    study, budget = context(frame)
    if study not in PAPER_LOSS:
        return None
    runs = load_records(PAPER_LOSS[study], budget)
    shared = frame[frame["method"].isin(_WITHOUT_D)]
    both = pd.concat([part for part in (runs, shared) if len(part)] or [runs], ignore_index=True)
    both.attrs = runs.attrs | {"shared": _WITHOUT_D}
    return both


_WITHOUT_D = ("ppo", "random")


def n_trials(frame: pd.DataFrame) -> int:
    """Return how many trials a table's study plans for each cell at its budget."""
    study, budget = context(frame)
    return len(seeds_of(study, BUDGETS[budget]))


def body_names(frame: pd.DataFrame) -> list[str]:
    """List the bodies of a table's study in the registry's order, or those selected in theirs."""
    study, _ = context(frame)
    known = {cell.body for cell in cells(study)}
    return [name for name in frame.attrs.get("bodies", bodies.names()) if name in known]


def original_body(frame: pd.DataFrame) -> str:
    """Return the body whose expert demonstrates to the others, e.g. HC0; "" where a human does."""
    demonstrator = FAMILIES[bodies.get(body_names(frame)[0]).family].original
    return demonstrator if demonstrator in bodies.names() else ""


def upright_label(frame: pd.DataFrame) -> str:
    """Say what ``upright`` measures: a humanoid's episode ends where it falls."""
    walks = bodies.get(body_names(frame)[0]).family == "humanoid"
    return "share of steps survived" if walks else "share of time upright"


def is_planned(frame: pd.DataFrame, method: str, body: str) -> bool:
    """Tell whether a table's study has a cell for a method on a body, or shares another's."""
    study, _ = context(frame)
    return method in frame.attrs.get("shared", ()) or any(
        cell.method == method and cell.body == body for cell in cells(study)
    )


def planned_methods(frame: pd.DataFrame, methods: Sequence[str]) -> list[str]:
    """Keep those of some methods that a table's study has cells for."""
    study, _ = context(frame)
    known = {cell.method for cell in cells(study)}
    return [method for method in methods if method in known]


def cell(frame: pd.DataFrame, method: str, body: str) -> pd.DataFrame:
    """Return the rows of one cell: a method on a body, one row per trial, no stand-ins."""
    return frame[(frame["method"] == method) & (frame["body"] == body) & ~frame["stand_in"]]


def stand_ins(frame: pd.DataFrame, method: str, body: str) -> pd.DataFrame:
    """Return one cell's runs of another number of iterations, in place of missing ones."""
    return frame[(frame["method"] == method) & (frame["body"] == body) & frame["stand_in"]]


def scores(frame: pd.DataFrame, method: str, body: str, column: str = "normalised") -> np.ndarray:
    """Return one cell's values in a column that are known, shape (N,)."""
    return cell(frame, method, body)[column].dropna().to_numpy(dtype=np.float64)


def against_best(frame: pd.DataFrame, method: str, body: str) -> np.ndarray:
    """Return one cell's returns over the return of the body's best expert, which demonstrates.

    Empty where there is no expert whose return is above zero.
    """
    experts = scores(frame, "ppo", body, "return_mean")
    best = experts.max(initial=0.0)
    return scores(frame, method, body, "return_mean") / best if best > 0 else np.empty(0)


def values(frame: pd.DataFrame, method: str, body: str, quantity: str) -> np.ndarray:
    """Return one cell's values of a quantity that a claim is about, one for each trial, (N,).

    Args:
        frame: Runs of one study at one budget.
        method: The method.
        body: The body.
        quantity: A column; ``"returns"``, the episodes of a policy that is not trained, which are
            its replicates; or an entry of a humanoid's T, the mean over the features whose names
            begin so: ``"A left_hand"``, or a difference, ``"b left_elbow - right_elbow"``.
    """
    runs = cell(frame, method, body)
    if quantity == "returns":
        return np.array(runs["returns"].iloc[0]) if len(runs) else np.empty(0)
    key, _, parts = quantity.partition(" ")
    if not parts:
        return scores(frame, method, body, quantity)
    entries = [load_transform(run_id)[key] for run_id in runs["run_id"]]
    one, *other = (
        np.array([entry[[f.name.startswith(part) for f in FEATURES]].mean() for entry in entries])
        for part in parts.split(" - ")
    )
    return one - other[0] if other else one


def load_curve(run_id: str) -> pd.DataFrame:
    """Load a run's learning curve (columns of `silem.study.record`), NaN where blank or not kept.

    Raises:
        SilemError: There is no such run, or its curve is not the file that was recorded.
    """
    curve = pd.DataFrame(files.read_csv(find(run_id).file(CURVE)))
    if list(curve.columns) != [name for name in CURVE_COLUMNS if name in curve.columns]:
        raise SilemError(f"the curve of {run_id} has columns {', '.join(curve.columns)}")
    return curve.reindex(columns=CURVE_COLUMNS)


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


def describe(frame: pd.DataFrame) -> str:
    """Say in one line what a table holds: budget, iterations, runs, missing runs."""
    _, budget = context(frame)
    trained = frame[(frame["method"] != "random") & ~frame["stand_in"]]
    by_body = trained.groupby("body")["n_iterations"].first()
    parts = [f"budget {budget}"]
    if by_body.nunique() == 1:
        parts[0] += f" ({by_body.iloc[0]:,} iterations)"
    elif len(by_body):
        listing = ", ".join(f"{body} {count:,}" for body, count in by_body.items())
        parts[0] += f" (iterations: {listing})"
    parts.append(f"{len(frame)} run{'' if len(frame) == 1 else 's'}")
    if n_others := int(frame["stand_in"].sum()):
        parts.append(f"{n_others} of them of another length than planned")
    if frame.attrs["missing"]:
        parts.append(f"{len(frame.attrs['missing'])} of the planned runs not made yet")
    return ", ".join(parts)


def is_evidence(budget: str) -> bool:
    """Tell whether a budget's runs are published and may decide a claim."""
    return BUDGETS[budget].is_evidence
