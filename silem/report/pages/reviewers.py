"""The page for reviewers: the claims in short, improvement and profiles, where data is from."""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from pandas.io.formats.style import Styler
from scipy import stats

from silem import bodies, paper
from silem.motion.demonstrations import manifest
from silem.report import claims, results, scores, statistics, style
from silem.report.style import number
from silem.report.tables import small, styled


def judged(budget: str = "book") -> pd.DataFrame:
    """Return every claim with what this book's runs say, of all studies that are judged."""
    frames = [results.load_records(study, budget) for study in claims.CLAIMS]
    found = [claims.evaluate(f).assign(planned=results.n_trials(f)) for f in frames]
    return pd.concat(found, ignore_index=True)


def counts(judged: pd.DataFrame) -> dict[str, int]:
    """Return how many claims there are, how many hold, and so on."""
    verdict, few = judged["verdict"], judged["reason"].str.startswith("too few trials")
    names = {"hold": claims.HOLDS, "fail": claims.FAILS, "undecided": claims.UNDECIDED}
    counted = {name: int(verdict.eq(of).sum()) for name, of in names.items()}
    return counted | {"claims": len(judged), "few": int(few.sum())}


def verdicts(judged: pd.DataFrame) -> Styler:
    """Return the claims in short, a row for each that is made of several bodies."""
    rows: dict[str, dict[str, str]] = {}
    waiting: dict[str, list[str]] = {}
    for found in judged.itertuples():
        claim, finding = found.claim, found.findings[0]
        printed = number(claim.printed, finding.measure.digits)
        row = rows.setdefault(claim.title, {"claim": claim.title, "paper": printed, "here": ""})
        if np.isnan(finding.ours):
            waiting.setdefault(claim.title, []).append(claim.body)
        else:
            value = claims.value(finding, found.planned, alone=False, trials=True)
            row["here"] += f"<div><b>{claim.body} {found.verdict}:</b> {value}</div>"
    for title, names in waiting.items():
        rows[title]["here"] += f"<b>undecided, no value yet:</b> {', '.join(names)}"
    return styled(pd.DataFrame(rows.values()))


@style.applied()
def improvement(frame: pd.DataFrame) -> Figure:
    """Draw for each body how probably a trial of SILEM returns more than one of another method.

    It is the share of pairs of trials, with Newcombe's interval. A mark is full where the interval
    leaves out one half and both methods have the trials that a claim needs, else hollow: undecided.
    """
    rivals = [m for m in style.METHODS if m not in ("silem", "ppo", "random")]
    rows = [(rival, body) for rival in rivals for body in results.body_names(frame)
            if results.is_planned(frame, rival, body)]  # fmt: skip
    figure, axes = style.new_figure(0.9 + 0.27 * len(rows))
    labels = []
    for y, (rival, body) in enumerate(rows):
        look = style.method(rival, results.original_body(frame))
        cells = [results.scores(frame, method, body, "return_mean") for method in ("silem", rival)]
        labels.append(f"{look.label}, {body}")
        low, high = statistics.wins_interval(*cells)
        counts = [len(cell) for cell in cells]
        if min(counts):
            decided = min(counts) >= claims.MIN_TRIALS and not low <= 0.5 <= high
            faint = {} if decided else {"mfc": "white", "mew": 1.6}
            axes.plot([low, high], [y, y], color=look.color, lw=2, alpha=1 if decided else 0.45)
            axes.plot([statistics.wins(*cells)], [y], look.marker, color=look.color, ms=7, **faint)
        text = "no run" if not min(counts) else f"{counts[0]} and {counts[1]} trials"
        axes.text(1.03, y, text, va="center", fontsize=8, color=style.MUTED)
    axes.axvline(0.5, color=style.MUTED, lw=1, ls=style.DASHED)
    axes.set_yticks(range(len(rows)), labels)
    axes.set(xlim=(-0.02, 1.02), ylim=(len(rows) - 0.5, -0.5))
    axes.set_xlabel("probability that a trial of SILEM returns more than one of the method named")
    axes.grid(axis="x")
    axes.grid(visible=False, axis="y")
    note = (
        "bars: Newcombe's 95 % score interval of the share of pairs of trials; hollow: undecided,"
        f" it spans one half or a method has fewer than {claims.MIN_TRIALS} trials"
    )
    return scores.finish(figure, frame, note=note)


