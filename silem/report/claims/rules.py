"""What a claim is, and the fixed rule that gives it a verdict.

Every rule compares one quantity with a bound. Its interval is a 95 % t interval over trials
(Student's for one cell, Welch's for two), because a bootstrap of five trials is too short. The
verdict is "holds" where the whole interval lies on the claim's side, "does not hold" where all of
it lies on the other side, and "undecided" where it spans the bound, where a cell has fewer than
`MIN_TRIALS` trials, or where the budget's runs are no evidence.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from silem.report import results
from silem.study import statistics
from silem.study.statistics import Interval

MIN_TRIALS = 3
"""Trials that every cell of a claim needs for a verdict."""

MARGIN = 0.1
"""Two levels agree within this share of their scale: for returns of the paper's span from its
random policy to its expert (humanoids: of the highest possible return), for discriminator rewards
of the largest, for scores and shares of 1, for speeds of the demonstrator's."""

HOLDS, FAILS, UNDECIDED = "holds", "does not hold", "undecided"


@dataclass(frozen=True)
class Finding:
    """What our runs say about a claim.

    Attributes:
        ours: Our value, NaN where no run tells.
        interval: Its 95 % interval.
        trials: Trials of each cell that it rests on, by the cell's name.
        lower: The claim holds above this,
        upper: and below this.
        digits: Digits after the point when written.
        wins: Where two cells are compared, the share of pairs of their trials in which the first
            is higher; else NaN.
    """

    ours: float
    interval: Interval
    trials: dict[str, int]
    lower: float = -np.inf
    upper: float = np.inf
    digits: int = 0
    wins: float = float("nan")

    @property
    def verdict(self) -> tuple[str, str]:
        """The verdict by the module's rule, and why it is undecided if it is."""
        if any(count < MIN_TRIALS for count in self.trials.values()):
            return UNDECIDED, f"fewer than {MIN_TRIALS} trials"
        low, high = self.interval
        if not np.isfinite([self.ours, low, high]).all():
            return UNDECIDED, "no score: the expert's return is not positive"
        if self.lower <= low and high <= self.upper:
            return HOLDS, ""
        if high < self.lower or self.upper < low:
            return FAILS, ""
        return UNDECIDED, "the interval spans the bound"


Find = Callable[[pd.DataFrame], Finding]
"""Reads our value off a table of `silem.report.results`."""


@dataclass(frozen=True)
class Claim:
    """One claim of the paper.

    Attributes:
        text: The claim.
        where: Where the paper makes it.
        printed: The paper's number, None where it only shows a figure.
        rule: What "holds" means, in words.
        find: Reads our value off the runs.
    """

    text: str
    where: str
    printed: float | None
    rule: str
    find: Find


_NAMES = {
    "silem": "SILEM", "silem-minus": "SILEM⁻", "silem-minus-own": "SILEM⁻ own",
    "silem-mlp": "MLP", "tpil": "TPIL", "peng20": "Peng20", "ppo": "expert", "random": "random",
}  # fmt: skip


def name(method: str) -> str:
    """Return a method's name as the scorecard's column of trials has it."""
    return _NAMES[method]


def mean(values: np.ndarray) -> float:
    """Average the values of a cell's trials (N,); NaN where there is none."""
    return float(values.mean()) if len(values) else float("nan")


def within(
    method: str, body: str, column: str, lower: float, upper: float = np.inf, digits: int = 0
) -> Find:
    """Return a finder: a cell's mean lies between two bounds."""

    def find(frame: pd.DataFrame) -> Finding:
        values = results.scores(frame, method, body, column)
        interval, trials = statistics.mean_interval(values), {name(method): len(values)}
        return Finding(mean(values), interval, trials, lower, upper, digits)

    return find


def exceeds(
    first: tuple[str, str], second: tuple[str, str], column: str, above: float = 0.0
) -> Find:
    """Return a finder: one cell's mean exceeds another's by more than `above`.

    Args:
        first: Method and body of the one.
        second: Method and body of the other.
        column: The column of the table to compare.
        above: The bound on the difference.
    """

    def find(frame: pd.DataFrame) -> Finding:
        one, two = (results.scores(frame, *cell, column) for cell in (first, second))
        labels = [name(method) for method, _ in (first, second)]
        if first[1] != second[1]:
            labels = [
                f"{label} {body}" for label, (_, body) in zip(labels, (first, second), strict=True)
            ]
        interval = statistics.difference_interval(one, two)
        trials = {labels[0]: len(one), labels[1]: len(two)}
        wins = statistics.probability_of_improvement(one, two)
        return Finding(mean(one) - mean(two), interval, trials, above, wins=wins)

    return find
