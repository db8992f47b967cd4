"""The page about walking: the humanoids' runs read as gaits, in tables, sentences and pictures.

Everywhere `frame` holds the runs of one study at one budget, from `results.load_records`.
"""

import math
from collections.abc import Mapping

import pandas as pd

from silem import bodies
from silem.bodies import MujocoBody
from silem.bodies.body import MAX_STEPS
from silem.bodies.humanoid import DEMONSTRATOR_SPEED_M_S
from silem.report import film, notebook, results, style
from silem.report.claims import MARGIN
from silem.report.curves import QUANTITIES, rises
from silem.report.style import number

FILMED = ("silem", "silem-minus", "tpil", "peng20", "ppo")
"""The methods that are filmed, in their order on the page."""

WALKS, SLOWER, CREEPS = "walks at his speed", "walks, slower", "creeps"
STANDS, FALLS = "stands", "falls"

_SPEEDS = {WALKS: 1 - MARGIN, SLOWER: 0.5, CREEPS: MARGIN}  # least shares of the man's speed
_SHARES, _SPAN = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 3 / 4, 1.0), 0.03
_MILESTONES = ("return_mean", "episode_length", "speed_m_s", "disc_reward", "policy_std")
_SIZE = 320, 300  # pixels of a picture in the strip


def gait(survived: float, speed_m_s: float) -> str:
    """Name what a policy does by its share of steps survived and its speed, as the claims do."""
    share = speed_m_s / DEMONSTRATOR_SPEED_M_S
    if survived < 1 - MARGIN:
        return FALLS
    return next((word for word, least in _SPEEDS.items() if share >= least), STANDS)


def gaits(frame: pd.DataFrame) -> pd.DataFrame:
    """Return one row for each method and number of iterations on a body: means over trials.

    ``survived`` is the share of an episode's steps, ``speed_share`` that of the demonstrator's
    speed; the random policy is left out.
    """
    orders = {"body": results.body_names(frame), "method": list(style.METHODS)}
    ordered = {name: pd.Categorical(frame[name], order) for name, order in orders.items()}
    runs = frame.assign(**ordered)[frame["method"] != "random"]
    keys = ["body", "method", "stand_in", "n_iterations"]
    found = runs.groupby(keys, observed=True, as_index=False).agg(
        trials=("run_id", "size"), survived=("upright", "mean"), speed_m_s=("speed_m_s", "mean")
    )
    found = found.astype({"body": str, "method": str})
    step_s = {name: bodies.of_kind(name, MujocoBody).control_step_s for name in orders["body"]}
    found["survived_s"] = found["survived"] * MAX_STEPS * found["body"].map(step_s)
    found["speed_share"] = found["speed_m_s"] / DEMONSTRATOR_SPEED_M_S
    found["gait"] = [gait(row.survived, row.speed_m_s) for row in found.itertuples()]
    return found


def gait_table(groups: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Return, as text, how the policies of some tables of runs, by name, move: a row per cell."""
    rows = [
        {
            "body": found.body,
            "method": style.method(found.method, "").label,
            "runs": name,
            "iterations": number(found.n_iterations),
            "trials": number(found.trials),
            "steps survived": number(MAX_STEPS * found.survived),
            "seconds": number(found.survived_s, 1),
            "speed (m/s)": number(found.speed_m_s, 2),
            "of the man's speed": f"{number(100 * found.speed_share)} %",
            "ground covered, about (m)": number(found.survived_s * found.speed_m_s, 1),
            "gait": found.gait,
        }
        for name, frame in groups.items()
        for found in gaits(frame).itertuples()
    ]
    table = pd.DataFrame(rows or [{"body": "no run", "method": style.DASH, "gait": style.DASH}])
    return table.drop(columns="runs", errors="ignore") if len(groups) == 1 else table


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
        length = f" ({best['n_iterations']:,} iterations)" if best["stand_in"] else ""
        said["longest"] = f"{style.method(best['method'], '').label} on {best['body']}{length}"
    said |= {f"longest_{name}": round(best[name], 2) for name in ("survived_s", "speed_m_s")}
    return said | {"longest_speed_share": _whole(100 * best["speed_share"])}


def cell_sentences(frame: pd.DataFrame, name: str, method: str, body: str) -> dict[str, float]:
    """Return one cell's numbers, ``<name>_steps`` and so on: means, of stand-ins if need be."""
    runs = results.cell(frame, method, body)
    runs = runs if len(runs) else results.stand_ins(frame, method, body)
    return {
        f"{name}_steps": _whole(MAX_STEPS * runs["upright"].mean()),
        f"{name}_share": _whole(100 * runs["speed_m_s"].mean() / DEMONSTRATOR_SPEED_M_S),
        f"{name}_iterations": runs["n_iterations"].max(),
    }


def early_sentences(frame: pd.DataFrame, method: str, body: str) -> dict[str, float]:
    """Return how long a cell's longest run stayed up when it was as short as most stand-ins are.

    These are ``short_iterations``, ``early_steps`` up to there, ``late_steps`` up to its end.
    """
    said = dict.fromkeys(("short_iterations", "early_steps", "late_steps"), math.nan)
    lengths = frame.loc[frame["stand_in"], "n_iterations"]
    if run_id := longest_run(frame, method, body):
        curve = results.load_curve(run_id)
        said["late_steps"] = _whole(_just_before(curve, 1.0)["episode_length"])
        if len(lengths):
            said["short_iterations"] = short = int(lengths.mode().iloc[0])
            early = _just_before(curve, short / curve["iteration"].max())
            said["early_steps"] = _whole(early["episode_length"])
    return said


def milestones(frame: pd.DataFrame, method: str, body: str) -> pd.DataFrame:
    """Return, as text, how a cell's longest run came along: means up to parts of its iterations."""
    run_id = longest_run(frame, method, body)
    if not run_id:
        return pd.DataFrame([{"iterations": "no run"}])
    curve, rows = results.load_curve(run_id), []
    headings = QUANTITIES | {"policy_std": ("policy's standard deviation", 2)}
    for share in _SHARES:
        part = _just_before(curve, share)
        row = {"iterations": number(share * curve["iteration"].max())}
        for name in _MILESTONES:
            heading, digits = headings[name]
            row[heading] = number(part[name], digits)
        row["reward of D per step"] = number(part["disc_reward"] / part["episode_length"], 2)
        rows.append(row)
    return pd.DataFrame(rows)


def longest_run(frame: pd.DataFrame, method: str, body: str) -> str:
    """Return the id of a cell's run of the most iterations, the best one of them; "" for none."""
    runs = frame[(frame["method"] == method) & (frame["body"] == body)]
    ordered = runs.sort_values(["n_iterations", "return_mean"])
    return str(ordered["run_id"].iloc[-1]) if len(ordered) else ""


def _just_before(curve: pd.DataFrame, share: float) -> pd.Series:
    """Return a curve's means over the last few of the iterations up to a share of them."""
    total = curve["iteration"].max()
    return curve[curve["iteration"].between((share - _SPAN) * total, share * total)].mean()


def _whole(value: float) -> float:
    return math.nan if math.isnan(value) else round(value)


def show_strip(run_id: str, duration_s: float) -> None:
    """Show a run's policy in equally spaced pictures, a film on paper; of no run, "", say so."""
    if not run_id:
        notebook.note("No pictures: there is no run.")
    elif why := film.why_no_pictures(results.find(run_id).config["body"]):
        notebook.note(f"No pictures: {why}")
    else:
        (clip,) = film.of_runs({"": results.find(run_id)}, duration_s, _SIZE).values()
        notebook.show_picture(film.strip(clip, n_frames=6))
