"""What a cell of the study starts from: its demonstrations, and the supplement's settings."""

from __future__ import annotations

import re
from typing import Any

from silem import bodies, paper
from silem.study.hyperparameters import IMITATORS, METHODS
from silem.util.errors import SilemError, choose

ORIGINAL_BODIES = {"halfcheetah": "HC0", "ant": "Ant0"}
"""Per family the body whose expert demonstrates (Section 5 of the paper)."""

HUMAN = "cmu_08_01"
"""The demonstration of every humanoid: subject 8's first clip of the CMU motion capture library."""

HUMANOID_LOG_STD = -1.6
"""Start of the policy's log standard deviation on humanoids: torques that shake with standard
deviation 1 throw the body over before it has learned to stand (open in the paper)."""

HUMANOID_TRANSFORM_RATE = 1e-3
"""Adam's rate for T on humanoids, where T makes one or two steps an iteration (also open)."""

HUMANOID_GRADIENT_PENALTY = 0.1
"""Weight of D's gradient penalty on humanoids. With 1, as on HalfCheetah, D is so smooth that
standing still earns a third of the reward, and the learner stands (page "How the open settings
were found")."""

_KNOWN_HUMANOID = "Humanoid"
_ONLY_HUMANOIDS = ("tpil", "peng20")
_ONLY_RUNNERS = ("silem-minus-own", "silem-mlp")


def check_method(method: str, body: str, family: str) -> None:
    """Refuse a method that a family of bodies has not; raises SilemError."""
    refused = _ONLY_RUNNERS if family == "humanoid" else _ONLY_HUMANOIDS
    if method in refused:
        allowed = ", ".join(name for name in METHODS if name not in refused)
        raise SilemError(f"method {method!r} is not for {body}; allowed: {allowed}")


def demonstrations(body: str, method: str, family: str, wanted: str | None) -> str:
    """Return the name of the demonstrations of one cell: those wanted, or the paper's.

    Raises:
        SilemError: The method does not learn from those wanted.
    """
    if method not in IMITATORS:
        if wanted:
            raise SilemError(f"method {method!r} uses no demonstrations")
        return ""
    if method == "silem-minus-own":
        if wanted not in (None, body):
            raise SilemError(f"silem-minus-own of {body} imitates {body}, not {wanted}")
        return body
    if family != "humanoid":
        if wanted is not None:  # a body's demonstrator, or one trial's expert: "HC0_s3"
            choose("demonstrations", re.sub(r"_s\d+$", "", wanted), bodies.names())
        return wanted or ORIGINAL_BODIES[family]
    if method == "peng20":
        chosen = wanted or retargeted(HUMAN, body)
        if not chosen.endswith(f"_on_{body}"):
            raise SilemError(f"peng20 imitates a clip retargeted to {body}, not {chosen!r}")
        return chosen
    return wanted or HUMAN


def retargeted(demonstrations: str, body: str) -> str:
    """Return the name of demonstrations retargeted to a body: "cmu_08_01_on_Atlas"."""
    return f"{demonstrations}_on_{body}"


def hyper_parameters(body: str, method: str, family: str, source: str) -> dict[str, Any]:
    """Return the values of the supplement for one cell: common settings, then the best found.

    A humanoid that the paper does not know takes Humanoid's. A humanoid's expert takes SILEM's
    number of epochs, which the humanoids' common table leaves out.
    """
    if family != "humanoid":
        return paper.best_combination(body, method, source)
    known = body if paper.best_table(body, "silem") else _KNOWN_HUMANOID
    shared = {
        "policy_hidden": tuple(paper.number("humanoid_policy_hidden")),
        "disc_hidden": tuple(paper.number("humanoid_disc_hidden")),
        "n_trajectories": 1,
        "log_std_init": HUMANOID_LOG_STD,
        "gradient_penalty": HUMANOID_GRADIENT_PENALTY,
        "transform_learning_rate": HUMANOID_TRANSFORM_RATE,
        "n_transform_updates": paper.grid_values("tab4_h")["N_G"][0],
        "transform_lr_decay": 1.0,  # of Atlas, whose grid has no decay
        "ankle_range_rad": min(paper.grid_values("tab42_h")["a"]) if body == "Atlas" else 0.0,
    }
    best = paper.best_combination(known, "silem" if method == "ppo" else method, source)
    return shared | paper.common(family) | best


def check_ankle(body: str, ankle_range_rad: float) -> None:
    """Refuse an ankle range on a body without, or none on Atlas; raises SilemError."""
    if (body == "Atlas") != (ankle_range_rad > 0):
        raise SilemError(f"ankle_range_rad {ankle_range_rad:g} on {body}: it is Atlas's alone")
