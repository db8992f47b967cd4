"""What learns beside policy and value function: discriminators, and the observations' moments."""

from collections.abc import Sequence

import numpy as np
import torch as th
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, create_mlp
from torch import nn
from torch.nn import functional as F

from silem.util.errors import SilemError

CLIP = 5.0  # standard deviations that a normalised observation is cut at, ppo1's value
_EPSILON = 1e-8


def _tanh_mlp(n_inputs: int, hidden: Sequence[int]) -> list[nn.Module]:
    return create_mlp(n_inputs, 1, list(hidden), nn.Tanh)


class Discriminator(nn.Module):
    """D, a tanh MLP from a window of W states with F features to one logit, high for "expert".

    The supplement's ``hidden`` layers are 3 x 128 units, humanoids' 2 x 128.
    """

    def __init__(self, n_features: int, window: int, hidden: Sequence[int]) -> None:
        super().__init__()
        self.net = nn.Sequential(nn.Flatten(), *_tanh_mlp(n_features * window, hidden))

    def forward(self, windows: th.Tensor) -> th.Tensor:
        """Return ``disc_logits_expert_is_high`` (B,) of windows (B, W, F)."""
        return self.net(windows)[:, 0]


def cross_entropy(logits_expert: th.Tensor, logits_learner: th.Tensor) -> th.Tensor:
    """Return the loss of telling expert from learner by logits (B,) that are high for the expert.

    Each side's mean counts as much as the other's (line 9 of Algorithm 1).
    """
    return F.softplus(-logits_expert).mean() + F.softplus(logits_learner).mean()


def discriminator_loss(
    discriminator: nn.Module,
    expert_windows: th.Tensor,
    learner_windows: th.Tensor,
    *,
    entropy_coef: float,
    gradient_penalty: float,
    mixing: th.Tensor | None = None,
) -> tuple[th.Tensor, dict[str, float]]:
    """Compute line 9's cross-entropy, the entropy bonus and the optional gradient penalty.

    Args:
        discriminator: D, returning logits that are high for the expert.
        expert_windows: (B, W, F).
        learner_windows: (B, W, F), already transformed.
        entropy_coef: Weight of the Bernoulli entropy bonus (from merel-mocap-gail).
        gradient_penalty: Weight of the squared gradient norm of the logit on random mixtures of
            expert and learner windows; 0 switches it off. Not in the paper: see "Deviations".
        mixing: Share of the expert in each mixture, (B,) in [0, 1]; needed with the penalty.

    Returns:
        The loss, and what to log: line 9's cross-entropy and the shares judged rightly.
    """
    logits_expert = discriminator(expert_windows)
    logits_learner = discriminator(learner_windows)
    told_apart = cross_entropy(logits_expert, logits_learner)
    total = told_apart
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
    return total, {
        "disc_loss": told_apart.item(),
        "disc_acc_expert": (logits_expert > 0).float().mean().item(),
        "disc_acc_learner": (logits_learner < 0).float().mean().item(),
    }


def squared_gradient_norm(discriminator: nn.Module, windows: th.Tensor) -> th.Tensor:
    """Return the mean squared norm of the logit's gradient by the windows (B, W, F)."""
    windows = windows.detach().requires_grad_(True)
    logits = discriminator(windows)
    (gradient,) = th.autograd.grad(logits.sum(), windows, create_graph=True)
    return gradient.flatten(1).square().sum(dim=1).mean()


def reverse_gradient(x: th.Tensor, coef: float) -> th.Tensor:
    """Return ``x`` unchanged; its gradient comes back times ``-coef`` (Ganin & Lempitsky, 2015).

    What lies behind it minimises its loss, what lies before it maximises it; C_g, ``coef``, is at
    least 0, and at 0 lets no gradient through.
    """
    same = x.view_as(x)
    if same.requires_grad:
        same.register_hook(lambda gradient: -coef * gradient)
    return same


