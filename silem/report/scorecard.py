"""The scorecard: every claim of the paper beside what our runs say."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from pandas.io.formats.style import Styler

from silem.report import claims, results
from silem.report.claims import FAILS, HOLDS, UNDECIDED
from silem.report.tables import DASH, number, styled

_COLORS = {HOLDS: "#DDF3E4", FAILS: "#FBE3E0", UNDECIDED: "#F1F1F1"}


def evaluate(frame: pd.DataFrame) -> pd.DataFrame:
    """Judge the claims about one study by its runs at one budget.

    Args:
        frame: The runs, from `results.load_records`.

    Returns:
        One row per claim: ``claim``, ``where``, ``paper``, ``ours``, ``low``, ``high``,
        ``trials``, ``rule``, ``verdict``, ``reason``, ``digits``, ``wins``.

    Raises:
        SilemError: The paper makes no claim about the study.
    """
    study, budget = results.context(frame)
    rows: list[dict[str, Any]] = []
    for claim in claims.of(study):
        finding = claim.find(frame)
        verdict, reason = finding.verdict
        if not results.is_evidence(budget):
            verdict, reason = UNDECIDED, f"runs at budget {budget} are no evidence"
        rows.append(
            {
                "claim": claim.text,
                "where": claim.where,
                "paper": np.nan if claim.printed is None else claim.printed,
                "ours": finding.ours,
                "low": finding.interval[0],
                "high": finding.interval[1],
                "trials": ", ".join(f"{name} {count}" for name, count in finding.trials.items()),
                "rule": claim.rule,
                "verdict": verdict,
                "reason": reason,
                "digits": finding.digits,
                "wins": finding.wins,
            }
        )
    return pd.DataFrame(rows)


def table(frame: pd.DataFrame) -> Styler:
    """Return the scorecard for a page: claim, paper, ours with interval, trials, verdict.

    Below a difference of two cells stands the share of pairs of trials in which the first is
    higher.

    Args:
        frame: Runs of one study at one budget.
    """
    rows = []
    for row in evaluate(frame).itertuples():
        interval = [number(value, row.digits) for value in (row.low, row.high)]
        rows.append(
            {
                "claim": f"{row.claim}<br><small>{row.where}; holds if: {row.rule}</small>",
                "paper": number(row.paper, row.digits),
                "ours": number(row.ours, row.digits) + _wins(row.wins),
                "95 % interval": DASH if DASH in interval else " to ".join(interval),
                "trials": row.trials,
                "verdict": f"<b>{row.verdict}</b>"
                + (f"<br><small>{row.reason}</small>" if row.reason else ""),
            }
        )
    return styled(pd.DataFrame(rows)).map(_color, subset=["verdict"])


def counts(frame: pd.DataFrame) -> dict[str, int]:
    """Count the verdicts: how many claims hold, do not hold, or are undecided."""
    verdicts = evaluate(frame)["verdict"]
    return {name: int((verdicts == name).sum()) for name in (HOLDS, FAILS, UNDECIDED)}


def _wins(share: float) -> str:
    """Say how often the first of two compared cells is higher, trial against trial."""
    return "" if np.isnan(share) else f"<br><small>{number(100 * share)} % of pairs</small>"


def _color(cell: str) -> str:
    verdict = cell.removeprefix("<b>").partition("</b>")[0]
    return f"background-color: {_COLORS[verdict]}; color: #222"
