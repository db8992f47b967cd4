"""The page about walking: the humanoids' runs read as gaits, in tables, sentences and pictures.

Everywhere `frame` holds the runs of one study at one budget, from `results.load_records`.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from silem import bodies
from silem.bodies import MujocoBody
from silem.bodies.body import MAX_STEPS
from silem.bodies.humanoid import DEMONSTRATOR_SPEED_M_S
from silem.motion.demonstrator import CLIPS, published_motion
from silem.motion.gait import distance, walk
from silem.report import film, results, style, tables
from silem.report.claims import MARGIN
from silem.report.curves import rises
from silem.report.scores import COMPARED
from silem.report.style import QUANTITIES, number
from silem.study.evaluate import EVALUATION_SEED, episodes, load_policy
from silem.study.studies import BOTH, cells
from silem.study.training import task_options
from silem.util import files, paths

RIVALS = COMPARED[1:]

WALKS, SLOWER, CREEPS = "walks", "walks, slower", "creeps"
STANDS, FALLS = "stands", "falls"

_SPEEDS = {WALKS: 1 - MARGIN, SLOWER: 0.5, CREEPS: MARGIN}  # least shares of the man's speed
MAN = "08_01"
MEASURES = ("step_hz", "stance", "clearance_m", "symmetry", "features", "movement")
"""Measures of a walk (`silem.motion.gait`), the stance of both feet. The last two are distances to
the man's clip in its deviations, as they are and with both shifted to the same means: without that
a body's shape counts as well."""

_SHARES, _SPAN = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 3 / 4, 1.0), 0.03
_MILESTONES = ("return_mean", "episode_length", "speed_m_s", "disc_reward", "policy_std")
_CELL = 200, 264  # pixels of one cell in the film of all


def gait(survived: float, speed_m_s: float) -> str:
    """Name what a policy does by its share of steps survived and its speed, as the claims do."""
    share = speed_m_s / DEMONSTRATOR_SPEED_M_S
    if survived < 1 - MARGIN:
        return FALLS
    return next((word for word, least in _SPEEDS.items() if share >= least), STANDS)


def gaits(frame: pd.DataFrame) -> pd.DataFrame:
    """Return one row for each method on a body: means over trials.

    ``survived`` is the share of an episode's steps, ``speed_share`` that of the demonstrator's
    speed, ``run_ids`` are the trials; the random policy is left out.
    """
    columns = ["return_mean", "upright", "speed_m_s"]
    rows = [
        (body, method, list(runs["run_id"]), *runs[columns].mean())
        for body, method, runs in results.planned(frame)
        if len(runs) and method != "random"
    ]
    names = ["body", "method", "run_ids", "return_mean", "survived", "speed_m_s"]
    found = pd.DataFrame(rows, columns=names)
    step_s = {n: bodies.of_kind(n, MujocoBody).control_step_s for n in results.body_names(frame)}
    found["survived_s"] = found["survived"] * MAX_STEPS * found["body"].map(step_s)
    found["speed_share"] = found["speed_m_s"] / DEMONSTRATOR_SPEED_M_S
    found["gait"] = [gait(row.survived, row.speed_m_s) for row in found.itertuples()]
    return found


def measured(frame: pd.DataFrame, n_episodes: int) -> pd.DataFrame:
    """Return how the policies of some runs walk, by run id: `MEASURES`, means over episodes."""
    rows = {}
    for run_id in frame.loc[frame["n_steps"] > 0, "run_id"]:
        run = results.find(run_id)
        config, policy = run.run_config, load_policy(run)
        rate_hz, task = 1 / config.learner.control_step_s, task_options(config)
        seen = episodes(policy, config.learner, n_episodes, EVALUATION_SEED, **task)
        rows[run_id] = pd.DataFrame([_measures(e.features, rate_hz) for e in seen]).mean()
    return pd.DataFrame(rows, index=list(MEASURES)).T


def _measures(features: np.ndarray, rate_hz: float) -> dict[str, float]:
    shown = published_motion(MAN).features
    moved = features - features.mean(axis=0) + shown.mean(axis=0)
    found = {"features": features, "movement": moved}
    distances = {name: distance(these, shown, rate_hz) for name, these in found.items()}
    steps = walk(features, rate_hz)
    return steps._asdict() | {"stance": (steps.stance_left + steps.stance_right) / 2} | distances


