"""Which runs each figure is drawn from, so that what stands under it names those and no others."""

from __future__ import annotations

import pandas as pd
from matplotlib.figure import Figure

from silem.config import METHODS
from silem.errors import choose
from silem.report import results, style

IMITATORS = ("silem", "silem-minus", "silem-minus-own")
"""The groups of Figure 2b, in the paper's order."""

# Figure -> methods, bodies (None: all). Experts belong to Figure 2b: they set its scale.
_SHOWN: dict[str, tuple[tuple[str, ...], tuple[str, ...] | None]] = {
    "normalised_scores": (("ppo", *IMITATORS), None),
    "gaits": (("ppo", *IMITATORS), None),
    "experts": (("ppo", "random"), None),
    "affine_or_mlp": (("ppo", "random", "silem", "silem-mlp"), ("HC0",)),
    "learning_curves": (tuple(m for m in METHODS if m != "random"), None),
    "transforms": (("silem",), None),
}


def runs_of(figure: str, frame: pd.DataFrame) -> pd.DataFrame:
    """Return the runs that a figure shows.

    Args:
        figure: Name of the figure's function, e.g. ``"normalised_scores"``.
        frame: Runs of one study at one budget.

    Raises:
        SilemError: There is no such figure, or the table mixes budgets.
    """
    methods, names = _SHOWN[choose("figure", figure, _SHOWN)]
    return results.select(frame, methods, names)


def footer(figure: Figure, frame: pd.DataFrame, note: str = "") -> None:
    """Write under a figure which budget and how many runs it shows, and warn of toy budgets."""
    text = "; ".join(part for part in (results.describe(frame), note) if part)
    evidence = results.is_evidence(results.context(frame)[1])
    style.footer(figure, text if evidence else f"not evidence: {text}", warn=not evidence)
