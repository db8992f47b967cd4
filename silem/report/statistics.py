"""Statistics of scores over trials, from scipy: intervals, their true coverage, and power.

A trial is one independently trained run, the unit of replication; episodes of one policy are not.
Scores of a cell have shape (N,).
"""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize, stats

from silem.util import seeding

LEVEL = 0.95
POWER = 0.8
"""Share of studies in which a difference that `detectable` names would be found."""

Interval = tuple[float, float]
NO_INTERVAL: Interval = (float("nan"), float("nan"))

N_STUDIES = 10_000
FAILURE = (0.2, 5.0)
"""A cell in which one training in five fails, as they do: how many, how many deviations lower."""


def interval(*cells: ArrayLike) -> Interval:
    """Return the 95 % t interval of a cell's mean, Student's, or of two cells' difference, Welch's.

    It is NaN where a cell, (N,), has fewer than two trials.
    """
    arrays = [np.asarray(cell, dtype=np.float64) for cell in cells]
    if min(map(len, arrays)) < 2:
        return NO_INTERVAL
    center = float(arrays[0].mean() - sum(cell.mean() for cell in arrays[1:]))
    error, freedom = _error(*arrays)
    half = float(stats.t.ppf((1 + LEVEL) / 2, freedom)) * error
    return center - half, center + half


def ratio_interval(cell: ArrayLike, unit: ArrayLike) -> Interval:
    """Return Fieller's 95 % interval of a cell's mean, (N,), in units of another's, (M,), above 0.

    Those ratios are in it of which Welch's interval of ``cell - ratio * unit`` holds 0. An end is
    infinite where no ratio is too far away: the unit's mean might be 0. NaN as `interval`.
    """
    one, other = np.asarray(cell, dtype=np.float64), np.asarray(unit, dtype=np.float64)
    if min(len(one), len(other)) < 2:
        return NO_INTERVAL
    parts = np.array([one.var(ddof=1) / len(one), other.var(ddof=1) / len(other)])
    freedoms = np.array([len(one) - 1, len(other) - 1])
    if not parts.any():
        return (ratio := float(one.mean() / other.mean())), ratio

    def beyond(angle: ArrayLike) -> Any:  # the ratio is the angle's tangent
        weights = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        shares = weights**2 * parts
        error = np.sqrt(shares.sum(axis=-1))
        with np.errstate(divide="ignore", invalid="ignore"):  # no spread at all
            freedom = np.nan_to_num(error**4 / (shares**2 / freedoms).sum(axis=-1), nan=1.0)
        quantile = stats.t.ppf((1 + LEVEL) / 2, freedom)
        return abs(weights @ [one.mean(), -other.mean()]) - quantile * error

    here, ends = np.arctan2(one.mean(), other.mean()), []
    for edge in (-np.pi / 2, np.pi / 2):
        angles = np.linspace(here, edge, 2_000)
        outside = np.flatnonzero(beyond(angles) > 0)
        end = float(np.copysign(np.inf, edge))
        if len(outside):
            end = float(np.tan(optimize.brentq(beyond, *angles[outside[0] - 1 : outside[0] + 1])))
        ends.append(end)
    return ends[0], ends[1]


def _error(*cells: np.ndarray, n_trials: int | None = None) -> tuple[float, float]:
    """Return the standard error of a mean, or of a difference of two, and its degrees of freedom.

    With `n_trials` each cell has that many, and the spread that it has.
    """
    counts = np.array([n_trials or len(cell) for cell in cells])
    shares = np.array([cell.var(ddof=1) for cell in cells]) / counts
    variance = float(shares.sum())
    # Welch and Satterthwaite; one cell has N - 1, which the formula gives as well
    freedom = variance**2 / float((shares**2 / (counts - 1)).sum()) if variance else 1.0
    return variance**0.5, freedom


