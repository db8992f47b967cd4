"""TPIL, third-person imitation learning (Stadie et al., 2017), as the paper compares with it."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch as th
from torch import nn
from torch.nn import functional as F

from silem.algorithms.gaifo import AdversarialImitation
from silem.algorithms.gradient_reversal import reverse_gradient
from silem.motion.demonstrations import Demonstrations
from silem.util.errors import SilemError


class ThirdPersonDiscriminator(nn.Module):
    """Two discriminators on one encoder of single states; a high logit means "expert".

    The window head judges the encodings of a window's W states and gives the reward. The domain
    head tells expert from learner by a single state's encoding; through gradient reversal the
    encoder learns to make that impossible, so as to forget what the body alone betrays.

    Args:
        n_features: F, features per state.
        window: W, states per window.
        hidden: Units of the hidden layers: the first is the encoder, the others are each head's.
            (128, 128) has the depth and widths of SILEM's discriminator for humanoids.
        reversal_coef: C_g of the gradient reversal.

    Raises:
        SilemError: If there is no hidden layer or C_g is negative.
    """

    def __init__(
        self, n_features: int, window: int, hidden: Sequence[int], reversal_coef: float
    ) -> None:
        super().__init__()
        if not hidden:
            raise SilemError("disc_hidden needs one layer at least: the first encodes a state")
        if not reversal_coef >= 0:
            raise SilemError(f"gradient_reversal_coef must be 0 or more, not {reversal_coef!r}")
        self.reversal_coef = reversal_coef
        self.encoder = nn.Sequential(nn.Linear(n_features, hidden[0]), nn.Tanh())
        self.window_head = _head(window * hidden[0], hidden[1:])
        self.domain_head = _head(hidden[0], hidden[1:])

    def forward(self, windows: th.Tensor) -> th.Tensor:
        """Return ``disc_logits_expert_is_high`` (B,) of windows (B, W, F)."""
        return self.window_head(self.encoder(windows).flatten(1))[:, 0]

    def domain_logits(self, states: th.Tensor) -> th.Tensor:
        """Return ``domain_logits_expert_is_high`` (B,) of states (B, F); reverses gradients."""
        return self.domain_head(reverse_gradient(self.encoder(states), self.reversal_coef))[:, 0]


def _head(n_inputs: int, hidden: Sequence[int]) -> nn.Sequential:
    layers: list[nn.Module] = []
    for n_in, n_out in itertools.pairwise([n_inputs, *hidden]):
        layers += [nn.Linear(n_in, n_out), nn.Tanh()]
    return nn.Sequential(*layers, nn.Linear([n_inputs, *hidden][-1], 1))


class TPIL(AdversarialImitation):
    """Third-person imitation learning on windows of skeletal features.

    Where :class:`SILEM` transforms the learner's features, TPIL has the discriminator encode
    states so that a single one does not tell the bodies apart (:class:`ThirdPersonDiscriminator`).
    The original works on images and two time steps; the paper gives it SILEM's windows.

    Args:
        policy: As in stable-baselines3 ("MlpPolicy").
        env: As in :class:`AdversarialImitation`.
        demonstrations: The expert's :class:`Demonstrations`, or a list of (T + 1, F) arrays.
        gradient_reversal_coef: C_g, weight of the reversed gradient in the encoder; 0 trains the
            encoder for the window discriminator alone.
        **kwargs: Everything :class:`AdversarialImitation` takes: ``window``, ``n_disc_updates``,
            ``disc_learning_rate``, ``disc_hidden``, ``disc_entropy_coef``,
            ``gradient_penalty``, and everything :class:`PPO` takes.

    Raises:
        SilemError: On unusable demonstrations, demonstrations of another feature width than the
            learner's, a negative C_g or an empty ``disc_hidden``.
    """

    discriminator: ThirdPersonDiscriminator

    def __init__(
        self,
        policy: Any,
        env: Any,
        demonstrations: Demonstrations | Sequence[np.ndarray] | None = None,
        *,
        gradient_reversal_coef: float = 1.0,
        **kwargs: Any,
    ) -> None:
        self.gradient_reversal_coef = gradient_reversal_coef
        super().__init__(policy, env, demonstrations, **kwargs)

    def _make_discriminator(self, n_features: int) -> nn.Module:
        return ThirdPersonDiscriminator(
            n_features, self.window, self.disc_hidden, self.gradient_reversal_coef
        )

    def _disc_loss(
        self, expert_windows: th.Tensor, learner_windows: th.Tensor, mixing: th.Tensor
    ) -> tuple[th.Tensor, dict[str, float]]:
        """Add the domain head's cross-entropy to the window discriminator's loss."""
        total, stats = super()._disc_loss(expert_windows, learner_windows, mixing)
        # a window's last state: over a pass every state reached counts once
        logits_expert = self.discriminator.domain_logits(expert_windows[:, -1])
        logits_learner = self.discriminator.domain_logits(learner_windows[:, -1])
        domain_loss = F.softplus(-logits_expert).mean() + F.softplus(logits_learner).mean()
        right = th.cat([logits_expert > 0, logits_learner < 0])
        stats["domain_loss"] = domain_loss.item()
        stats["domain_acc"] = right.float().mean().item()
        return total + domain_loss, stats
