"""Statistics of scores over trials: what the paper plots, and intervals beyond it.

A score matrix has shape (N, C): N trials of C cells, NaN where a trial is missing. A trial is one
independently trained run, the unit of replication; episodes of one policy are not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from silem.util.errors import SilemError

LEVEL = 0.95
N_RESAMPLES = 10_000

Statistic = Callable[[np.ndarray], np.ndarray]
Interval = tuple[float, float]
NO_INTERVAL: Interval = (float("nan"), float("nan"))


@dataclass(frozen=True)
class Summary:
    """One cell's scores in numbers; the interval is NaN with fewer than two trials.

    Attributes:
        n_trials: Finite scores of the cell.
        minimum: Lowest score (paper, Figure 2b).
        mean: Mean score (paper, Figure 2b).
        maximum: Highest score (paper, Figure 2b).
        iqm: Interquartile mean.
        interval: Bootstrap interval of the interquartile mean.
    """

    n_trials: int
    minimum: float
    mean: float
    maximum: float
    iqm: float
    interval: Interval


def interquartile_mean(scores: ArrayLike) -> np.ndarray:
    """Average the middle half of the scores along the last axis.

    As Agarwal et al. (2021): ``floor(N / 4)`` scores are cut at either end, so of five trials the
    middle three remain and of fewer than four all do.

    Args:
        scores: Shape (..., N).

    Returns:
        Shape (...).
    """
    ordered = np.sort(np.asarray(scores, dtype=np.float64), axis=-1)
    cut = ordered.shape[-1] // 4
    return np.asarray(ordered[..., cut : ordered.shape[-1] - cut].mean(axis=-1))


def mean(scores: ArrayLike) -> np.ndarray:
    """Average the scores along the last axis: shape (..., N) to (...)."""
    return np.asarray(np.asarray(scores, dtype=np.float64).mean(axis=-1))


def stratified_bootstrap_interval(
    scores: ArrayLike,
    generator: np.random.Generator,
    statistic: Statistic = interquartile_mean,
    n_resamples: int = N_RESAMPLES,
    level: float = LEVEL,
) -> Interval:
    """Return the percentile bootstrap interval of a statistic over all cells together.

    Each cell's trials are resampled among themselves (Agarwal et al., 2021), so no cell gains or
    loses weight. With five trials such an interval is too short (it holds the true value in about
    83 % of cases, not 95 %, for normal scores): judge claims by `mean_interval`.

    Args:
        scores: Shape (N, C) or (N,), NaN where a trial is missing.
        generator: Source of the resampling.
        statistic: Maps shape (R, N * C) to (R,).
        n_resamples: Number of resamples, R.
        level: Share of resampled statistics inside the interval.

    Returns:
        Lower and upper end; NaN where a cell has fewer than two trials.

    Raises:
        SilemError: If a score is infinite or the matrix has no cell.
    """
    cells = _cells(scores)
    if min(len(cell) for cell in cells) < 2:
        return NO_INTERVAL
    resampled = np.concatenate([_resample(cell, generator, n_resamples) for cell in cells], axis=1)
    return _percentiles(statistic(resampled), level)


def summarise(scores: ArrayLike, generator: np.random.Generator) -> Summary:
    """Summarise the scores of one cell, shape (N,); NaN marks a missing trial.

    Raises:
        SilemError: If there is no finite score.
    """
    (cell,) = _cells(np.asarray(scores, dtype=np.float64).reshape(-1, 1))
    if len(cell) == 0:
        raise SilemError("cannot summarise a cell without a trial")
    return Summary(
        n_trials=len(cell),
        minimum=float(cell.min()),
        mean=float(cell.mean()),
        maximum=float(cell.max()),
        iqm=float(interquartile_mean(cell)),
        interval=stratified_bootstrap_interval(cell, generator),
    )


def mean_interval(scores: ArrayLike, level: float = LEVEL) -> Interval:
    """Return Student's t interval of the mean of one cell's scores, shape (N,).

    With so few trials it is wide, as it should be; NaN with fewer than two.
    """
    (cell,) = _cells(scores)
    if len(cell) < 2:
        return NO_INTERVAL
    half = float(stats.t.ppf((1 + level) / 2, len(cell) - 1)) * _standard_error(cell)
    return float(cell.mean()) - half, float(cell.mean()) + half


def difference_interval(first: ArrayLike, second: ArrayLike, level: float = LEVEL) -> Interval:
    """Return Welch's t interval of ``mean(first) - mean(second)`` for two cells of trials.

    Args:
        first: Shape (N,).
        second: Shape (M,).
        level: Confidence level.

    Returns:
        Lower and upper end; NaN where a cell has fewer than two trials.
    """
    (one,), (two,) = _cells(first), _cells(second)
    if min(len(one), len(two)) < 2:
        return NO_INTERVAL
    difference = float(one.mean() - two.mean())
    errors = np.array([_standard_error(one), _standard_error(two)])
    variance = float((errors**2).sum())
    if variance == 0.0:
        return difference, difference
    freedom = variance**2 / float((errors**4 / [len(one) - 1, len(two) - 1]).sum())
    half = float(stats.t.ppf((1 + level) / 2, freedom)) * variance**0.5
    return difference - half, difference + half


def probability_of_improvement(first: ArrayLike, second: ArrayLike) -> float:
    """Return the share of pairs in which `first` beats `second`; a tie counts one half.

    Args:
        first: Scores of one method, shape (N,).
        second: Scores of another on the same body, shape (M,).
    """
    (one,), (two,) = _cells(first), _cells(second)
    if min(len(one), len(two)) == 0:
        return float("nan")
    sign = np.sign(one[:, None] - two[None, :])
    return float(((sign + 1) / 2).mean())


def _cells(scores: ArrayLike) -> list[np.ndarray]:
    """Split a score matrix into its cells' finite scores."""
    matrix = np.asarray(scores, dtype=np.float64)
    matrix = matrix[:, None] if matrix.ndim == 1 else matrix
    if matrix.ndim != 2 or matrix.shape[1] == 0:
        raise SilemError(f"scores must have shape (N,) or (N, C), not {np.shape(scores)}")
    if np.isinf(matrix).any():
        raise SilemError("scores must be finite (NaN marks a missing trial)")
    return [column[~np.isnan(column)] for column in matrix.T]


def _resample(cell: np.ndarray, generator: np.random.Generator, n_resamples: int) -> np.ndarray:
    """Draw shape (R, N) from the N scores of one cell, with replacement."""
    return cell[generator.integers(len(cell), size=(n_resamples, len(cell)))]


def _percentiles(values: np.ndarray, level: float) -> Interval:
    low, high = np.quantile(values, [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)


def _standard_error(cell: np.ndarray) -> float:
    return float(cell.std(ddof=1) / len(cell) ** 0.5)
