"""Statistics against values worked out by hand, and against distributions that are known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from silem.report import statistics


def test_mean_interval_by_hand() -> None:
    # Mean 2, standard deviation 1, t(2, 97.5 %) = 4.3027: half width 4.3027 / sqrt(3).
    low, high = statistics.interval([1.0, 2.0, 3.0])
    np.testing.assert_allclose([low, high], [2 - 2.48414, 2 + 2.48414], atol=1e-4)


def test_difference_interval_by_hand() -> None:
    # Equal sizes and spreads: Welch is Student with 4 degrees of freedom, t = 2.7764.
    low, high = statistics.interval([11.0, 12.0, 13.0], [1.0, 2.0, 3.0])
    half = 2.77645 * (1 / 3 + 1 / 3) ** 0.5
    np.testing.assert_allclose([low, high], [10 - half, 10 + half], atol=1e-4)
    assert statistics.interval([2.0, 2.0], [1.0, 1.0]) == (1.0, 1.0)


def test_intervals_are_scipys(rng: np.random.Generator) -> None:
    one, two = rng.normal(size=5), rng.normal(2, 3, size=4)
    welch = stats.ttest_ind(one, two, equal_var=False).confidence_interval()
    np.testing.assert_allclose(statistics.interval(one, two), welch)
    np.testing.assert_allclose(
        statistics.interval(one), stats.ttest_1samp(one, 0).confidence_interval()
    )


def test_a_ratios_interval_is_fiellers(rng: np.random.Generator) -> None:
    """By his own formula where both spreads are known well, and by its coverage where not."""
    many, unit = rng.normal(6, 1, 4000), rng.normal(4, 1, 4000)
    (a, b), (va, vb) = (many.mean(), unit.mean()), (many.var() / 4000, unit.var() / 4000)
    c = 1.95996**2
    roots = np.roots([b**2 - c * vb, -2 * a * b, a**2 - c * va])
    np.testing.assert_allclose(statistics.ratio_interval(many, unit), sorted(roots), rtol=1e-4)
    held = 0
    for _ in range(400):
        low, high = statistics.ratio_interval(rng.normal(1.5, 0.1, 5), rng.normal(1, 0.3, 5))
        held += low <= 1.5 <= high
    assert 0.93 < held / 400 < 0.985
    # a ratio is in it just where Welch's interval of the difference holds 0
    one, other = rng.normal(3, 1, 5), rng.normal(2, 0.5, 4)
    for end in statistics.ratio_interval(one, other):
        assert min(np.abs(statistics.interval(one, end * other))) == pytest.approx(0, abs=1e-6)


def test_a_ratio_to_what_may_be_nothing_has_no_end() -> None:
    low, high = statistics.ratio_interval([9.0, 10.0, 11.0], [0.1, 1.0, 2.0])
    assert 0 < low < 10 and high == np.inf
    assert statistics.ratio_interval([2.0, 2.0], [1.0, 1.0]) == pytest.approx((2.0, 2.0))
    assert np.isnan(statistics.ratio_interval([2.0], [1.0, 1.0])).all()


def test_one_trial_has_neither_interval_nor_power() -> None:
    assert np.isnan(statistics.interval([7.0])).all()
    assert np.isnan(statistics.interval([])).all()
    assert np.isnan(statistics.interval([7.0], [1.0, 2.0])).all()
    assert np.isnan(statistics.detectable([7.0], [1.0, 2.0], n_trials=5))


def test_rank_correlation_by_hand_and_by_its_coverage(rng: np.random.Generator) -> None:
    # Ranks 1 2 3 4 5 against 2 1 4 3 5: 1 - 6 * 4 / (5 * 24) = 0.8
    found = statistics.rank_correlation([1, 2, 3, 4, 5], [20, 10, 40, 30, 50])
    half = 1.95996 * ((1 + 0.32) / 2) ** 0.5
    ends = np.tanh([np.arctanh(0.8) - half, np.arctanh(0.8) + half])
    np.testing.assert_allclose(found, [0.8, *ends], atol=1e-5)
    assert statistics.rank_correlation([1, 2, 3, 4], [1, 8, 27, 64])[1:] == pytest.approx((1, 1))
    true, within = 6 / np.pi * np.arcsin(0.6 / 2), 0
    for _ in range(1000):
        x = rng.normal(size=35)
        y = 0.6 * x + 0.8 * rng.normal(size=35)
        _, low, high = statistics.rank_correlation(x, y)
        within += low <= true <= high
    assert 0.92 < within / 1000 < 0.98


def test_wins_by_hand() -> None:
    # Pairs: 1 < 2, 1 < 3, 4 > 2, 4 > 3; then one tie of 3 with 3.
    assert statistics.wins([1.0, 4.0], [2.0, 3.0]) == 0.5
    assert statistics.wins([3.0, 4.0], [2.0, 3.0]) == (3 + 0.5) / 4
    assert np.isnan(statistics.wins([], [1.0]))


def test_interval_of_wins_by_hand_and_in_simulated_studies(rng: np.random.Generator) -> None:
    # One pair, won: (1 - p)^2 = z^2 p (1 - p), so p = 1 / (1 + z^2).
    z = stats.norm.ppf(0.975)
    np.testing.assert_allclose(statistics.wins_interval([2.0], [1.0]), [1 / (1 + z**2), 1.0])
    np.testing.assert_allclose(statistics.wins_interval([1.0], [2.0]), [0.0, z**2 / (1 + z**2)])
    low, high = statistics.wins_interval([1.0, 2.0], [1.0, 2.0])
    assert low == pytest.approx(1 - high) and 0 < low < 0.5
    assert np.isnan(statistics.wins_interval([], [1.0])).all()
    for count in (3, 5):
        held = 0
        for scores in rng.normal(size=(200, 2, count)):
            low, high = statistics.wins_interval(scores[0] + 1, scores[1])
            held += low <= stats.norm.cdf(0.5**0.5) <= high
        assert 0.9 <= held / 200 <= 0.995
    # five against five, all won, decide; three against three hardly
    assert statistics.wins_interval(range(5, 10), range(5))[0] > 0.6
    assert statistics.wins_interval(range(3, 6), range(3))[0] < 0.51


@pytest.mark.parametrize("two", [False, True])
def test_what_is_detectable_is_found_in_four_of_five_studies(
    two: bool, rng: np.random.Generator
) -> None:
    seen = np.array([-1.0, 0.0, 1.0])  # standard deviation 1
    distance = statistics.detectable(*[seen] * (1 + two), n_trials=5)
    found = {0.0: 0, distance: 0}
    for true in found:
        for _ in range(2000):
            scores, other = rng.normal(true, 1, size=5), rng.normal(0, 1, size=5)
            if two:
                low, _ = statistics.interval(scores, other)
            else:
                low, _ = statistics.interval(scores)
            found[true] += low > 0
    assert 0.77 <= found[distance] / 2000 <= 0.83
    assert found[0.0] / 2000 < 0.05  # nothing there is rarely found
    fewer = statistics.detectable(*[seen] * (1 + two), n_trials=3)
    assert fewer > distance  # fewer trials find less
    assert statistics.detectable(10 * seen, n_trials=5) == pytest.approx(
        10 * statistics.detectable(seen, n_trials=5)
    )


def test_students_interval_covers_what_it_promises_for_normal_scores_only() -> None:
    for n_trials in (2, 3, 5, 30):
        assert statistics.coverage(n_trials) == pytest.approx(0.95, abs=0.01)
    assert statistics.coverage(5, failures=True) < 0.9


def test_the_bootstrap_of_few_trials_is_too_short() -> None:
    # Of two trials the resampled means reach from the lower to the higher: half of all studies.
    assert statistics.coverage(2, "bootstrap") == pytest.approx(0.5, abs=0.02)
    few = [statistics.coverage(n, "bootstrap") for n in (2, 3, 5)]
    assert few == sorted(few) and few[-1] < 0.87
    assert statistics.coverage(30, "bootstrap") > 0.92


def test_coverage_is_the_same_on_every_call() -> None:
    first = statistics.coverage(3, failures=True)
    statistics.coverage.cache_clear()
    assert statistics.coverage(3, failures=True) == first
