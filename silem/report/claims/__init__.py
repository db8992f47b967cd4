"""The paper's claims, study by study, each with its number, ours and a verdict by a fixed rule."""

from __future__ import annotations

from silem.report.claims import halfcheetah, humanoids
from silem.report.claims.rules import (
    FAILS,
    HOLDS,
    MARGIN,
    MIN_TRIALS,
    UNDECIDED,
    Claim,
    Find,
    Finding,
)
from silem.util.errors import choose

__all__ = [
    "CLAIMS", "FAILS", "HOLDS", "MARGIN", "MIN_TRIALS", "UNDECIDED", "Claim", "Find", "Finding",
    "of",
]  # fmt: skip

CLAIMS = {"halfcheetah": halfcheetah.claims(), "humanoids": humanoids.claims()}
"""Every claim that is judged so far, by the study whose runs judge it."""


def of(study: str) -> tuple[Claim, ...]:
    """Return the claims that a study's runs judge.

    Raises:
        SilemError: The paper makes no claim that this study's runs could judge.
    """
    return CLAIMS[choose("study with claims", study, CLAIMS)]
