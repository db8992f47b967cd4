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


def _varied(ranked: Sequence[Ranked]) -> dict[str, list[Any]]:
    """Return the settings that a search varies, each with its values in order."""
    found = {
        name: sorted({entry.settings[name] for entry in ranked})
        for name in (ranked[0].settings if ranked else ())
    }
    return {name: values for name, values in found.items() if len(values) > 1}


def table(ranked: Sequence[Ranked]) -> Styler:
    """Return the ranking: place, settings by the paper's symbols, score, trials, fresh trials."""
    rows = [
        {
            "place": f"{place}{' (supplement)' if entry.is_papers else ''}",
            **dict(tables.setting(*item) for item in entry.settings.items()),
            "score": number(entry.score),
            "its trials": "; ".join(map(number, entry.returns)),
            "on fresh seeds": "; ".join(map(number, entry.fresh)) or style.DASH,
        }
        for place, entry in enumerate(ranked, 1)
    ]  # fmt: skip
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
        f"{text} Configurations {differ} than the trials of one do (p = {number(by_chance, 2)});"
        f" the rankings by the first and by the second trial alone have a rank correlation of"
        f" {number(rho, 2)}."
    )


def curse_says(ranked: Sequence[Ranked]) -> str:
    """Say what the winner scored in the search, and what on seeds that have not chosen it."""
    chosen = [entry for entry in ranked if entry is ranked[0] or entry.is_papers]
    if not chosen or not chosen[0].fresh:
        return "The winner has not been run on fresh seeds: not run yet."
    said = []
    for entry in chosen:
        both = entry is ranked[0] and entry.is_papers
        name = "The winner" if entry is ranked[0] else "The supplement's best"
        name += ", which is the supplement's best," if both else ""
        if not entry.fresh:
            said.append(f"{name} has no fresh trial yet.")
            continue
        fresh, (low, high) = np.mean(entry.fresh), statistics.interval(entry.fresh, entry.returns)
        inside = f" [{number(low)} to {number(high)}]" if np.isfinite(low) else ""
        said.append(
            f"{name} scored {number(entry.score)} in the search and {number(float(fresh))} on"
            f" {len(entry.fresh)} fresh seeds, a difference of"
            f" {number(float(fresh) - entry.score)}{inside}."
        )
    return " ".join(said)


@style.applied()
def sensitivity(ranked: Sequence[Ranked], title: str) -> Figure:
    """Draw the score against each setting that was varied: configurations, and means by value."""
    varied = _varied(ranked) or {"": []}
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
        if not values:
            style.say(axes, "not run yet")
            axes.set_yticks([])
    grid[0].set_ylabel("true return")
    grid[0].yaxis.set_major_formatter("{x:,.0f}")
    note = "a dot is the mean over one's trials, a line that of all with the value"
    return style.finish(figure, note=f"{title}: {len(ranked)} configurations; {note}")
