"""The sequential transform T: one function f applied to every state of a window (Section III)."""

from __future__ import annotations

from typing import Literal

import torch as th
from torch import nn

from silem.errors import choose

TransformName = Literal["affine", "identity", "mlp"]
TRANSFORMS: tuple[TransformName, ...] = ("affine", "identity", "mlp")
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
