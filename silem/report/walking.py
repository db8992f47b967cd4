"""What walks and what does not: the humanoids' runs read as gaits, in tables and in words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd

from silem import bodies
from silem.bodies import MujocoBody
from silem.bodies.body import MAX_STEPS
from silem.bodies.humanoid import DEMONSTRATOR_SPEED_M_S
from silem.report import results, style, tables
from silem.report.claims import MARGIN

WALKS, SLOWER, CREEPS = "walks at his speed", "walks, slower", "creeps"
STANDS, FALLS = "stands", "falls"

_SPEEDS = {WALKS: 1 - MARGIN, SLOWER: 0.5, CREEPS: MARGIN}  # least shares of the man's speed
_TAIL = 0.1  # of a curve, whose mean is compared with that of as much before it


def gait(survived: float, speed_m_s: float) -> str:
    """Name what a policy does; who stays up and keeps his speed is named by the claims' bounds.

    Args:
        survived: Share of an episode's steps before the fall.
        speed_m_s: Mean forward speed.
    """
    share = speed_m_s / DEMONSTRATOR_SPEED_M_S
    if survived < 1 - MARGIN:
        return FALLS
    return next((word for word, least in _SPEEDS.items() if share >= least), STANDS)


def gaits(frame: pd.DataFrame) -> pd.DataFrame:
    """Return one row for each method and number of iterations on a body: means over trials.

    Args:
        frame: Runs of one study at one budget, from `results.load_records`.

    Returns:
        ``body``, ``method``, ``n_iterations``, ``stand_in``, ``trials``, ``survived`` (share of an
        episode's steps), ``survived_s``, ``speed_m_s``, ``speed_share`` (of the demonstrator's),
        ``gait``; without the random policy.
    """
    rows = []
    for body in results.body_names(frame):
        for method in (name for name in style.METHODS if name != "random"):
            runs = frame[(frame["body"] == body) & (frame["method"] == method)]
            for (stand_in, n), group in runs.groupby(["stand_in", "n_iterations"]):
                survived, speed = group["upright"].mean(), group["speed_m_s"].mean()
                found = {"body": body, "method": method, "n_iterations": n, "stand_in": stand_in}
                found |= {"trials": len(group), "survived": survived}
                found |= {"survived_s": survived * _episode_s(body), "speed_m_s": speed}
                found["speed_share"] = speed / DEMONSTRATOR_SPEED_M_S
                rows.append(found | {"gait": gait(survived, speed)})
    return pd.DataFrame(rows, columns=_COLUMNS)


_COLUMNS = [
    "body", "method", "n_iterations", "stand_in", "trials", "survived", "survived_s", "speed_m_s",
    "speed_share", "gait",
]  # fmt: skip


def gait_table(groups: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Return, as text, how the policies of some tables of runs move, a row per cell.

    Args:
        groups: Tables of runs by what to call them; of a single one the name is left out.
    """
    rows = []
    for name, frame in groups.items():
        for found in gaits(frame).to_dict("records"):
            rows.append(
                {
                    "body": found["body"],
                    "method": style.method(found["method"], "").label,
                    "runs": name,
                    "iterations": style.number(found["n_iterations"]),
                    "trials": style.number(found["trials"]),
                    "steps survived": style.number(MAX_STEPS * found["survived"]),
                    "seconds": tables.number(found["survived_s"], 1),
                    "speed (m/s)": tables.number(found["speed_m_s"], 2),
                    "of the man's speed": f"{style.number(100 * found['speed_share'])} %",
                    "ground covered, about (m)": tables.number(
                        found["survived_s"] * found["speed_m_s"], 1
                    ),
                    "gait": found["gait"],
                }
            )
    table = pd.DataFrame(rows or [{"body": "no run", "method": tables.DASH, "gait": tables.DASH}])
    return table.drop(columns="runs", errors="ignore") if len(groups) == 1 else table


def sentences(frame: pd.DataFrame) -> dict[str, str | float]:
    """Return what the page says about a study: numbers and texts by name.

    Args:
        frame: Runs of one study at one budget.
    """
    found = gaits(frame)
    said: dict[str, str | float] = {"n_cells": len(found)}
    counted = {"walk": WALKS, "slower": SLOWER, "creep": CREEPS, "stand": STANDS, "fall": FALLS}
    said |= {f"n_{name}": int((found["gait"] == word).sum()) for name, word in counted.items()}
    longest = found.loc[found["survived"].idxmax()] if len(found) else None
    said["longest"] = tables.DASH if longest is None else _name(longest)
    for name in ("survived_s", "speed_m_s", "speed_share"):
        said[f"longest_{name}"] = math.nan if longest is None else _rounded(name, longest[name])
    rising = [rise > 0 for rise in rises(frame)]
    return said | {"n_rising": sum(rising), "n_curves": len(rising)}