def _man() -> dict[str, pd.DataFrame]:
    """Return the man's own measures: in the clip shown, in his others, and as a statue."""
    man, others = published_motion(MAN), [published_motion(name) for name in CLIPS if name != MAN]
    still = np.repeat(man.features.mean(axis=0, keepdims=True), len(man.features), axis=0)
    statue = replace(man, features=still, qpos=man.qpos[[0] * len(still)])
    rows = {"his clip": [man], f"his {len(others)} others": others, "as a statue": [statue]}
    return {
        name: pd.DataFrame(
            [_measures(m.features, m.rate_hz) | {"speed_m_s": m.speed_m_s} for m in motions]
        )
        for name, motions in rows.items()
    }


def gait_table(groups: Mapping[str, pd.DataFrame], measures: pd.DataFrame) -> pd.DataFrame:
    """Return, as text, how the policies of some tables of runs, by name, move: a row per cell.

    The man stands first; `measures` are what `measured` returns of the runs.
    """
    columns = ["return_mean", "upright", "speed_m_s", *MEASURES]
    shown: list[tuple[dict[str, str], pd.DataFrame]] = [
        ({"body": "the man", "method": name}, found.reindex(columns=columns))
        for name, found in _man().items()
    ]
    for name, frame in groups.items():
        joined = frame.join(measures, on="run_id")
        for cell in gaits(frame).itertuples():
            called = {"body": cell.body, "method": style.METHODS[cell.method].short}
            called |= ({"runs": name} if len(groups) > 1 else {}) | {"gait": cell.gait}
            shown.append((called, joined[joined["run_id"].isin(cell.run_ids)]))
    if not any(map(len, groups.values())):
        shown.append(({"body": "no run"}, pd.DataFrame(columns=columns)))
    table = tables.means(shown, columns).fillna(style.DASH)
    table["trials"] = table["trials"].mask(table["body"].eq("the man"), style.DASH)
    first = [name for name in ("body", "method", "runs", "gait") if name in table]
    return table[[*first, *table.columns.difference(first, sort=False)]]


def sentences(frame: pd.DataFrame) -> dict[str, str | float]:
    """Return what the page says about a study: numbers and texts by name."""
    found = gaits(frame)
    counted = {"walk": WALKS, "slower": SLOWER, "creep": CREEPS, "stand": STANDS, "fall": FALLS}
    rising = rises(frame)
    said: dict[str, str | float] = {"n_cells": len(found)}
    said |= {"n_rising": sum(rising), "n_curves": len(rising), "longest": style.DASH}
    said |= {f"n_{name}": int((found["gait"] == word).sum()) for name, word in counted.items()}
    best = {"survived_s": math.nan, "speed_m_s": math.nan, "speed_share": math.nan}
    if len(found):
        best = found.loc[found["survived"].idxmax()]
        said["longest"] = f"{style.method(best['method'], '').label} on {best['body']}"
    said |= {f"longest_{name}": round(best[name], 2) for name in ("survived_s", "speed_m_s")}
    return said | {"longest_speed_share": _whole(100 * best["speed_share"])}


def cell_sentences(frame: pd.DataFrame, name: str, method: str, body: str) -> dict[str, float]:
    """Return one cell's numbers, ``<name>_steps`` and so on: means over trials."""
    runs = results.cell(frame, method, body)
    return {
        f"{name}_steps": _whole(MAX_STEPS * runs["upright"].mean()),
        f"{name}_share": _whole(100 * runs["speed_m_s"].mean() / DEMONSTRATOR_SPEED_M_S),
        f"{name}_iterations": runs["n_iterations"].max(),
    }


def without_penalty(
    frame: pd.DataFrame, column: str, factor: float = 1.0, method: str = "silem"
) -> str:
    """Write a method's means by the paper's loss for D on each body, in brackets those by ours."""
    both, told = (results.paper_loss(frame), frame), []
    for body in results.body_names(frame):
        means = [(factor * results.cell(f, method, body)[column]).mean() for f in both]
        told.append("{} ({} with it) on {}".format(*map(number, means), body))
    return ", ".join(told)


