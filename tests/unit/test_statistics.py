"""Statistics against values worked out by hand, and against distributions that are known."""

from __future__ import annotations

import numpy as np
import pytest

from silem.study import statistics
from silem.util.errors import SilemError

# Four trials of two cells.
SCORES = np.array([[1.0, 10.0], [2.0, 20.0], [3.0, 30.0], [6.0, 80.0]])


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_interquartile_mean_by_hand() -> None:
    # One of four is cut at either end of each column; two of eight when all are taken together.
    np.testing.assert_allclose(statistics.interquartile_mean(SCORES.T), [2.5, 25.0])
    assert statistics.interquartile_mean(SCORES.ravel()) == (3 + 6 + 10 + 20) / 4
    assert statistics.interquartile_mean([5.0, 1.0, 100.0, 2.0, 3.0]) == (2 + 3 + 5) / 3
    assert statistics.interquartile_mean([1.0, 2.0, 9.0]) == 4.0  # too few to cut any


def test_interquartile_mean_ignores_an_outlier_that_moves_the_mean() -> None:
    scores = [1.0, 1.0, 1.0, 1.0, 1000.0]
    assert statistics.interquartile_mean(scores) == 1.0
    assert statistics.mean(scores) > 200.0


def test_summary_by_hand() -> None:
    summary = statistics.summarise(SCORES[:, 0], rng())
    assert (summary.minimum, summary.mean, summary.maximum) == (1.0, 3.0, 6.0)
    assert (summary.n_trials, summary.iqm) == (4, 2.5)
    assert 1.0 <= summary.interval[0] < 2.5 < summary.interval[1] <= 6.0


def test_missing_trials_are_left_out_and_counted() -> None:
    summary = statistics.summarise([1.0, np.nan, 3.0], rng())
    assert (summary.n_trials, summary.mean) == (2, 2.0)


@pytest.mark.parametrize("scores", [[7.0], [7.0, np.nan]])
def test_one_trial_has_no_interval(scores: list[float]) -> None:
    summary = statistics.summarise(scores, rng())
    assert (summary.n_trials, summary.mean, summary.iqm) == (1, 7.0, 7.0)
    assert np.isnan(summary.interval).all()
    assert np.isnan(statistics.mean_interval(scores)).all()
    assert np.isnan(statistics.difference_interval(scores, [1.0, 2.0])).all()
    # One cell with a single trial leaves the whole matrix without an interval.
    matrix = np.array([[1.0, 5.0], [2.0, np.nan], [3.0, np.nan]])
    assert np.isnan(statistics.stratified_bootstrap_interval(matrix, rng())).all()


def test_bootstrap_of_two_trials_by_hand() -> None:
    # Resampling {0, 1} twice gives means 0, 1/2, 1 with probabilities 1/4, 1/2, 1/4.
    interval = statistics.stratified_bootstrap_interval([0.0, 1.0], rng(), level=0.4)
    assert interval == (0.5, 0.5)
    assert statistics.stratified_bootstrap_interval([0.0, 1.0], rng()) == (0.0, 1.0)


def test_strata_keep_their_trials() -> None:
    """Two cells without spread: stratified, nothing varies; pooled, the cells' share would."""
    scores = np.array([[0.0, 100.0]] * 4)
    interval = statistics.stratified_bootstrap_interval(scores, rng(), statistics.mean)
    assert interval == (50.0, 50.0)
    pooled = statistics.stratified_bootstrap_interval(scores.ravel(), rng(), statistics.mean)
    assert pooled[0] < 50.0 < pooled[1]


def test_the_generator_alone_decides_the_interval() -> None:
    scores = rng(3).normal(size=(5, 2))
    same = [statistics.stratified_bootstrap_interval(scores, rng(7)) for _ in range(2)]
    other = statistics.stratified_bootstrap_interval(scores, rng(8))
    assert same[0] == same[1] != other


def coverage(n_trials: int, kind: str, true: float = 0.0, n_studies: int = 400) -> float:
    """Share of simulated studies (normal scores of mean 0) whose interval holds `true`."""
    generator = rng(1)
    hits = 0
    for _ in range(n_studies):
        scores = generator.normal(size=n_trials)
        if kind == "student":
            low, high = statistics.mean_interval(scores)
        else:
            low, high = statistics.stratified_bootstrap_interval(
                scores, generator, statistics.mean, n_resamples=500
            )
        hits += low <= true <= high
    return hits / n_studies


def test_intervals_cover_what_they_promise() -> None:
    assert 0.92 <= coverage(5, "student") <= 0.98
    assert 0.92 <= coverage(3, "student") <= 0.98
    assert 0.91 <= coverage(30, "bootstrap") <= 0.98


def test_intervals_do_not_cover_what_is_wrong() -> None:
    assert coverage(30, "bootstrap", true=1.0) < 0.05
    assert coverage(30, "student", true=1.0) < 0.05


def test_the_bootstrap_of_five_trials_is_too_short_as_its_docstring_says() -> None:
    assert 0.78 <= coverage(5, "bootstrap") <= 0.88


def test_mean_interval_by_hand() -> None:
    # Mean 2, standard deviation 1, t(2, 97.5 %) = 4.3027: half width 4.3027 / sqrt(3).
    low, high = statistics.mean_interval([1.0, 2.0, 3.0])
    np.testing.assert_allclose([low, high], [2 - 2.48414, 2 + 2.48414], atol=1e-4)


def test_difference_interval_by_hand() -> None:
    # Equal sizes and spreads: Welch is Student with 4 degrees of freedom, t = 2.7764.
    low, high = statistics.difference_interval([11.0, 12.0, 13.0], [1.0, 2.0, 3.0])
    half = 2.77645 * (1 / 3 + 1 / 3) ** 0.5
    np.testing.assert_allclose([low, high], [10 - half, 10 + half], atol=1e-4)
    assert statistics.difference_interval([2.0, 2.0], [1.0, 1.0]) == (1.0, 1.0)


def test_probability_of_improvement_by_hand() -> None:
    # Pairs: 1 < 2, 1 < 3, 4 > 2, 4 > 3 and one tie of 3 with 3.
    assert statistics.probability_of_improvement([1.0, 4.0], [2.0, 3.0]) == 0.5
    assert statistics.probability_of_improvement([3.0, 4.0], [2.0, 3.0]) == (3 + 0.5) / 4
    assert np.isnan(statistics.probability_of_improvement([np.nan], [1.0]))


@pytest.mark.parametrize("scores", [[1.0, np.inf], np.zeros((2, 2, 2)), np.zeros((3, 0))])
def test_bad_scores_are_refused(scores: object) -> None:
    with pytest.raises(SilemError):
        statistics.stratified_bootstrap_interval(scores, rng())  # type: ignore[arg-type]


def test_a_cell_without_a_trial_has_no_summary() -> None:
    with pytest.raises(SilemError, match="without a trial"):
        statistics.summarise([np.nan], rng())
