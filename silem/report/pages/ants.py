"""The page of the seven Ants: what surviving earns, absorbing states, and T against a leg's length.

Everywhere `frame` holds the runs of one study at one budget, from `results.load_records`.
"""

from itertools import product

import pandas as pd
from matplotlib.figure import Figure

from silem import bodies
from silem.bodies.body import MAX_STEPS
from silem.report import results, scores, statistics, style, transforms
from silem.report.scores import IMITATORS

_FEWEST_BODIES = 4  # that a rank correlation takes
_ENTRIES = {"A": ("A, diagonal", 0.0), "b": ("b, offset", 0.0)}
SHARE, STANDING = "survival, of the expert's return", "standing"


def survival(frame: pd.DataFrame) -> pd.DataFrame:
    """Return, a row for each body, what of the return surviving pays: ratios of means over trials.

    A step upright pays one, so an episode earns its steps by lasting (two less where it ends in a
    fall, whose step costs one). `SHARE` is that of the expert's return, `STANDING` the score of
    standing for a whole episode at no cost. Of each imitator there is its score, and the same
    ratio of what is left when survival is taken out of both returns.
    """
    size = {"index": results.body_names(frame), "columns": ["ppo", *IMITATORS]}
    earned, lasted = (
        frame.pivot_table(column, "body", "method").reindex(**size).astype(float)
        for column in ("return_mean", "steps")
    )
    level, steps = earned["ppo"], lasted["ppo"]
    table = pd.DataFrame({SHARE: steps / level, STANDING: MAX_STEPS / level})
    for method in IMITATORS:
        label = style.method(method, results.original_body(frame)).label
        rest = (level - steps).where(level > steps)
        table[label] = earned[method] / level
        table[f"{label}, moving"] = (earned[method] - lasted[method]) / rest
    return table.rename_axis("body")


def correlations(frame: pd.DataFrame) -> pd.DataFrame:
    """Return how each entry of SILEM's T goes with the length of its body's links, over all trials.

    Columns are ``entry`` ("A" or "b"), ``feature``, Spearman's ``rho``, ``low`` and ``high`` of its
    95 % interval, and whether zero is outside, ``sure``. Without trials of
    `_FEWEST_BODIES` bodies there is no row.
    """
    runs, rows = results.select(frame, ["silem"]), []
    if runs["body"].nunique() >= _FEWEST_BODIES:
        learned = transforms.learned(runs)
        for entry, (feature, of_one) in product(_ENTRIES, learned.groupby("feature", sort=False)):
            lengths = [bodies.get(body).length[1] for body in of_one["body"]]
            rows.append((entry, feature, *statistics.rank_correlation(lengths, of_one[entry])))
    found = pd.DataFrame(rows, columns=["entry", "feature", "rho", "low", "high"])
    return found.assign(sure=found["low"] * found["high"] > 0)


@style.applied()
def tracking(frame: pd.DataFrame) -> Figure:
    """Draw `correlations`, feature by feature; what may be chance is grey."""
    runs = scores.runs_of("by_feature", frame)
    found = correlations(frame)
    figure, panels, places = transforms.sheet(results.body_names(frame)[0], 5.9, _ENTRIES)
    for entry, axes in panels.items():
        axes.set(xlim=(-1.05, 1.05), xlabel="rank correlation with the links' length")
        for place, row in zip(places, found[found["entry"] == entry].itertuples(), strict=False):
            color = style.method("silem").color if row.sure else style.MUTED
            axes.plot([row.low, row.high], [place, place], color=color, lw=1.4)
            axes.plot(row.rho, place, "o", color=color, ms=4.5)
    return scores.finish(figure, runs, note="lines: 95 % intervals; blue: zero is outside")
