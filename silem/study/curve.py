"""Learning curves: one row per iteration while training, at most 200 rows when published."""

from __future__ import annotations

import csv
import io
import warnings

import numpy as np

COLUMNS = (
    "iteration",
    "timesteps",
    "return_mean",
    "speed_m_s",
    "disc_reward",
    "disc_loss",
    "disc_acc_expert",
    "disc_acc_learner",
    "transform_loss",
    "policy_std",
    "episode_length",
    "domain_acc",
)
_ALWAYS = 10
"""The first columns stand in every published curve; a later one only where it has numbers."""

MAX_ROWS = 200


def row(iteration: int, timesteps: int, stats: dict[str, float]) -> np.ndarray:
    """Return one iteration's row, NaN where the iteration has no such number."""
    values = {"iteration": iteration, "timesteps": timesteps} | stats
    return np.array([values.get(column, np.nan) for column in COLUMNS], dtype=np.float64)


def thinned(curve: np.ndarray) -> np.ndarray:
    """Average blocks of neighbouring iterations until at most `MAX_ROWS` rows are left.

    Args:
        curve: (iterations, columns), NaN for blank.

    Returns:
        (rows, columns): each block's mean over what is not blank, at the block's last iteration.
        Averages rather than every k-th row, because most iterations see no episode end.
    """
    size = max(1, -(-len(curve) // MAX_ROWS))
    blocks = [curve[start : start + size] for start in range(0, len(curve), size)]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Mean of empty slice", RuntimeWarning)
        rows = [np.concatenate([b[-1, :2], np.nanmean(b[:, 2:], axis=0)]) for b in blocks]
    return np.array(rows).reshape(-1, len(COLUMNS))


def to_csv(curve: np.ndarray) -> str:
    """Return a thinned curve as CSV text: 5 significant digits, blank for NaN."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    rows = thinned(curve)
    used = [i for i in range(len(COLUMNS)) if i < _ALWAYS or not np.isnan(rows[:, i]).all()]
    writer.writerow([COLUMNS[i] for i in used])
    for values in rows[:, used]:
        numbers = ["" if np.isnan(value) else f"{value:.5g}" for value in values[2:]]
        writer.writerow([*(int(value) for value in values[:2]), *numbers])
    return stream.getvalue()
