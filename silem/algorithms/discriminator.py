"""The discriminator D on windows of skeletal features, and its losses (Algorithm 1, line 9)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import torch as th
from torch import nn
from torch.nn import functional as F


class Discriminator(nn.Module):
    """A tanh MLP from a window to one logit; a high logit means "expert".

    Args:
        n_features: F, features per state.
        window: W, states per window.
        hidden: Units of the hidden layers (supplement: 3 x 128, humanoids 2 x 128).
    """

    def __init__(self, n_features: int, window: int, hidden: Sequence[int]) -> None:
        super().__init__()
        sizes = [n_features * window, *hidden]
        layers: list[nn.Module] = [nn.Flatten()]
        for n_in, n_out in itertools.pairwise(sizes):
            layers += [nn.Linear(n_in, n_out), nn.Tanh()]
        self.net = nn.Sequential(*layers, nn.Linear(sizes[-1], 1))

    def forward(self, windows: th.Tensor) -> th.Tensor:
        """Return ``disc_logits_expert_is_high`` (B,) of windows (B, W, F)."""
        return self.net(windows)[:, 0]


@dataclass(frozen=True)
class DiscriminatorLoss:
    """The discriminator's loss and what is logged beside it."""

    total: th.Tensor
    cross_entropy: float
    accuracy_expert: float
    accuracy_learner: float


def discriminator_loss(
    discriminator: nn.Module,
    expert_windows: th.Tensor,
    learner_windows: th.Tensor,
    *,
    entropy_coef: float,
    gradient_penalty: float,
    mixing: th.Tensor | None = None,
) -> DiscriminatorLoss:
    """Compute line 9's cross-entropy, the entropy bonus and the optional gradient penalty.

    Args:
        discriminator: D, returning logits that are high for the expert.
        expert_windows: (B, W, F).
        learner_windows: (B, W, F), already transformed.
        entropy_coef: Weight of the Bernoulli entropy bonus (from merel-mocap-gail).
        gradient_penalty: Weight of the squared gradient norm of the logit on random mixtures of
            expert and learner windows; 0 switches it off. Not in the paper: see "Deviations".
        mixing: Share of the expert in each mixture, (B,) in [0, 1]; needed with the penalty.
    """
    logits_expert = discriminator(expert_windows)
    logits_learner = discriminator(learner_windows)
    cross_entropy = F.softplus(-logits_expert).mean() + F.softplus(logits_learner).mean()
    total = cross_entropy
    if entropy_coef:
        logits = th.cat([logits_expert, logits_learner])
        # entropy of a Bernoulli variable with these logits
        entropy = (F.softplus(logits) - th.sigmoid(logits) * logits).mean()
        total = total - entropy_coef * entropy
    if gradient_penalty:
        assert mixing is not None
        share = mixing[:, None, None]
        mixed = share * expert_windows + (1.0 - share) * learner_windows
        total = total + gradient_penalty * squared_gradient_norm(discriminator, mixed)
    return DiscriminatorLoss(
        total,
        cross_entropy.item(),
        (logits_expert > 0).float().mean().item(),
        (logits_learner < 0).float().mean().item(),
    )


def squared_gradient_norm(discriminator: nn.Module, windows: th.Tensor) -> th.Tensor:
    """Return the mean squared norm of the logit's gradient by the windows (B, W, F)."""
    windows = windows.detach().requires_grad_(True)
    logits = discriminator(windows)
    (gradient,) = th.autograd.grad(logits.sum(), windows, create_graph=True)
    return gradient.flatten(1).square().sum(dim=1).mean()
