"""Page "Beyond the paper": the ladder, the slope, ensembles, arms of many lengths.

Everywhere `frame` is a table of `runs`. Where no run is made, figures and tables say so.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from silem import bodies
from silem.report import results, scores, style, transforms
from silem.report.style import number
from silem.study.evaluate import evaluate, load_policy
from silem.study.training import task_options
from silem.util import seeding

OWN = "silem-minus-own"
LOSING = ("silem", "silem-minus", "tpil")
LADDER = (*LOSING, OWN)
BOTH = ("silem", "silem-minus")
ARMS = (0.5, 0.75, 1.0, 1.25, 1.5)
RESAMPLES = 1000
_LOST = 0.5  # of the own-expert level
_FELT = {"humanoid": ("torso vertical x", "velocity x", "head height")}
_RUNNERS = ("pitch", "forward velocity", "height above start")


def runs(study: str, others: Mapping[str, Sequence[str]], budget: str = "book") -> pd.DataFrame:
    """Load a study's runs, and what it shares with others: theirs of some bodies."""
    frames = [results.load_records(study, budget)]
    for name, shared in others.items():
        theirs = results.load_records(name, budget)
        frames.append(results.select(theirs, (*LADDER, "silem-mlp"), shared, with_stand_ins=False))
    frame = pd.concat([found for found in frames if len(found)] or frames[:1], ignore_index=True)
    missing = [run for found in frames for run in found.attrs["missing"]]
    frame.attrs = frames[0].attrs | {"missing": missing}
    return frame


def ladder(frame: pd.DataFrame, lengths: Mapping[str, float], label: str) -> Figure:
    """Draw return, in shares of SILEM-minus's from the own expert, and speed against a length.

    Where a method's mean falls through half of that level is a bar, its bootstrap interval.
    """
    own = frame[frame["method"].eq(OWN)].groupby("body")["return_mean"].mean()
    level = frame["body"].map(own.where(own > 0)).astype(float)
    frame = frame.assign(share=frame["return_mean"] / level)
    columns = {"share": "Return over SILEM⁻'s, own expert", "speed_m_s": "Forward speed (m/s)"}
    figure = scores.against(frame, lengths, label, columns, LADDER)
    axes = figure.axes[0]
    axes.axhline(_LOST, color=style.MUTED, lw=1, ls=style.DASHED)
    for row in half_points(frame, lengths).to_dict("records"):
        at = np.clip([row["low"], row["high"]], None, max(lengths.values()))
        axes.plot(at, [_LOST] * 2, color=style.method(row["method"]).color, lw=6, alpha=0.4)
    return figure


def half_points(
    frame: pd.DataFrame, lengths: Mapping[str, float], column: str = "return_mean"
) -> pd.DataFrame:
    """Return the length at which each method has lost half of the own-expert level, and 95 % of it.

    The level is SILEM-minus's from the body's own expert, mean over trials; between two bodies the
    ratio of the means is interpolated linearly, and its first fall below one half counts: infinite
    without one, NaN as long as a body has no run. The interval is of percentiles of a bootstrap
    over trials: those of every cell are drawn anew. With two trials a cell it is rough.
    """
    places, rows = sorted(lengths, key=lambda body: lengths[body]), []
    for method in LOSING:
        cells = [[results.scores(frame, m, b, column) for b in places] for m in (method, OWN)]
        row, generator = [np.nan] * 3, seeding.generator(0, "half", method, column)
        if all(len(values) for side in cells for values in side):
            at, found = [lengths[body] for body in places], []
            for _ in range(RESAMPLES):
                drawn = [[generator.choice(v, len(v)) for v in side] for side in cells]
                found.append(_half(at, *drawn))
            row = [_half(at, *cells), *np.quantile(found, (0.025, 0.975), method="nearest")]
        rows.append((method, *row))
    return pd.DataFrame(rows, columns=["method", "half", "low", "high"])


def _half(at: Sequence[float], ours: Sequence[np.ndarray], own: Sequence[np.ndarray]) -> float:
    """Return where the ratio of the cells' means first falls below one half, or infinity."""
    ratios = [float(a.mean() / b.mean()) for a, b in zip(ours, own, strict=True)]
    i = next((i for i, ratio in enumerate(ratios) if ratio < _LOST), None)
    if not i:
        return np.inf if i is None else at[0]
    share = (ratios[i - 1] - _LOST) / (ratios[i - 1] - ratios[i])
    return at[i - 1] + share * (at[i] - at[i - 1])


def half_table(frame: pd.DataFrame, lengths: Mapping[str, float]) -> pd.DataFrame:
    """Return, as text, the half points by return and by speed, with their intervals."""

    def words(value: float) -> str:
        return f"beyond {max(lengths.values()):g}" if value == np.inf else number(value, 2)

    table = pd.DataFrame({"method": [style.method(m, "", short=True).label for m in LOSING]})
    for name, column in (("return", "return_mean"), ("speed", "speed_m_s")):
        found = half_points(frame, lengths, column)
        for title, key in (("half of the {} at", "half"), ("from", "low"), ("to", "high")):
            table[name, title.format(name)] = found[key].map(words)
    return table.rename(columns={"method": ("", "method")})


def learned(
    frame: pd.DataFrame, x: Mapping[str, float], label: str, expected: dict[str, dict[str, float]]
) -> Figure:
    """Draw what T does to a few features against a number, with what the bodies would ask for."""
    features = _FELT.get(bodies.get(next(iter(x))).family, _RUNNERS)
    figure = transforms.against(frame, x, label, features)
    for axes, entry in zip(figure.axes, ("A", "b"), strict=True):
        if entry in expected:
            line = [expected[entry][body] for body in x]
            axes.plot(list(x.values()), line, color=style.INK, lw=1, ls=style.DASHED, gid="asked")
    return figure


def ensembles(frame: pd.DataFrame) -> pd.DataFrame:
    """Return, as text, Table 1 for K affine maps and the MLP: a row per body and f."""
    counts = [results.find(run).run_config().hyper.transform_components for run in frame["run_id"]]
    frame, rows = frame.assign(count=counts), []
    for body in ("HC0", "HC2", "Ant6"):
        kinds = [("silem", count) for count in (1, 2, 4, 8)] + [("silem-mlp", 1)] * (body == "HC0")
        for method, count in kinds:
            found = results.cell(frame[frame["count"].eq(count)], method, body)
            row = {"body": body, "f": "MLP" if "mlp" in method else f"affine, K = {count}"}
            row["trials"] = style.trials(len(found))
            for name, column in (("D's reward", "disc_reward"), ("return", "return_mean")):
                row[name] = number(found[column].mean())
                row[f"{name}, lowest"] = number(found[column].min())
            rows.append(row | {"speed (m/s)": number(found["speed_m_s"].mean(), 2)})
    return pd.DataFrame(rows)


def arms(frame: pd.DataFrame, n_episodes: int) -> pd.DataFrame:
    """Return what policies return on right arms of several lengths: a row per run, evaluated now."""
    rows = {}
    for run_id in frame["run_id"]:
        record = results.find(run_id)
        config, policy = record.run_config(), load_policy(record)
        told = [evaluate(policy, f"Humanoid-arm-{factor:g}", n_episodes, **task_options(config))
                for factor in ARMS]  # fmt: skip
        rows[f"{config.body}, trial {config.seed}"] = [found.return_mean for found in told]
    empty = {"no run": [np.nan] * len(ARMS)}
    table = pd.DataFrame(rows or empty, [f"arm × {factor:g}" for factor in ARMS]).T
    return table.rename_axis("trained on")
