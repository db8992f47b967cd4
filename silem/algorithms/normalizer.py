"""Running observation normalisation that lives in the policy, as in OpenAI baselines' ppo1."""

from __future__ import annotations

import numpy as np
import torch as th
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from silem.util.errors import SilemError

CLIP = 5.0  # standard deviations, ppo1's value
_EPSILON = 1e-8


class RunningNormalizer(BaseFeaturesExtractor):
    """Centre and scale flat observations by the moments of everything seen so far.

    Being part of the policy, the moments are saved, loaded and used by ``predict`` with it:
    no wrapper has to travel beside the model. They change only in :meth:`update`, which the
    algorithm calls once per iteration, so the policy that collects a rollout is the policy
    that is updated on it.

    Args:
        observation_space: A flat Box of shape (O,).

    Raises:
        SilemError: If the observation space is not a flat Box.
    """

    def __init__(self, observation_space: spaces.Box) -> None:
        if not isinstance(observation_space, spaces.Box) or len(observation_space.shape) != 1:
            raise SilemError(
                f"observation normalisation needs a flat Box space, got {observation_space}; "
                "pass normalize_observations=False"
            )
        n_features = observation_space.shape[0]
        super().__init__(observation_space, n_features)
        self.mean: th.Tensor
        self.var: th.Tensor
        self.count: th.Tensor
        self.register_buffer("mean", th.zeros(n_features, dtype=th.float64))
        self.register_buffer("var", th.ones(n_features, dtype=th.float64))
        self.register_buffer("count", th.tensor(1e-4, dtype=th.float64))

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
        batch = th.from_numpy(np.asarray(observations, dtype=np.float64))
        batch_mean, batch_var, batch_count = batch.mean(0), batch.var(0, unbiased=False), len(batch)
        total = self.count + batch_count
        delta = batch_mean - self.mean
        self.var.copy_(
            (self.var * self.count + batch_var * batch_count) / total
            + delta**2 * self.count * batch_count / total**2
        )
        self.mean.add_(delta * batch_count / total)
        self.count.copy_(total)
