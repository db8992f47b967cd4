"""Which runs each figure is drawn from, so that what stands under it names those and no others."""

from __future__ import annotations

import pandas as pd
from matplotlib.figure import Figure

from silem.report import results, style
from silem.study.settings import BUDGETS, METHODS
from silem.util.errors import SilemError, choose

IMITATORS = ("silem", "silem-minus", "silem-minus-own")
"""The groups of Figure 2b, in the paper's order."""

COMPARED = ("silem", "silem-minus", "tpil", "peng20")
"""The methods of Figure 3b."""

# Figure -> methods, bodies (None: all). Experts belong to Figure 2b: they set its scale.
_SHOWN: dict[str, tuple[tuple[str, ...], tuple[str, ...] | None]] = {
    "normalised_scores": (("ppo", *IMITATORS), None),
    "experts": (("ppo", "random"), None),
    "affine_or_mlp": (("ppo", "random", "silem", "silem-mlp"), ("HC0",)),
    "learning_curves": (tuple(m for m in METHODS if m != "random"), None),
    "transforms": (("silem",), None),
    "humanoid_scores": (("ppo", *COMPARED), ("Atlas", "Humanoid", "HumanoidR")),
    "affine_transforms": (("silem",), ("Humanoid", "HumanoidR")),
}
# The figures that mark runs of another number of iterations; the others leave them out.
_WITH_STAND_INS = ("learning_curves", "humanoid_scores", "affine_transforms")


def runs_of(figure: str, frame: pd.DataFrame) -> pd.DataFrame:
    """Return the runs that a figure, named by its function, shows.

    Raises:
        SilemError: There is no such figure, its bodies are not the study's, or the table mixes
            budgets.
    """
    methods, names = _SHOWN[choose("figure", figure, _SHOWN)]
    study, _ = results.context(frame)
    if names and not set(names) <= (known := set(results.body_names(frame))):
        raise SilemError(
            f"{figure} shows {', '.join(names)}; the runs of study {study!r} are of"
            f" {', '.join(sorted(known))}"
        )
    shown = results.select(frame, methods, names, with_stand_ins=figure in _WITH_STAND_INS)
    shown.attrs["figure"] = figure
    return shown


def footer(figure: Figure, frame: pd.DataFrame, note: str = "", *, runs: bool = True) -> None:
    """Write under a figure which budget and how many runs it shows, and warn of toy budgets."""
    budget = results.context(frame)[1]
    shown = results.describe(frame) if runs else f"budget {budget}"
    text = "; ".join(part for part in (shown, note) if part)
    evidence = BUDGETS[budget].is_evidence
    style.footer(figure, text if evidence else f"not evidence: {text}", warn=not evidence)
