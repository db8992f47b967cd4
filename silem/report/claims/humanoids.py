"""The paper's claims about the humanoids: Figures 3b, 4a and 4b."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from silem import paper
from silem.bodies.humanoid import DEMONSTRATOR_SPEED_M_S
from silem.motion.features import FEATURES
from silem.report import results
from silem.report.claims.rules import MARGIN, Claim, Find, Finding, exceeds, mean, name, within
from silem.study import statistics

_BODIES = ("Atlas", "Humanoid", "HumanoidR")
_NAMES = [feature.name for feature in FEATURES]


def claims() -> tuple[Claim, ...]:
    """Return the claims about the humanoids, in the order in which the book tells them."""
    return (*_gaits(), *_comparisons(), *_atlas(), *_transforms())


def _gaits() -> list[Claim]:
    """SILEM walks, and SILEM⁻ does not. Standing still survives too: hence the speed."""
    text = "Section 5, 'Can the sequential affine transform ...'"
    survives, speed = 1 - MARGIN, (1 - MARGIN) * DEMONSTRATOR_SPEED_M_S
    stable, walks, falls = [], [], []
    for body in _BODIES:
        stable.append(
            Claim(
                f"SILEM's gait is stable on {body}: share of steps survived", text, None,
                f"at least {survives:g}", within("silem", body, "upright", survives, digits=2),
            )
        )  # fmt: skip
        walks.append(
            Claim(
                f"SILEM matches the human's speed on {body} (m/s)", "Figure 3, caption", None,
                f"at least {speed:g}", within("silem", body, "speed_m_s", speed, digits=2),
            )
        )  # fmt: skip
        falls.append(
            Claim(
                f"SILEM⁻ finds no stable gait on {body}: share of steps survived", text, None,
                f"below {survives:g}",
                within("silem-minus", body, "upright", -np.inf, survives, digits=2),
            )
        )  # fmt: skip
    return [*stable, *walks, *falls]


def _comparisons() -> list[Claim]:
    """SILEM above its ablation, and above the rivals by a large margin."""
    gap = MARGIN * paper.number("humanoid_max_return")
    bounds = {"silem-minus": (0.0, "exceeds 0")}
    bounds |= dict.fromkeys(("tpil", "peng20"), (gap, f"exceeds by more than {gap:.0f}"))
    return [
        Claim(
            f"SILEM {'beats' if bound == 0 else 'far outperforms'} {name(rival)} on {body}:"
            " difference in return",
            "Figure 3b", None, rule, exceeds(("silem", body), (rival, body), "return_mean", bound),
        )
        for rival, (bound, rule) in bounds.items()
        for body in _BODIES
    ]  # fmt: skip


def _atlas() -> list[Claim]:
    """The others do much better on Atlas, whose dimensions are closest to the demonstrator's."""
    text = "Section 5, 'Comparison with TPIL and Peng20'"
    gap = MARGIN * paper.number("humanoid_max_return")
    return [
        Claim(
            f"{name(method)} does much better on Atlas than on {body}: difference in return", text,
            None, f"exceeds by more than {gap:.0f}",
            exceeds((method, "Atlas"), (method, body), "return_mean", gap),
        )
        for method in ("peng20", "tpil", "silem-minus")
        for body in ("Humanoid", "HumanoidR")
    ]  # fmt: skip


def _transforms() -> list[Claim]:
    """The transform makes up for HumanoidR's short left and long right arm.

    T acts on the learner's features: a left elbow that stays straighter than the demonstrator's is
    brought back to it by a lower offset. (Angles grow as an arm straightens.)
    """
    return [
        Claim(
            "The short left arm's hand position is scaled up on HumanoidR: A of x, y, z",
            "Figure 4a", None, "mean above 1", _transform("A", ("left_hand",), lower=1.0),
        ),
        Claim(
            "The long right arm's hand position is scaled down on HumanoidR: A of x, y, z",
            "Figure 4a", None, "mean below 1", _transform("A", ("right_hand",), upper=1.0),
        ),
        Claim(
            "The left arm of HumanoidR keeps the more obtuse angle: b of its elbow less the"
            " right one's (rad)",
            "Figure 4b", None, "below 0", _transform("b", ("left_elbow", "right_elbow"), upper=0.0),
        ),
    ]  # fmt: skip


def _transform(
    key: str, parts: Sequence[str], lower: float = -np.inf, upper: float = np.inf
) -> Find:
    """Return a finder of HumanoidR's transforms: a part's mean entry, or a difference of two's."""
    columns = [[i for i, name in enumerate(_NAMES) if name.startswith(part)] for part in parts]

    def find(frame: pd.DataFrame) -> Finding:
        run_ids = results.cell(frame, "silem", "HumanoidR")["run_id"]
        entries = [results.load_transform(run_id)[key] for run_id in run_ids]
        means = [np.array([values[rows].mean() for values in entries]) for rows in columns]
        values = means[0] - means[1] if len(parts) == 2 else means[0]
        interval, trials = statistics.mean_interval(values), {name("silem"): len(values)}
        return Finding(mean(values), interval, trials, lower, upper, 2)

    return find