def cell_sentences(frame: pd.DataFrame, name: str, method: str, body: str) -> dict[str, float]:
    """Return one cell's numbers, ``<name>_steps``, ``_speed``, ``_share`` and ``_iterations``.

    They are means over its trials, over stand-ins where none is finished, and NaN without any run.
    """
    runs = results.cell(frame, method, body)
    runs = runs if len(runs) else results.stand_ins(frame, method, body)
    speed = runs["speed_m_s"].mean()
    return {
        f"{name}_steps": _whole(MAX_STEPS * runs["upright"].mean()),
        f"{name}_speed": speed,
        f"{name}_share": _whole(100 * speed / DEMONSTRATOR_SPEED_M_S),
        f"{name}_iterations": runs["n_iterations"].max(),
    }


def early_sentences(frame: pd.DataFrame, method: str, body: str) -> dict[str, float]:
    """Return how long a cell's longest run stayed up when it was as short as the stand-ins are.

    ``short_iterations`` is the commonest number of iterations of the stand-ins, ``early_steps`` the
    longest run's steps before a fall up to there, ``late_steps`` up to its end; NaN for unknown.
    """
    said = dict.fromkeys(("short_iterations", "early_steps", "late_steps"), math.nan)
    lengths = frame.loc[frame["stand_in"], "n_iterations"]
    run_id = longest_run(frame, method, body)
    if run_id:
        curve = results.load_curve(run_id)
        total = curve["iteration"].max()
        said["late_steps"] = _whole(_just_before(curve, total)["episode_length"])
        if len(lengths):
            said["short_iterations"] = short = int(lengths.mode().iloc[0])
            said["early_steps"] = _whole(_just_before(curve, short)["episode_length"])
    return said


def _just_before(curve: pd.DataFrame, iteration: float) -> pd.Series:
    """Return a curve's means over the last part of the iterations up to one of them."""
    span = _SPAN * curve["iteration"].max()
    return curve[curve["iteration"].between(iteration - span, iteration)].mean()


def rises(frame: pd.DataFrame) -> Iterator[float]:
    """Yield by how much each run's return rose: the last tenth of its curve over the one before."""
    for run_id in frame.loc[frame["n_steps"] > 0, "run_id"]:
        values = results.load_curve(run_id)["return_mean"].dropna().to_numpy()
        n = max(1, round(_TAIL * len(values)))
        if len(values) >= 2 * n:
            yield float(np.mean(values[-n:]) - np.mean(values[-2 * n : -n]))


def milestones(frame: pd.DataFrame, method: str, body: str) -> pd.DataFrame:
    """Return, as text, how a cell's longest run came along: means up to parts of its iterations.

    Args:
        frame: Runs of one study at one budget.
        method: The method.
        body: The body.
    """
    rows = []
    run_id = longest_run(frame, method, body)
    curve = results.load_curve(run_id) if run_id else pd.DataFrame({"iteration": []})
    total = curve["iteration"].max()
    for share in _SHARES if run_id else ():
        part = _just_before(curve, share * total)
        row = {"iterations": style.number(share * total)}
        for name, (heading, digits) in _MILESTONES.items():
            row[heading] = tables.number(part[name], digits)
        row["reward of D per step"] = tables.number(part["disc_reward"] / part["episode_length"], 2)
        rows.append(row)
    return pd.DataFrame(rows or [{"iterations": "no run"}])


_SHARES, _SPAN = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 3 / 4, 1.0), 0.03
_MILESTONES = {
    "return_mean": ("return", 0),
    "episode_length": ("steps before a fall", 0),
    "speed_m_s": ("speed (m/s)", 2),
    "disc_reward": ("reward of D", 0),
    "policy_std": ("policy's std", 2),
}


def longest_run(frame: pd.DataFrame, method: str, body: str) -> str:
    """Return the id of a cell's run of the most iterations, the best one of them; "" for none."""
    runs = frame[(frame["method"] == method) & (frame["body"] == body)]
    ordered = runs.sort_values(["n_iterations", "return_mean"])
    return str(ordered["run_id"].iloc[-1]) if len(ordered) else ""


def _episode_s(body: str) -> float:
    return MAX_STEPS * bodies.of_kind(body, MujocoBody).control_step_s


def _name(cell: Any) -> str:
    """Name a cell in a sentence."""
    words = f"{style.method(cell['method'], '').label} on {cell['body']}"
    return words + (f" ({cell['n_iterations']:,} iterations)" if cell["stand_in"] else "")


def _rounded(name: str, value: float) -> float:
    return _whole(100 * value) if name == "speed_share" else round(value, 2)


def _whole(value: float) -> float:
    return math.nan if math.isnan(value) else round(value)
