"""The paper's claims, each with its number, ours, an interval and a verdict by a fixed rule.

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

from silem import paper
from silem.report import results
from silem.study import statistics
from silem.study.statistics import NO_INTERVAL, Interval

MIN_TRIALS = 3
"""Trials that every cell of a claim needs for a verdict."""

MARGIN = 0.1
"""Two levels agree within this share of their scale: for returns of the paper's span from its
random policy to its expert, for discriminator rewards of the largest, for scores of 1."""

RETURN_SPAN = paper.number("expert_return") - paper.number("random_return")
DISC_SPAN = max(paper.number("disc_reward_range"))

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
    """

    ours: float
    interval: Interval
    trials: dict[str, int]
    lower: float = -np.inf
    upper: float = np.inf
    digits: int = 0

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


def _level(method: str, body: str, column: str, target: float, scale: float) -> Find:
    """Return a finder: a cell's mean is `target`, give or take `MARGIN` of `scale`."""

    def find(frame: pd.DataFrame) -> Finding:
        values = results.scores(frame, method, body, column)
        half = MARGIN * scale
        return Finding(
            _mean(values), statistics.mean_interval(values), {_name(method): len(values)},
            target - half, target + half,
        )  # fmt: skip

    return find


def _random(target: float) -> Find:
    """Return a finder of the random policy's return on HC0; its episodes are the replicates."""

    def find(frame: pd.DataFrame) -> Finding:
        rows = results.cell(frame, "random", "HC0")
        returns = np.array(rows["returns"].iloc[0]) if len(rows) else np.empty(0)
        half = MARGIN * RETURN_SPAN
        return Finding(
            _mean(returns), statistics.mean_interval(returns), {"episodes": len(returns)},
            target - half, target + half,
        )  # fmt: skip

    return find


def _score(method: str, body: str, *, reaches: bool) -> Find:
    """Return a finder: a cell's normalised score reaches, or misses, 1 - `MARGIN`.

    The interval is that of ``mean return - bound * mean expert return``, over the expert's mean:
    so it holds the spread of the experts too.
    """
    bound = paper.number("expert_level") - MARGIN

    def find(frame: pd.DataFrame) -> Finding:
        returns = results.scores(frame, method, body, "return_mean")
        experts = results.scores(frame, "ppo", body, "return_mean")
        trials = {_name(method): len(returns), _name("ppo"): len(experts)}
        lower, upper = (bound, np.inf) if reaches else (-np.inf, bound)
        level = _mean(experts)
        if not level > 0:
            return Finding(float("nan"), NO_INTERVAL, trials, lower, upper, 2)
        low, high = statistics.difference_interval(returns, bound * experts)
        interval = bound + low / level, bound + high / level
        return Finding(_mean(returns) / level, interval, trials, lower, upper, 2)

    return find


def _difference(first: str, second: str, body: str, column: str, above: float) -> Find:
    """Return a finder: the mean of `first` exceeds that of `second` by more than `above`."""

    def find(frame: pd.DataFrame) -> Finding:
        one = results.scores(frame, first, body, column)
        two = results.scores(frame, second, body, column)
        trials = {_name(first): len(one), _name(second): len(two)}
        interval = statistics.difference_interval(one, two)
        return Finding(_mean(one) - _mean(two), interval, trials, above)

    return find


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if len(values) else float("nan")


def _name(method: str) -> str:
    short = {"ppo": "expert", "silem-minus": "SILEM⁻", "silem-minus-own": "SILEM⁻ own"}
    return {"silem": "SILEM", "silem-mlp": "MLP", "random": "random", **short}[method]


def _claims() -> tuple[Claim, ...]:
    """Return the claims about HalfCheetah, in the order in which the book tells them."""
    text = "Section 5, 'Why does the sequential affine transform ...'"
    figure, table = "Figure 2b", "Table 1"
    mlp, affine = paper.table("tab1").rows
    returns = f"within ±{MARGIN * RETURN_SPAN:.0f} of the paper's"
    rewards = f"within ±{MARGIN * DISC_SPAN:.0f} of the paper's"
    reaches = f"score at least {1 - MARGIN:g}"

    def level(claim: str, where: str, method: str, column: str, printed: float) -> Claim:
        scale, rule = (DISC_SPAN, rewards) if column == "disc_reward" else (RETURN_SPAN, returns)
        return Claim(claim, where, printed, rule, _level(method, "HC0", column, printed, scale))

    random, expert = paper.number("random_return"), paper.number("expert_return")
    affine_reward, affine_return = affine["discriminator_reward"], affine["ground_truth_reward"]
    mlp_reward, mlp_return = mlp["discriminator_reward"], mlp["ground_truth_reward"]
    gap = f"exceeds by more than {MARGIN * RETURN_SPAN:.0f}"
    near = f"is not lower by {MARGIN * DISC_SPAN:.0f} or more"
    return (
        Claim("Return of a random policy on HC0", text, random, returns, _random(random)),
        level("Return of the expert on HC0", text, "ppo", "return_mean", expert),
        level("Return of SILEM on HC0", table, "silem", "return_mean", affine_return),
        level("Discriminator reward of SILEM on HC0", table, "silem", "disc_reward", affine_reward),
        level("Return with an MLP as f on HC0", table, "silem-mlp", "return_mean", mlp_return),
        level(
            "Discriminator reward with an MLP as f", table, "silem-mlp", "disc_reward", mlp_reward
        ),
        Claim(
            "The MLP fools the discriminator as well as the affine transform: difference in reward",
            table, mlp_reward - affine_reward, near,
            _difference("silem-mlp", "silem", "HC0", "disc_reward", -MARGIN * DISC_SPAN),
        ),
        Claim(
            "The affine transform leads to the better policy: difference in return",
            table, affine_return - mlp_return, gap,
            _difference("silem", "silem-mlp", "HC0", "return_mean", MARGIN * RETURN_SPAN),
        ),
        *(
            Claim(
                f"SILEM reaches expert level on {body}", figure, None, reaches,
                _score("silem", body, reaches=True),
            )
            for body in ("HC0", "HC1", "HC2")
        ),
        *(
            Claim(
                f"Without the transform imitation degrades on {body}", figure, None,
                f"score of SILEM⁻ below {1 - MARGIN:g}", _score("silem-minus", body, reaches=False),
            )
            for body in ("HC1", "HC2")
        ),
        *(
            Claim(
                f"SILEM beats SILEM⁻ on {body}: difference in return", figure, None, "exceeds 0",
                _difference("silem", "silem-minus", body, "return_mean", 0.0),
            )
            for body in ("HC1", "HC2")
        ),
        *(
            Claim(
                f"SILEM⁻ reaches expert level on {body} from the body's own expert", figure, None,
                reaches, _score("silem-minus-own", body, reaches=True),
            )
            for body in ("HC0", "HC1", "HC2")
        ),
    )  # fmt: skip


CLAIMS = _claims()
"""Every claim that is judged so far."""