def rank_correlation(x: ArrayLike, y: ArrayLike) -> tuple[float, float, float]:
    """Return Spearman's correlation of N pairs with the ends of its 95 % interval.

    The interval is Fisher's, with the variance of Bonett and Wright (2000); it takes four pairs.
    """
    rho, n = float(stats.spearmanr(x, y).statistic), len(np.asarray(x))
    half = stats.norm.ppf((1 + LEVEL) / 2) * ((1 + rho**2 / 2) / (n - 3)) ** 0.5
    low, high = np.tanh(np.arctanh(np.clip(rho, -1 + 1e-9, 1 - 1e-9)) + np.array([-half, half]))
    return rho, float(low), float(high)


def wins(first: ArrayLike, second: ArrayLike) -> float:
    """Return the share of pairs in which `first` beats `second`, half for a tie; NaN for none."""
    one, two = np.asarray(first), np.asarray(second)
    if min(len(one), len(two)) == 0:
        return float("nan")
    return float(stats.mannwhitneyu(one, two).statistic) / (len(one) * len(two))


def wins_interval(first: ArrayLike, second: ArrayLike) -> Interval:
    """Return Newcombe's 95 % score interval of how probably `first` beats `second`.

    It is method 5 of Newcombe (2006): the share is held against Hanley and McNeil's variance at
    each probability, so that it has a width however few the trials, all won or not. NaN for none.
    """
    n_first, n_second = len(np.asarray(first)), len(np.asarray(second))
    if not n_first * n_second:
        return NO_INTERVAL
    share, more = wins(first, second), (n_first + n_second) / 2 - 1
    quantile = float(stats.norm.ppf((1 + LEVEL) / 2))

    def beyond(true: float) -> float:
        spread = 1 + more * ((1 - true) / (2 - true) + true / (1 + true))
        variance = true * (1 - true) * spread / (n_first * n_second)
        return float((share - true) ** 2 - quantile**2 * variance)

    edge = 1e-9  # at 0 and 1 there is no variance
    low = optimize.brentq(beyond, 0, share - edge) if share > 0 else 0.0
    high = optimize.brentq(beyond, share + edge, 1) if share < 1 else 1.0
    return float(low), float(high)


def detectable(*cells: ArrayLike, n_trials: int) -> float:
    """Return the distance from a bound that `n_trials` a cell of the spread seen would have found.

    At that true distance the interval of a mean, or of a difference of two, lies beyond the bound
    in `POWER` of all studies (noncentral t). It is NaN where a cell has fewer than two trials.
    """
    arrays = [np.asarray(cell, dtype=np.float64) for cell in cells]
    if min(map(len, arrays)) < 2:
        return float("nan")
    error, freedom = _error(*arrays, n_trials=n_trials)
    critical = stats.t.ppf((1 + LEVEL) / 2, freedom)

    def lacking(shift: float) -> float:
        return float(stats.nct.sf(critical, freedom, shift)) - POWER

    return error * float(optimize.brentq(lacking, 0.0, 20.0 + 20.0 * critical))


@cache
def coverage(n_trials: int, kind: str = "student", *, failures: bool = False) -> float:
    """Simulate in how many studies a 95 % interval holds the true mean; the same on every call.

    `kind` is ``"student"`` (`interval`) or ``"bootstrap"``, the percentiles of the resampled mean
    that are often drawn in its place; with `failures` scores are not normal but fail by `FAILURE`.
    """
    generator = seeding.generator(0, "coverage", n_trials, kind, failures)
    scores = generator.standard_normal((N_STUDIES, n_trials))
    true = 0.0
    if failures:
        share, deviations = FAILURE
        scores -= deviations * (generator.random(scores.shape) < share)
        true = -share * deviations
    if kind == "bootstrap":
        found = stats.bootstrap(
            (scores,), np.mean, axis=-1, n_resamples=499, method="percentile", rng=generator,
            confidence_level=LEVEL, batch=50,
        )  # fmt: skip
        low, high = found.confidence_interval
    else:
        low, high = stats.t.interval(
            LEVEL, n_trials - 1, loc=scores.mean(axis=-1), scale=stats.sem(scores, axis=-1)
        )
    return float(((low <= true) & (true <= high)).mean())
