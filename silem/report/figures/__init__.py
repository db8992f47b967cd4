"""Every figure that is drawn from runs: a table of `silem.report.results` in, a figure out."""

from __future__ import annotations

from silem.report.figures.affine import affine_transforms, transforms
from silem.report.figures.learning import compared_curves, learning_curves
from silem.report.figures.sources import OF_STUDY, runs_of
from silem.report.figures.trials import affine_or_mlp, experts, normalised_scores

__all__ = [
    "OF_STUDY",
    "affine_or_mlp",
    "affine_transforms",
    "compared_curves",
    "experts",
    "learning_curves",
    "normalised_scores",
    "runs_of",
    "transforms",
]
