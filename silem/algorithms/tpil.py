"""TPIL, third-person imitation learning (Stadie et al., 2017), as the paper compares with it."""

from typing import Any, ClassVar

import torch as th

from silem.algorithms.gaifo import GAIfO
from silem.algorithms.networks import ThirdPersonDiscriminator, cross_entropy
from silem.util.errors import COUNT, WEIGHT, NumberKind


class TPIL(GAIfO):
    """Third-person imitation learning on windows of skeletal features.

    Where :class:`SILEM` transforms the learner's features, TPIL has the discriminator encode
    states so that a single one does not tell the bodies apart (:class:`ThirdPersonDiscriminator`).
    The original works on images and two time steps; the paper gives it SILEM's windows.

    Args:
        *args: ``policy``, ``env`` and ``demonstrations``, as in :class:`GAIfO`.
        gradient_reversal_coef: C_g, weight of the reversed gradient in the encoder; 0 trains the
            encoder for the window discriminator alone.
        encoder_layers: Depth of the encoder, of which the paper says nothing.
        **kwargs: Everything :class:`GAIfO` and :class:`PPO` take.

    Raises SilemError as :class:`GAIfO`; an empty ``disc_hidden``.
    """

    discriminator: ThirdPersonDiscriminator
    _numbers: ClassVar[dict[str, NumberKind]] = GAIfO._numbers | {
        "gradient_reversal_coef": WEIGHT, "encoder_layers": COUNT,
    }  # fmt: skip

    def __init__(
        self,
        *args: Any,
        gradient_reversal_coef: float = 1.0,
        encoder_layers: int = 1,
        **kwargs: Any,
    ) -> None:
        self.gradient_reversal_coef, self.encoder_layers = gradient_reversal_coef, encoder_layers
        super().__init__(*args, **kwargs)

    def _make_discriminator(self, n_features: int) -> th.nn.Module:
        coef, layers = self.gradient_reversal_coef, self.encoder_layers
        return ThirdPersonDiscriminator(n_features, self.window, self.disc_hidden, coef, layers)

    def _disc_loss(
        self, expert_windows: th.Tensor, learner_windows: th.Tensor, mixing: th.Tensor
    ) -> tuple[th.Tensor, dict[str, float]]:
        """Add the domain head's cross-entropy to the window discriminator's loss."""
        total, stats = super()._disc_loss(expert_windows, learner_windows, mixing)
        # a window's last state: over a pass every state reached counts once
        logits_expert = self.discriminator.domain_logits(expert_windows[:, -1])
        logits_learner = self.discriminator.domain_logits(learner_windows[:, -1])
        domain_loss = cross_entropy(logits_expert, logits_learner)
        right = th.cat([logits_expert > 0, logits_learner < 0])
        stats["domain_loss"] = domain_loss.item()
        stats["domain_acc"] = right.float().mean().item()
        return total + domain_loss, stats
