"""The paper's claims about the HalfCheetahs: Figure 2b, Table 1 and the numbers around it."""

from __future__ import annotations

import numpy as np
import pandas as pd

from silem import paper
from silem.report import results
from silem.report.claims.rules import MARGIN, Claim, Find, Finding, exceeds, mean, name, within
from silem.study import statistics
from silem.study.statistics import NO_INTERVAL

RETURN_SPAN = paper.number("expert_return") - paper.number("random_return")
DISC_SPAN = max(paper.number("disc_reward_range"))


def _random(target: float) -> Find:
    """Return a finder of the random policy's return on HC0; its episodes are the replicates."""

    def find(frame: pd.DataFrame) -> Finding:
        rows = results.cell(frame, "random", "HC0")
        returns = np.array(rows["returns"].iloc[0]) if len(rows) else np.empty(0)
        half = MARGIN * RETURN_SPAN
        return Finding(
            mean(returns), statistics.mean_interval(returns), {"episodes": len(returns)},
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
        trials = {name(method): len(returns), name("ppo"): len(experts)}
        lower, upper = (bound, np.inf) if reaches else (-np.inf, bound)
        level = mean(experts)
        if not level > 0:
            return Finding(float("nan"), NO_INTERVAL, trials, lower, upper, 2)
        low, high = statistics.difference_interval(returns, bound * experts)
        interval = bound + low / level, bound + high / level
        return Finding(mean(returns) / level, interval, trials, lower, upper, 2)

    return find


def claims() -> tuple[Claim, ...]:
    """Return the claims about HalfCheetah, in the order in which the book tells them."""
    text = "Section 5, 'Why does the sequential affine transform ...'"
    figure, table = "Figure 2b", "Table 1"
    mlp, affine = paper.table("tab1").rows
    returns = f"within ±{MARGIN * RETURN_SPAN:.0f} of the paper's"
    rewards = f"within ±{MARGIN * DISC_SPAN:.0f} of the paper's"
    reaches = f"score at least {1 - MARGIN:g}"

    def level(claim: str, where: str, method: str, column: str, printed: float) -> Claim:
        scale, rule = (DISC_SPAN, rewards) if column == "disc_reward" else (RETURN_SPAN, returns)
        half = MARGIN * scale
        find = within(method, "HC0", column, printed - half, printed + half)
        return Claim(claim, where, printed, rule, find)

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
            exceeds(("silem-mlp", "HC0"), ("silem", "HC0"), "disc_reward", -MARGIN * DISC_SPAN),
        ),
        Claim(
            "The affine transform leads to the better policy: difference in return",
            table, affine_return - mlp_return, gap,
            exceeds(("silem", "HC0"), ("silem-mlp", "HC0"), "return_mean", MARGIN * RETURN_SPAN),
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
                exceeds(("silem", body), ("silem-minus", body), "return_mean"),
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
