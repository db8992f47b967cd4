"""Gradient reversal (Ganin and Lempitsky, 2015)."""

from __future__ import annotations

from typing import Any

import torch as th


class _ReverseGradient(th.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: th.Tensor, coef: float) -> th.Tensor:
        ctx.coef = coef
        return x.view_as(x)

    @staticmethod
    def backward(ctx: Any, *gradients: th.Tensor) -> tuple[th.Tensor, None]:
        (gradient,) = gradients
        return -ctx.coef * gradient, None


def reverse_gradient(x: th.Tensor, coef: float) -> th.Tensor:
    """Return ``x`` unchanged; its gradient comes back times ``-coef``.

    What lies behind it minimises its loss, and what lies before it maximises the same loss.

    Args:
        x: Any tensor.
        coef: C_g, at least 0; 0 lets no gradient through.
    """
    return _ReverseGradient.apply(x, coef)  # type: ignore[no-untyped-call]
