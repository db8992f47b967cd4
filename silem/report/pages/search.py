"""The page of the supplement's search: its ranking, each setting's part, and the winner's curse.

`ranked` is what `silem.study.studies.ranking` tells of a search, the best configuration first.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from pandas.io.formats.style import Styler
from scipy import stats

from silem.report import statistics, style, tables
from silem.report.style import number
from silem.study.studies import Ranked


def table(ranked: Sequence[Ranked]) -> Styler:
    """Return the ranking: place, settings, score, trials, and what fresh seeds make of it."""
    rows = []
    for place, entry in enumerate(ranked, 1):
        row = {"place": f"{place}{' (supplement)' if entry.is_papers else ''}"}
        row |= dict(tables.setting(*item) for item in entry.settings.items())
        row |= {"score": number(entry.score), "its trials": "; ".join(map(number, entry.returns))}
        row["on fresh seeds"] = "; ".join(map(number, entry.fresh)) or style.DASH
        change = float(np.mean(entry.fresh)) - entry.score if entry.fresh else np.nan
        ends = statistics.interval(entry.fresh, entry.returns)
        row["change [95 %]"] = style.estimate(change, ends)
        rows.append(row)
    return tables.styled(pd.DataFrame(rows or [{"place": "not run yet"}]), "Mean true returns")


def says(ranked: Sequence[Ranked], n_planned: int) -> str:
    """Say where the supplement's best stands, and whether the ranking is more than chance.

    Chance is what trials of one configuration differ by (analysis of variance, one way).
    """
    text = f"{len(ranked)} of {n_planned} configurations have all their trials"
    places = [place for place, entry in enumerate(ranked, 1) if entry.is_papers]
    if len(ranked) < 2:
        return f"{text}: not run yet."
    where = f"on place {places[0]} of {len(ranked)}" if places else "not among them"
    text += f". The supplement's best combination is {where}."
    if min(len(entry.returns) for entry in ranked) < 2:
        return f"{text} One trial each cannot tell a configuration from its seed."
    by_chance = float(stats.f_oneway(*(entry.returns for entry in ranked)).pvalue)
    first, second = (np.array([entry.returns[i] for entry in ranked]) for i in (0, 1))
    rho = float(stats.spearmanr(first, second).statistic)
    differ = "differ by more" if by_chance < 1 - statistics.LEVEL else "do not differ by more"
    return (
        f"{text} Configurations {differ} than the trials of one do (p = {by_chance:.2g});"
        f" the rankings by the first and by the second trial alone have a rank correlation of"
        f" {number(rho, 2)}."
    )


def curse(ranked: Sequence[Ranked], body: str) -> str:
    """Say what the winner, and the supplement's best, are worth on seeds that did not choose it."""
    asked = {"the winner": ranked[:1], "the supplement's best": [e for e in ranked if e.is_papers]}
    told = [
        f"{name} goes from {number(entry.score)} to {number(float(np.mean(entry.fresh)))}"
        f" on {len(entry.fresh)} fresh seeds"
        for name, found in asked.items()
        for entry in found
        if entry.fresh
    ]
    return f"On {body} {', '.join(told) or 'nothing has been run on fresh seeds yet'}."


@style.applied()
def sensitivity(ranked: Sequence[Ranked], title: str) -> Figure:
    """Draw the score against each setting that was varied: configurations, and means by value."""
    tried = pd.DataFrame([entry.settings for entry in ranked])
    varied = {n: sorted(tried[n].unique()) for n in tried if tried[n].nunique() > 1} or {"": []}
    named = [tables.setting(name, "")[0] or title for name in varied]
    figure, grid = style.panels(named, 1.9, 3, sharey=True)
    dots: dict[str, Any] = {"color": style.method("silem").color, "alpha": 0.45, "mec": "none"}
    for axes, (name, values) in zip(grid, varied.items(), strict=True):
        for x, value in enumerate(values):
            scores = [entry.score for entry in ranked if entry.settings[name] == value]
            axes.plot(np.full(len(scores), x), scores, "o", ms=4, **dots)
            axes.plot([x - 0.25, x + 0.25], [np.mean(scores)] * 2, color=style.INK, lw=1.6)
        axes.set_xticks(range(len(values)), [number(value, None) for value in values])
        axes.set_xlim(-0.6, max(len(values), 1) - 0.4)
    grid[0].set_ylabel("true return")
    grid[0].yaxis.set_major_formatter("{x:,.0f}")
    note = "a dot is the mean over one's trials, a line that of all with the value"
    return style.finish(figure, note=f"{title}: {len(ranked)} configurations; {note}")