def milestones(frame: pd.DataFrame, method: str, body: str) -> pd.DataFrame:
    """Return, as text, how a cell's best run came along: means up to parts of its iterations."""
    run_id = best_run(frame, method, body)
    if not run_id:
        return pd.DataFrame([{"iterations": "no run"}])
    curve, rows = results.load_curve(run_id), []
    for share in _SHARES:
        part = _just_before(curve, share)
        row = {"iterations": number(share * curve["iteration"].max())}
        for name in _MILESTONES:
            heading, digits = QUANTITIES[name]
            row[heading] = number(part[name], digits)
        row["reward of D per step"] = number(part["disc_reward"] / part["episode_length"], 2)
        rows.append(row)
    return pd.DataFrame(rows)


def best_run(frame: pd.DataFrame, method: str, body: str) -> str:
    """Return the id of a cell's run of the highest return; "" for none."""
    ordered = results.cell(frame, method, body).sort_values("return_mean")
    return str(ordered["run_id"].iloc[-1]) if len(ordered) else ""


def _just_before(curve: pd.DataFrame, share: float) -> pd.Series:
    """Return a curve's means over the last few of the iterations up to a share of them."""
    total = curve["iteration"].max()
    return curve[curve["iteration"].between((share - _SPAN) * total, share * total)].mean()


def _whole(value: float) -> float:
    return math.nan if math.isnan(value) else round(value)


def all_cells(frame: pd.DataFrame, duration_s: float) -> film.Clip:
    """Film the man, who begins again when his clip ends, PPO, and the twelve cells, on one clock.

    Of each cell the best run, from the same first state; blank where there is none.
    """
    man, clips = published_motion(MAN), {}
    shown = film.motion(film.man(), man.qpos, man.rate_hz, size=_CELL)
    times = np.arange(max(1, round(duration_s * shown.frames_per_s))) % len(shown.frames)
    clips["the man"] = film.Clip(shown.frames[times], shown.frames_per_s)
    names = results.body_names(frame)
    every = [*product(["ppo"], names), *((m, b) for b in names for m in COMPARED)]
    best = {f"{style.METHODS[m].short}\n{b}": best_run(frame, m, b) for m, b in every}
    runs = {label: results.find(run_id) if run_id else None for label, run_id in best.items()}
    return film.grid(clips | film.of_runs(runs, duration_s, _CELL), n_columns=4)


def verdicts(frame: pd.DataFrame, longer: pd.DataFrame, settings: pd.DataFrame) -> pd.DataFrame:
    """Answer, as text, for each rival and body: does it fall by its budget, settings or method?

    A rival whose runs of `frame` fall is owed a run at twice the iterations (`longer`) and one with
    what its search chose (`settings`). What does not fall names the reason; where both fall, it is
    the method as far as that was tried.
    """
    rows = []
    for body, method in product(results.body_names(frame), RIVALS):
        found = [results.cell(table, method, body) for table in (frame, longer, settings)]
        up = [float(runs["upright"].mean()) for runs in found]
        fell = [None if math.isnan(u) else gait(u, 0.0) == FALLS for u in up]
        causes = [
            name for name, f in zip(("budget", "settings"), fell[1:], strict=True) if f is False
        ]
        answer = " and ".join(causes) or "the method, as far as tried"
        if not fell[0]:
            answer = "not run yet" if fell[0] is None else "does not fall"
        elif not causes and None in fell:
            answer = "open: not run yet"
        titles = ("steps survived", "at twice the iterations", "with the search's settings")
        row = {"body": body, "rival": style.method(method, "").label}
        row |= {t: number(MAX_STEPS * u) for t, u in zip(titles, up, strict=True)}
        rows.append(row | {"why it falls": answer})
    return pd.DataFrame(rows)


