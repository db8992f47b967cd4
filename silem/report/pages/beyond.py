"""Page "Beyond the paper": the ladder, the slope, ensembles, arms of many lengths.

Everywhere `frame` is a table of `runs`. Where no run is made, figures and tables say so.
"""

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from silem.report import results, scores, style
from silem.study.evaluate import evaluate, load_policy
from silem.study.studies import BOTH
from silem.study.training import task_options
from silem.util import seeding

LOSING, OWN = (*BOTH, "tpil"), "silem-minus-own"
LADDER = (*LOSING, OWN)
ARMS = (0.5, 0.75, 1.0, 1.25, 1.5)
RESAMPLES = 1000
_LOST = 0.5  # of the own-expert level
_LEVELS = {"return": "return_mean", "speed": "speed_m_s"}


def runs(
    study: str, others: Mapping[str, Sequence[str]], methods: Sequence[str], budget: str
) -> pd.DataFrame:
    """Load a study's runs, and what it shares with others: some methods' on some bodies."""
    frames = [results.load_records(study, budget)]
    for theirs, shared in ((results.load_records(o, budget), b) for o, b in others.items()):
        frames.append(results.select(theirs, methods, shared))
    frame = results.joined(frames)
    missing = [run for found in frames for run in found.attrs["missing"]]
    frame.attrs = frames[0].attrs | {"missing": missing, "n_own": len(frames[0])}
    return frame


def ladder(frame: pd.DataFrame, lengths: Mapping[str, float], label: str) -> Figure:
    """Draw return, in shares of SILEM-minus's from the own expert, and speed against a length.

    Where a method's mean falls through half of that level is a mark in its bootstrap interval.
    """
    own = frame[frame["method"].eq(OWN)].groupby("body")["return_mean"].mean()
    level = frame["body"].map(own.where(own > 0)).astype(float)
    frame = frame.assign(share=frame["return_mean"] / level)
    columns = {"share": "Return over SILEM⁻'s, own expert", "speed_m_s": "Speed (m/s)"}
    figure = scores.against(frame, lengths, label, columns, LADDER)
    axes = figure.axes[0]
    axes.axhline(_LOST, color=style.MUTED, lw=1, ls=style.DASHED)
    points = half_points(frame, lengths)["return"].to_dict("records")
    for method, found in zip(LOSING, points, strict=True):
        color = style.method(method).color
        ends = np.minimum([found["from"], found["to"]], max(lengths.values()))
        axes.plot(ends, [_LOST] * 2, color=color, lw=6, alpha=0.4)
        axes.plot([found["half lost at"]], [_LOST], "|", color=color, ms=14, mew=2)
    return figure


def half_points(frame: pd.DataFrame, lengths: Mapping[str, float]) -> pd.DataFrame:
    """Return the length at which each method has lost half of the own-expert level, and 95 % of it.

    The level is SILEM-minus's from the body's own expert, its mean over trials, by return and by
    speed. Between two bodies the ratio of the means is interpolated linearly, and its first fall
    below one half counts: infinite without one, NaN as long as a body has no run. The interval is
    of percentiles of a bootstrap over trials, those of every cell drawn anew: rough with two.
    """
    places, names = sorted(lengths, key=lambda b: lengths[b]), ("half lost at", "from", "to")
    at: list[float] = [lengths[body] for body in places]
    rows: dict[str, dict[tuple[str, str], float]] = {}
    for method, (what, column) in product(LOSING, _LEVELS.items()):
        cells = [[results.scores(frame, m, b, column) for b in places] for m in (method, OWN)]
        found, generator = [np.nan] * 3, seeding.generator(0, "half", method, column)
        if all(len(values) for side in cells for values in side):
            drawn = [
                _half(at, *([generator.choice(v, len(v)) for v in side] for side in cells))
                for _ in range(RESAMPLES)
            ]
            found = [_half(at, *cells), *np.quantile(drawn, (0.025, 0.975), method="nearest")]
        row = rows.setdefault(style.METHODS[method].short, {})
        row |= {(what, name): value for name, value in zip(names, found, strict=True)}
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("method")


def _half(at: Sequence[float], ours: Sequence[np.ndarray], own: Sequence[np.ndarray]) -> float:
    """Return where the ratio of the cells' means first falls below one half, or infinity."""
    ratios = [float(a.mean() / b.mean()) for a, b in zip(ours, own, strict=True)]
    i = next((i for i, ratio in enumerate(ratios) if ratio < _LOST), None)
    if not i:
        return np.inf if i is None else at[0]
    share = (ratios[i - 1] - _LOST) / (ratios[i - 1] - ratios[i])
    return at[i - 1] + share * (at[i] - at[i - 1])


def arms(frame: pd.DataFrame, n_episodes: int) -> pd.DataFrame:
    """Return what SILEM's policies return on right arms of several lengths, a row per run."""
    rows = {"no run": dict.fromkeys(ARMS, np.nan)} if frame.empty else {}
    for record in map(results.find, frame["run_id"]):
        config, policy, row = record.run_config, load_policy(record), {}
        for factor in ARMS:
            body = f"Humanoid-arm-{factor:g}"
            row[factor] = evaluate(policy, body, n_episodes, **task_options(config)).return_mean
        rows[f"{config.body}, trial {config.seed}"] = row
    return pd.DataFrame(rows).T.rename_axis("trained on").rename(columns="arm × {:g}".format)
