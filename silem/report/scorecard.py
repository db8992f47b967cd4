"""The scorecard: every claim of the paper beside what our runs say, and the rules that decide."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from pandas.io.formats.style import Styler

from silem.report import claims, results
from silem.report.claims import FAILS, HOLDS, UNDECIDED, Finding
from silem.report.tables import number, styled

_COLORS = {HOLDS: "#DDF3E4", FAILS: "#FBE3E0", UNDECIDED: "#F1F1F1"}
_OURS, _PAPERS = "this book's loss", "the paper's loss"


def evaluate(frame: pd.DataFrame) -> pd.DataFrame:
    """Judge the claims about one study by its runs at one budget.

    Args:
        frame: The runs, from `results.load_records`.

    Returns:
        One row per claim: ``claim`` (a `claims.Claim`), ``text``, ``findings`` (a list of
        `claims.Finding`), ``verdict``, ``reason``.

    Raises:
        SilemError: The paper makes no claim about the study.
    """
    return _judge(frame, results.context(frame)[0])


def _judge(frame: pd.DataFrame, study: str) -> pd.DataFrame:
    rows = [(claim, claim.text, *claim.judge(frame)) for claim in claims.of(study)]
    return pd.DataFrame(rows, columns=["claim", "text", "findings", "verdict", "reason"])


def table(frame: pd.DataFrame) -> Styler:
    """Return the scorecard for a page: the claim with its rule, the paper's number, ours, verdict.

    Where a study plans the same cells with the paper's loss for D, without our gradient penalty,
    its verdicts stand beside ours. Below a value with its 95 % interval: the trials, the score
    against the best expert, the share of pairs of trials in which the first of two cells is
    higher, and the distance from the bound that the planned trials would have found.

    Args:
        frame: Runs of one study at one budget.
    """
    study, _ = results.context(frame)
    judged = {_OURS: (frame, evaluate(frame))}
    if (other := results.paper_loss(frame)) is not None:
        judged[_PAPERS] = (other, _judge(other, study))
    rows = []
    for index, claim in enumerate(claims.of(study)):
        small = f"<br><small>{claim.where}; holds if: {claim.rule}</small>"
        printed = np.nan if claim.printed is None else claim.printed
        row: dict[Any, str] = {("", "claim"): claim.text + small}
        row["", "paper"] = number(printed, claim.measures[0].digits)
        for name, (runs, found) in judged.items():
            entry, several = found.iloc[index], len(claim.measures) > 1
            planned = results.n_trials(runs)
            row[name, "value"] = "<br>".join(
                _value(f, several, planned, trials=i == 0) for i, f in enumerate(entry.findings)
            )
            row[name, "verdict"] = f"<b>{entry.verdict}</b>" + _small(entry.reason)
        rows.append(row)
    columns = pd.MultiIndex.from_tuples(list(rows[0]))
    page = styled(pd.DataFrame([list(row.values()) for row in rows], columns=columns))
    return page.map(_color, subset=[column for column in columns if column[1] == "verdict"])


def counts(frame: pd.DataFrame) -> dict[str, int]:
    """Count the verdicts: how many claims hold, do not hold, or are undecided."""
    verdicts = evaluate(frame)["verdict"]
    return {name: int((verdicts == name).sum()) for name in (HOLDS, FAILS, UNDECIDED)}


def rules() -> Styler:
    """Return what the claims' rules have in common, in words."""
    return styled(pd.DataFrame(claims.RULES.items(), columns=["rule", "what it says"]))


def _value(finding: Finding, several: bool, planned: int, *, trials: bool) -> str:
    """Write a value with everything that bears on it; a name before it where there are several."""
    digits = finding.measure.digits
    text = number(finding.ours, digits)
    lines = [f"{name} {count}" for name, count in finding.trials.items()] if trials else []
    if np.isfinite(finding.interval).all():
        text += f" [{' to '.join(number(end, digits) for end in finding.interval)}]"
    if finding.measure.name == "score" and not np.isnan(finding.of_best):
        lines.append(f"against the best expert {number(finding.of_best, digits)}")
    if not np.isnan(finding.wins):
        lines.append(f"{number(100 * finding.wins)} % of pairs")
    if not np.isnan(finding.detectable):
        lines.append(f"{planned} trials find ±{number(finding.detectable, digits)}")
    name = f"{finding.measure.name} " if several else ""
    return f"{name}{text}" + _small("; ".join(lines))


def _small(text: str) -> str:
    return f"<br><small>{text}</small>" if text else ""


def _color(cell: str) -> str:
    verdict = cell.removeprefix("<b>").partition("</b>")[0]
    return f"background-color: {_COLORS[verdict]}; color: #222"