def search_table(frame: pd.DataFrame) -> pd.DataFrame:
    """Return, as text, what each setting of the rivals' search led to: return, steps survived."""
    began = {cell.method: dict(cell.overrides) for cell in cells("humanoids")}
    tried = tables.searched(frame, began).set_index(["setting", "method"])
    steps = (MAX_STEPS * tried["upright"]).map(number)
    told = tried["return_mean"].map(number) + ", " + steps + " steps"
    told = told.where(tried["upright"].notna(), style.DASH)
    table = told.unstack(fill_value="not tried").reindex(told.index.unique("setting"))
    names = {name: method.short for name, method in style.METHODS.items()}
    return table.rename(columns=names).reset_index()


def reversal() -> pd.DataFrame:
    """Return what discriminators told apart in the toy of TPIL's reversal, means over seeds.

    The toy is `benchmarks.reversal`; columns are ``worse``, ``method``, ``depth``, ``coef``,
    ``domain_accuracy``, ``probe_accuracy``, ``ranking``, ``reward_good`` and ``seed`` (how many).
    """
    rows = pd.DataFrame(files.read_json(paths.REPO / "data" / "search" / "reversal.json"))
    grouped = rows.groupby(["worse", "method", "depth", "coef"], sort=False)
    return grouped.mean().assign(seed=grouped["seed"].nunique()).reset_index()


def reversal_sentences() -> dict[str, float]:
    """Return what the page says about the toy: shares in per cent, where C_g > 0, and rewards."""
    found = reversal().set_index("method")
    tpil = found.loc["tpil"].query("coef > 0").drop(columns="worse")
    tpil = tpil.groupby("depth").agg(["mean", "min"])
    means = found.groupby("method")[["ranking", "reward_good"]].mean()
    shares = {
        "shallow_domain": tpil.at[1, ("domain_accuracy", "mean")],
        "deep_domain": tpil.at[2, ("domain_accuracy", "min")],
        "deep_probe": tpil.at[2, ("probe_accuracy", "min")],
        "shallow_ranking": tpil.at[1, ("ranking", "mean")],
        "deep_ranking": tpil.at[2, ("ranking", "mean")],
        "silem_ranking": means.at["silem", "ranking"],
        "minus_ranking": means.at["silem-minus", "ranking"],
    }
    rewards = {
        "deep_good": tpil.at[2, ("reward_good", "mean")],
        "silem_good": means.at["silem", "reward_good"],
    }
    return {name: round(100 * share) for name, share in shares.items()} | rewards


@style.applied()
def reversal_figure() -> Figure:
    """Draw what TPIL's domain head, a linear probe and its reward tell apart, over C_g."""
    found, handles = reversal(), {}
    titles = ("bodies told apart by a state", "good rewarded above bad")
    names = [f"Worse is {worse}: {title}" for worse in found["worse"].unique() for title in titles]
    figure, panels = style.panels(names, 2.0, sharex=True, sharey=True)
    for index, (_, rows) in enumerate(found.groupby("worse", sort=False)):
        told, ranked = panels[2 * index : 2 * index + 2]
        for depth, of_depth in rows[rows["method"] == "tpil"].groupby("depth"):
            look: dict[str, Any] = {"color": style.body_color(depth, 3), "marker": " os"[depth]}
            label = f"TPIL, encoder of depth {depth}"
            handles[label] = style.handle(label=label, ms=4, **look)
            for axes, column, line in (
                (told, "domain_accuracy", "-"), (told, "probe_accuracy", style.DASHED),
                (ranked, "ranking", "-"),
            ):  # fmt: skip
                axes.plot(of_depth["coef"], of_depth[column], ls=line, ms=4, **look)
        for method in BOTH:
            known, level = style.method(method, ""), rows.loc[rows["method"] == method, "ranking"]
            look = {"color": known.color, "ls": ":", "lw": 2}
            handles[known.label] = style.handle(label=known.label, **look)
            ranked.axhline(level.mean(), **look)
    for axes, of in zip(panels, ("states", "pairs") * 2, strict=True):
        axes.set(ylabel=f"share of {of}", ylim=(0.3, 1.03))
    for axes in panels[-2:]:
        axes.set_xlabel("C_g, weight of the reversed gradient")
    note = "left, solid: TPIL's own domain head; dashed: a linear probe of what it is shown"
    note += f"; seeds: {style.span(found['seed'])}"
    return style.finish(figure, list(handles.values()), note, ncols=4)
