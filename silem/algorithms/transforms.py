"""The sequential transform T: one function f applied to every state of a window (Section III)."""

from __future__ import annotations

from typing import Literal

import torch as th
from torch import nn

from silem.util.errors import choose

TransformName = Literal["affine", "identity", "mlp"]
TRANSFORMS: tuple[TransformName, ...] = ("affine", "identity", "mlp")
L2_FORMS = ("deviation", "plain")
MLP_HIDDEN_UNITS = 100  # Table 1: "1 hidden layer with 100 units"


class AffineTransform(nn.Module):
    """f(g(s)) = A g(s) + b with diagonal A; starts as the identity.

    Args:
        n_features: F, the number of skeletal features of a state.
    """

    def __init__(self, n_features: int) -> None:
        super().__init__()
        self.scale = nn.Parameter(th.ones(n_features))
        self.offset = nn.Parameter(th.zeros(n_features))

    def forward(self, features: th.Tensor) -> th.Tensor:
        """Transform features (..., F) state by state."""
        return features * self.scale + self.offset


class MLPTransform(nn.Sequential):
    """Table 1's ablation: f is a tanh MLP with one hidden layer of 100 units."""

    def __init__(self, n_features: int) -> None:
        super().__init__(
            nn.Linear(n_features, MLP_HIDDEN_UNITS),
            nn.Tanh(),
            nn.Linear(MLP_HIDDEN_UNITS, n_features),
        )


def l2_penalty(
    transform: AffineTransform, scale_coef: float, offset_coef: float, form: str = "deviation"
) -> th.Tensor:
    """Return the supplement's L2 term on the affine transform, ``w_d |A|^2 + w_b |b|^2``.

    The supplement names the two coefficients and not the form. "deviation" measures A from one:
    the identity, which says that the two bodies are alike, is what a transform should fall back
    to where the discriminator asks for nothing. The "plain" norm pulls A to 0, hence every
    feature to a constant that tells nothing of the learner. Both are means over the features, so
    that a coefficient weighs the same beside the loss of line 10 whatever F is.

    Args:
        transform: The affine transform.
        scale_coef: w_d, weight of A's term.
        offset_coef: w_b, weight of b's term.
        form: "deviation" or "plain".
    """
    rest = 1.0 if form == "deviation" else 0.0
    scale_term = (transform.scale - rest).square().mean()
    return scale_coef * scale_term + offset_coef * transform.offset.square().mean()


def make_transform(name: str, n_features: int) -> nn.Module:
    """Build f by name.

    Args:
        name: "affine" (SILEM), "identity" (SILEM-minus) or "mlp" (Table 1).
        n_features: F, the number of skeletal features of a state.

    Returns:
        A module that maps features (..., F) to features of the same shape.

    Raises:
        SilemError: If the name is unknown.
    """
    choose("transform", name, TRANSFORMS)
    if name == "affine":
        return AffineTransform(n_features)
    return MLPTransform(n_features) if name == "mlp" else nn.Identity()
