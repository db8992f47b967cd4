"""SILEM, SILEM-minus and the MLP ablation: Algorithm 1."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
import torch as th
from torch.nn import functional as F

from silem.algorithms.gaifo import AdversarialImitation
from silem.algorithms.transforms import (
    L2_FORMS,
    TRANSFORMS,
    AffineTransform,
    l2_penalty,
    make_transform,
)
from silem.motion.demonstrations import Demonstrations
from silem.util.errors import SilemError, choose


class SILEM(AdversarialImitation):
    """Skeletal feature compensation for imitation learning with embodiment mismatch.

    Each iteration collects a rollout, updates the discriminator D on it, updates the transform
    T with D's weights fixed, puts D(T(o)) in the rewards' place and makes a PPO update.

    Args:
        policy: As in stable-baselines3 ("MlpPolicy").
        env: As in :class:`AdversarialImitation`.
        demonstrations: The expert's :class:`Demonstrations`, or a list of (T + 1, F) arrays.
        transform: f of the sequential transform: "affine" is SILEM, "identity" SILEM-minus,
            "mlp" the ablation of Table 1.
        n_transform_updates: N_G, transform steps per iteration, one pass over the rollout.
        transform_learning_rate: Adam's rate for T at the first iteration.
        transform_lr_decay: d, factor on the transform's learning rate per iteration.
        transform_l2_scale: w_d, weight of the L2 term on A; 0 switches it off (HalfCheetah, Ant).
        transform_l2_bias: w_b, weight of the L2 term on b; likewise.
        transform_l2_form: "deviation" penalises A - 1, "plain" A itself (see `l2_penalty`).
        **kwargs: Everything :class:`AdversarialImitation` takes: ``window``, ``n_disc_updates``,
            ``disc_learning_rate``, ``disc_hidden``, ``disc_entropy_coef``,
            ``gradient_penalty``, and everything :class:`PPO` takes.

    Raises:
        SilemError: On an unknown transform or form, an L2 term on another transform than the
            affine one, unusable demonstrations, or demonstrations of another feature width than
            the learner's.
    """

    _transient: ClassVar[list[str]] = [
        *AdversarialImitation._transient, "transform_net", "transform_optimizer",
    ]  # fmt: skip

    def __init__(
        self,
        policy: Any,
        env: Any,
        demonstrations: Demonstrations | Sequence[np.ndarray] | None = None,
        *,
        transform: str = "affine",
        n_transform_updates: int = 5,
        transform_learning_rate: float = 1e-4,
        transform_lr_decay: float = 1.0,
        transform_l2_scale: float = 0.0,
        transform_l2_bias: float = 0.0,
        transform_l2_form: str = "deviation",
        **kwargs: Any,
    ) -> None:
        self.transform = choose("transform", transform, TRANSFORMS)
        self.n_transform_updates = n_transform_updates
        self.transform_learning_rate = transform_learning_rate
        self.transform_lr_decay = transform_lr_decay
        self.transform_l2_scale = transform_l2_scale
        self.transform_l2_bias = transform_l2_bias
        self.transform_l2_form = choose("transform_l2_form", transform_l2_form, L2_FORMS)
        if (transform_l2_scale or transform_l2_bias) and transform != "affine":
            raise SilemError(f"the L2 term is the affine transform's; {transform!r} has none")
        super().__init__(policy, env, demonstrations, **kwargs)

    def _setup_model(self) -> None:
        super()._setup_model()
        n_features = self.demonstrations.n_features
        self.transform_net = make_transform(self.transform, n_features).to(self.device)
        learned = list(self.transform_net.parameters())
        self.transform_optimizer = (
            th.optim.Adam(learned, lr=self.transform_learning_rate) if learned else None
        )

    def state_modules(self) -> dict[str, th.nn.Module]:
        """Return policy, discriminator and transform, by name."""
        return super().state_modules() | {"transform": self.transform_net}

    def state_optimizers(self) -> dict[str, th.optim.Optimizer]:
        """Return their optimizers, by name; the identity has none."""
        optimizer = self.transform_optimizer
        own = {} if optimizer is None else {"transform": optimizer}
        return super().state_optimizers() | own

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        own = ["transform_net"]
        if self.transform_optimizer is not None:
            own.append("transform_optimizer")
        names, variables = super()._get_torch_save_params()
        return [*names, *own], variables

    def _shown(self, learner_windows: th.Tensor) -> th.Tensor:
        with th.no_grad():
            return self.transform_net(learner_windows)

    def _update_compensation(self, learner_windows: th.Tensor) -> dict[str, float]:
        return self.update_transform(learner_windows)

    def update_transform(self, learner_windows: th.Tensor) -> dict[str, float]:
        """Make N_G steps of line 10 on windows (N, W, F); D's weights stay.

        Returns:
            The mean of line 10's loss -log D(T(o)), without the L2 term, and the learning rate.
        """
        if self.transform_optimizer is None:
            return {}
        iteration = self.num_timesteps // (self.n_steps * self.n_envs) - 1
        rate = self.transform_learning_rate * self.transform_lr_decay**iteration
        self.transform_optimizer.param_groups[0]["lr"] = rate
        learned = list(self.transform_net.parameters())
        losses = []
        for rows in self._passes(len(learner_windows), self.n_transform_updates):
            logits = self.discriminator(self.transform_net(learner_windows[rows]))
            loss = F.softplus(-logits).mean()  # -log sigmoid(logit)
            losses.append(loss.item())
            if self.transform_l2_scale or self.transform_l2_bias:
                loss = loss + self._l2_penalty()
            # gradients by T alone: D's are not even computed
            for p, gradient in zip(learned, th.autograd.grad(loss, learned), strict=True):
                p.grad = gradient
            self.transform_optimizer.step()
        return {"transform_loss": float(np.mean(losses)), "transform_learning_rate": rate}

    def _l2_penalty(self) -> th.Tensor:
        assert isinstance(self.transform_net, AffineTransform)
        return l2_penalty(
            self.transform_net,
            self.transform_l2_scale,
            self.transform_l2_bias,
            self.transform_l2_form,
        )

    def _log_imitation(self) -> None:
        super()._log_imitation()
        if isinstance(self.transform_net, AffineTransform):
            with th.no_grad():
                for name, values in self.transform_net.named_parameters():
                    for i, entry in enumerate(values.tolist()):
                        self.logger.record(f"transform/{name}_{i}", entry, exclude="stdout")