@style.applied()
def profiles(frame: pd.DataFrame) -> Figure:
    """Draw each method's performance profile: the share of its runs that score more than tau.

    A run's score is its return over the mean of the body's experts, on humanoids, which have none,
    over the highest return. All bodies' runs count alike; from `scores.INTERVAL_TRIALS` runs on a
    band is Clopper and Pearson's 95 % interval at each tau.
    """
    walks = bodies.get(results.body_names(frame)[0]).family == "humanoid"
    unit = paper.number("humanoid_max_return") if walks else frame["expert_return"]
    scored = frame.assign(score=frame["return_mean"].astype(float) / unit)
    low, top = (np.nan_to_num(end) for end in (scored["score"].min(), scored["score"].max()))
    low, top = min(0.0, low), max(1.05, top + 0.05)
    figure, axes = style.new_figure(3.2)
    taus, handles = np.linspace(low, top, 500), []
    for name in (name for name in style.METHODS if (frame["method"] == name).any()):
        look = style.method(name, results.original_body(frame))
        values = scored.loc[scored["method"] == name, "score"].dropna().to_numpy()
        handles.append(style.handle(look.color, f"{look.label}, {len(values)} runs", lw=2.2))
        if not len(values):
            continue
        above = (values[:, None] > taus).sum(axis=0)
        lone = len(values) < scores.INTERVAL_TRIALS
        line: dict[str, Any] = {"lw": 1.2, "ls": style.DASHED} if lone else {"lw": 2}
        axes.step(taus, above / len(values), color=look.color, **line)
        if not lone:
            tests = [stats.binomtest(k, len(values)) for k in range(len(values) + 1)]
            band = np.array([test.proportion_ci(statistics.LEVEL) for test in tests])[above]
            axes.fill_between(taus, *band.T, color=look.color, alpha=0.14, lw=0, step="pre")
    axes.set(ylim=(-0.02, 1.04), ylabel="share of runs above τ", xlim=(low, top))
    over = "the highest possible" if walks else "the mean of the body's experts"
    axes.set_xlabel(f"τ: return of an episode over {over}")
    note = (
        f"dashed: fewer than {scores.INTERVAL_TRIALS} runs, without a band; bands: Clopper"
        " and Pearson's 95 % interval at each τ, as if all bodies' runs were of one kind"
    )
    return scores.finish(figure, frame, handles, note)


def cards() -> Styler:
    """Return a data card for each published file of demonstrations, a row each."""
    rows = []
    for name, about in manifest().items():
        if run := about["expert_run_id"]:
            origin = f"{about['n_trajectories']} episodes of the expert of run {run}"
            licence = "this project's own, MIT"
        else:
            source = f'<a href="{about["source"]}">CMU database</a>'
            origin = f"clip {about['clip']} of the {source}, a man walking"
            licence = f"{about['licence']} ({about['acknowledgement']})"
        if parent := about.get("retargeted_from"):
            origin += f", {parent} retargeted with {about['solver']}"
        holds = [f"{about['n_features']} features of each state, no actions, no rewards"]
        if "n_states" in about:
            holds.append(f"{about['n_states']} states, {about['rate_hz']:g} a second")
        if speed_m_s := about.get("speed_m_s", about.get("summary", {}).get("speed_m_s")):
            holds.append(f"{number(speed_m_s, 2)} m/s")
        if about.get("n_failed") is not None:
            holds.append(f"failed episodes: {about['n_failed']}, kept")
        row = {
            "file": f"{name}.npz" + small(f"{about['body']}; SHA-256 {about['sha256'][:16]}…"),
            "origin": origin + small(f"licence: {licence}"),
            "holds": "; ".join(holds),
            "changed": ", ".join(about.get("repairs", [])) or "no repairs",
        }
        rows.append(row)
    return styled(pd.DataFrame(rows))
