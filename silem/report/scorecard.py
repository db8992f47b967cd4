"""The scorecard: every claim of the paper beside what our runs say, and the rules that decide."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from pandas.io.formats.style import Styler

from silem.report import claims, results
from silem.report.claims import FAILS, HOLDS, UNDECIDED, Finding
from silem.report.tables import number, small, styled

_COLORS = {HOLDS: "#DDF3E4", FAILS: "#FBE3E0", UNDECIDED: "#F1F1F1"}


def evaluate(frame: pd.DataFrame, study: str = "") -> pd.DataFrame:
    """Judge the claims about a study, by default the table's own, by its runs at one budget.

    Returns:
        One row per claim: ``claim`` (a `claims.Claim`), ``text``, ``findings`` (a list of
        `claims.Finding`), ``verdict``, ``reason``.

    Raises:
        SilemError: The paper makes no claim about the study.
    """
    judged = claims.of(study or results.context(frame)[0])
    rows = [(claim, claim.text, *claim.judge(frame)) for claim in judged]
    return pd.DataFrame(rows, columns=["claim", "text", "findings", "verdict", "reason"])


def table(frame: pd.DataFrame) -> Styler:
    """Return the scorecard for a page: the claim with its rule, the paper's number, ours, verdict.

    Where a study plans the same cells with the paper's loss for D, without our gradient penalty,
    its verdicts stand beside ours. Below a value with its 95 % interval: the trials, the score
    against the best expert, the share of pairs of trials in which the first of two cells is
    higher, and the distance from the bound that the planned trials would have found.
    """
    study, _ = results.context(frame)
    tables = {"this book's loss": frame, "the paper's loss": results.paper_loss(frame)}
    judged = {name: (f, evaluate(f, study)) for name, f in tables.items() if f is not None}
    rows = []
    for index, claim in enumerate(claims.of(study)):
        row: dict[Any, str] = {
            ("", "claim"): claim.text + small(f"{claim.where}; holds if: {claim.rule}"),
            ("", "paper"): number(claim.printed, claim.measures[0].digits),
        }
        for name, (runs, found) in judged.items():
            entry, planned = found.iloc[index], results.n_trials(runs)
            row[name, "value"] = "<br>".join(
                _value(finding, planned, alone=len(entry.findings) == 1, trials=i == 0)
                for i, finding in enumerate(entry.findings)
            )
            row[name, "verdict"] = f"<b>{entry.verdict}</b>" + small(entry.reason)
        rows.append(row)
    page = styled(pd.DataFrame(rows))
    return page.map(_color, subset=[column for column in page.columns if column[1] == "verdict"])


def counts(frame: pd.DataFrame) -> dict[str, int]:
    """Count the verdicts: how many claims hold, do not hold, or are undecided."""
    found = evaluate(frame)["verdict"].value_counts()
    return {name: int(found.get(name, 0)) for name in (HOLDS, FAILS, UNDECIDED)}


def rules() -> Styler:
    """Return what the claims' rules have in common, in words."""
    return styled(pd.DataFrame(claims.RULES.items(), columns=["rule", "what it says"]))


def _value(finding: Finding, planned: int, *, alone: bool, trials: bool) -> str:
    """Write a value with everything that bears on it; its name before it unless it is alone."""
    measure = finding.measure

    def write(value: float) -> str:
        return number(value, measure.digits)

    text = write(finding.ours) if alone else f"{measure.name} {write(finding.ours)}"
    lines = [f"{name} {count}" for name, count in finding.trials.items()] if trials else []
    if np.isfinite(finding.interval).all():
        text += f" [{' to '.join(map(write, finding.interval))}]"
    if measure.name == "score" and not np.isnan(finding.of_best):
        lines.append(f"against the best expert {write(finding.of_best)}")
    if not np.isnan(finding.wins):
        lines.append(f"{number(100 * finding.wins)} % of pairs")
    if not np.isnan(finding.detectable):
        lines.append(f"{planned} trials find ±{write(finding.detectable)}")
    return text + small("; ".join(lines))


def _color(cell: str) -> str:
    verdict = cell.removeprefix("<b>").partition("</b>")[0]
    return f"background-color: {_COLORS[verdict]}; color: #222"