class ThirdPersonDiscriminator(nn.Module):
    """TPIL's two discriminators on one encoder of single states; a high logit means "expert".

    The window head judges the encodings of a window's W states and gives the reward. The domain
    head tells expert from learner by a single state's encoding; through gradient reversal, of
    weight C_g, the encoder learns to make that impossible, so as to forget what the body betrays.
    The first hidden layer is the encoder's, which has `encoder_layers` of its size, the others are
    each head's. Raises SilemError if there is no hidden layer.
    """

    def __init__(
        self,
        n_features: int,
        window: int,
        hidden: Sequence[int],
        reversal_coef: float,
        encoder_layers: int = 1,
    ) -> None:
        super().__init__()
        if not hidden:
            raise SilemError("disc_hidden needs one layer at least: the first encodes a state")
        self.reversal_coef = reversal_coef
        self.encoder = nn.Sequential(nn.Linear(n_features, hidden[0]), nn.Tanh())
        self.window_head = nn.Sequential(*_tanh_mlp(window * hidden[0], hidden[1:]))
        self.domain_head = nn.Sequential(*_tanh_mlp(hidden[0], hidden[1:]))
        for _ in range(encoder_layers - 1):
            self.encoder.extend([nn.Linear(hidden[0], hidden[0]), nn.Tanh()])

    def forward(self, windows: th.Tensor) -> th.Tensor:
        """Return ``disc_logits_expert_is_high`` (B,) of windows (B, W, F)."""
        return self.window_head(self.encoder(windows).flatten(1))[:, 0]

    def domain_logits(self, states: th.Tensor) -> th.Tensor:
        """Return ``domain_logits_expert_is_high`` (B,) of states (B, F); reverses gradients."""
        return self.domain_head(reverse_gradient(self.encoder(states), self.reversal_coef))[:, 0]


class RunningNormalizer(BaseFeaturesExtractor):  # its place is named in files that `save` wrote
    """Centre and scale flat observations by the moments of everything seen so far, as in ppo1.

    Being part of the policy, the moments are saved, loaded and used by ``predict`` with it. They
    change only in :meth:`update`, which the algorithm calls once per iteration, so the policy that
    collects a rollout is the policy that is updated on it. Raises SilemError if the observation
    space is not a flat Box.
    """

    def __init__(self, observation_space: spaces.Box) -> None:
        if not isinstance(observation_space, spaces.Box) or len(observation_space.shape) != 1:
            told = f"observation normalisation needs a flat Box, not {observation_space}"
            raise SilemError(f"{told}; pass normalize_observations=False")
        n_features = observation_space.shape[0]
        super().__init__(observation_space, n_features)
        self.mean = nn.Buffer(th.zeros(n_features, dtype=th.float64))
        self.var = nn.Buffer(th.ones(n_features, dtype=th.float64))
        self.count = nn.Buffer(th.tensor(1e-4, dtype=th.float64))

    def forward(self, observations: th.Tensor) -> th.Tensor:
        """Return observations (B, O) in clipped standard deviations."""
        scale = th.sqrt(self.var + _EPSILON).to(observations.dtype)
        centred = observations - self.mean.to(observations.dtype)
        return th.clamp(centred / scale, -CLIP, CLIP)

    def mean_and_scale(self, dtype: np.dtype) -> tuple[np.ndarray, np.ndarray]:
        """Return the mean and the standard deviation in use, each (O,), in ``dtype``."""
        scale = th.sqrt(self.var + _EPSILON)
        return self.mean.numpy().astype(dtype), scale.numpy().astype(dtype)

    def update(self, observations: np.ndarray) -> None:
        """Merge the moments of a batch (B, O) into the running ones (Chan et al., 1979)."""
        batch = th.from_numpy(np.asarray(observations, dtype=np.float64)).to(self.mean.device)
        mean, var, n = batch.mean(0), batch.var(0, unbiased=False), len(batch)
        total, delta = self.count + n, mean - self.mean
        self.var.copy_(
            (self.var * self.count + var * n) / total + delta**2 * self.count * n / total**2
        )
        self.mean.add_(delta * n / total)
        self.count.copy_(total)
