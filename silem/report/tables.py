"""Tables for the book: pandas Stylers of the paper's tables and of the runs' records."""

from __future__ import annotations

import hashlib
import html
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from pandas.io.formats.style import Styler

from silem import paper
from silem.report import results, style
from silem.study import statistics
from silem.util import files, paths

DASH = "–"


def table_1(frame: pd.DataFrame) -> Styler:
    """Return Table 1, ours beside the paper's: f an MLP or an affine transform, on HC0.

    Ours are means over trials, with the lowest and highest trial behind them.

    Args:
        frame: Runs of one study at one budget.
    """
    rows = []
    for method, printed in zip(("silem-mlp", "silem"), paper.table("tab1").rows, strict=True):
        runs = results.cell(frame, method, "HC0")
        rows.append(
            {
                ("", "f"): printed["f"],
                ("discriminator reward", "paper"): number(printed["discriminator_reward"]),
                ("discriminator reward", "ours"): _mean_and_range(runs["disc_reward"]),
                ("ground-truth reward", "paper"): number(printed["ground_truth_reward"]),
                ("ground-truth reward", "ours"): _mean_and_range(runs["return_mean"]),
                ("", "trials"): len(runs),
            }
        )
    columns = pd.MultiIndex.from_tuples(list(rows[0]))
    return styled(pd.DataFrame([list(row.values()) for row in rows], columns=columns))


def random_policies() -> Styler:
    """Return what each reading of "a random policy" returns on HC0, beside the paper's number.

    The returns were measured by ``python -m benchmarks.random_policy``.
    """
    rows = [{"a random policy": "the paper's", "return": number(paper.number("random_return"))}]
    for entry in files.read_json(paths.REPO / "data" / "random_policy.json"):
        returns = np.array(entry["returns"])
        error = number(returns.std(ddof=1) / len(returns) ** 0.5)
        text = f"{number(returns.mean())} ± {error}"
        rows.append({"a random policy": html.escape(entry["reading"]), "return": text})
    return styled(pd.DataFrame(rows))


def coverages(counts: Sequence[int] = (2, 3, 5)) -> Styler:
    """Return how often a 95 % interval of that many trials holds the true mean, by simulation."""
    rows = []
    for count in counts:
        row = {"trials": str(count)}
        for name, kind in (("Student's", "student"), ("bootstrap", "bootstrap")):
            for failures, scores in ((False, "normal scores"), (True, "one in five fails")):
                share = statistics.coverage(count, kind, failures=failures)
                row[f"{name}, {scores}"] = f"{number(100 * share)} %"
        rows.append(row)
    return styled(pd.DataFrame(rows), "True coverage of a 95 % interval of the mean")


def cell_table(frame: pd.DataFrame) -> Styler:
    """Return one row per cell of a study: trials, returns, scores, gait and wall time.

    The second score is against the body's best expert, who demonstrates, not against their mean.

    Runs of another number of iterations than planned stand in rows of their own.

    Args:
        frame: Runs of one study at one budget.
    """
    rows = []
    for body in results.body_names(frame):
        for method in style.METHODS:
            if not results.is_planned(frame, method, body):
                continue
            label = style.method(method, results.original_body(frame)).label
            best = results.against_best(frame, method, body)
            rows.append(_cell_row(frame, body, label, results.cell(frame, method, body), best))
            for n, runs in results.stand_ins(frame, method, body).groupby("n_iterations"):
                planned = runs["planned_iterations"].iloc[0]
                words = f"{label}, {n:,} iterations (planned: {planned:,})"
                rows.append(_cell_row(frame, body, words, runs))
    return styled(pd.DataFrame(rows))


def _cell_row(
    frame: pd.DataFrame, body: str, label: str, runs: pd.DataFrame, best: ArrayLike = ()
) -> dict[str, Any]:
    upright = results.upright_label(frame).removeprefix("share of ")
    return {
        "body": body,
        "method": label,
        "trials": len(runs),
        "return": _mean_and_range(runs["return_mean"]),
        "score": _mean_and_range(runs["normalised"], digits=2),
        "score, best expert": _mean(pd.Series(np.asarray(best)), 2),
        "speed (m/s)": _mean(runs["speed_m_s"], 2),
        upright: _mean(100 * runs["upright"], 0, " %"),
        "discriminator reward": _mean(runs["disc_reward"], 0),
        "wall time (min)": _mean(runs["wall_time_s"] / 60, 1),
    }


def styled(table: pd.DataFrame, caption: str = "") -> Styler:
    """Return a table in this project's look; the same table gives the same HTML.

    Args:
        table: Numbers already written as text.
        caption: What it shows.
    """
    # The id that ties a table to its own styles comes from its content, so that it never changes
    # by itself and two tables on one page do not style each other.
    digest = hashlib.sha256((table.to_csv() + caption).encode()).hexdigest()
    look = table.style.hide(axis="index").set_uuid(digest[:10])
    look = look.set_table_attributes('class="silem-table"')
    numeric = [name for name in table.columns if table[name].map(_is_numeric).all()]
    look = look.set_properties(subset=numeric, **{"text-align": "right", "white-space": "nowrap"})
    others = [name for name in table.columns if name not in numeric]
    look = look.set_properties(subset=others, **{"text-align": "left"})
    return look.set_caption(caption) if caption else look


def _is_numeric(value: Any) -> bool:
    text = re.sub(r"<[^>]*>", " ", str(value))
    return bool(re.match(r"^[\d–−+]", text)) and not re.search(r"[A-Za-z]{3}", text)


def number(value: float | None, digits: int = 0) -> str:
    """Write a number with a true minus; a dash where there is none."""
    if value is None or np.isnan(value):
        return DASH
    return f"{value:,.{digits}f}".replace("-", "−")


def _mean(values: pd.Series, digits: int, unit: str = "") -> str:
    known = values.dropna().astype(float)
    return number(known.mean(), digits) + unit if len(known) else DASH


def _mean_and_range(values: pd.Series, digits: int = 0) -> str:
    """Write a cell as its mean with minimum and maximum below; a single trial has no range."""
    known = values.dropna().astype(float)
    if len(known) < 2:
        return _mean(known, digits)
    low, high = number(known.min(), digits), number(known.max(), digits)
    return f"{_mean(known, digits)}<br><small>{low} to {high}</small>"
