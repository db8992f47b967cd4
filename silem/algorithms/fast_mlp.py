"""The tanh MLP actor-critic of PPO in NumPy, on the memory of the torch policy.

A PPO update is hundreds of tiny matrix products, and autograd's bookkeeping costs several
times the arithmetic. Here forward pass, gradient and Adam are written out on one flat vector.
The torch parameters and Adam's moments are views of the same memory, so everything
stable-baselines3 does with the policy (predict, save, load) sees every step at once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch as th
from gymnasium import spaces
from stable_baselines3.common.distributions import DiagGaussianDistribution
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.preprocessing import is_image_space
from stable_baselines3.common.torch_layers import FlattenExtractor, MlpExtractor
from torch import nn

from silem.algorithms.networks import CLIP, RunningNormalizer

_ADAM_STATE = ("step", "exp_avg", "exp_avg_sq")
_HALF_LOG_2PI = 0.5 * math.log(2.0 * math.pi)


@dataclass(frozen=True)
class Batch:
    """B transitions for PPO, a minibatch or a rollout; observations are already normalised."""

    observations: np.ndarray  # (B, O)
    actions: np.ndarray  # (B, A)
    old_log_probs: np.ndarray  # (B,)
    advantages: np.ndarray  # (B,)
    returns: np.ndarray  # (B,)


@dataclass(frozen=True)
class Losses:
    """What PPO logs of one minibatch."""

    policy: float
    value: float
    approx_kl: float
    clip_fraction: float


class _Tower:
    """A tanh MLP with a linear head; weights and gradients are views into flat vectors."""

    def __init__(self, layers: list[tuple[np.ndarray, np.ndarray]]) -> None:
        self.weights = [weight for weight, _ in layers]  # each (out, in), as torch has them
        self.biases = [bias for _, bias in layers]
        self.activations: list[np.ndarray] = []

    def forward(self, x: np.ndarray) -> np.ndarray:
        """Return the head's output (B, out), keeping the activations for :meth:`backward`."""
        self.activations = [x]
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = x @ weight.T
            x += bias
            np.tanh(x, out=x)
            self.activations.append(x)
        return x @ self.weights[-1].T + self.biases[-1]

    def backward(self, grad_out: np.ndarray, grads: _Tower) -> None:
        """Write the loss gradient of every weight and bias into ``grads``.

        Args:
            grad_out: Gradient of the loss by the head's output, (B, out).
            grads: A tower of the same shapes, overwritten.
        """
        for i in range(len(self.weights) - 1, -1, -1):
            x = self.activations[i]
            np.matmul(grad_out.T, x, out=grads.weights[i])
            np.sum(grad_out, axis=0, out=grads.biases[i])
            if i > 0:
                grad_out = grad_out @ self.weights[i]
                grad_out *= 1.0 - x * x


def _same(first: Sequence[th.Tensor], second: Sequence[th.Tensor]) -> bool:
    return len(first) == len(second) and all(a is b for a, b in zip(first, second, strict=True))


class FlatActorCritic:
    """NumPy twin of a supported ``ActorCriticPolicy``; see :meth:`supports`.

    Args:
        policy: The torch policy whose parameters are moved into one flat vector.
    """

    def __init__(self, policy: ActorCriticPolicy) -> None:
        self.policy = policy
        self._adopt()

    @staticmethod
    def supports(policy: object) -> bool:
        """Tell whether the policy is a CPU tanh MLP with a diagonal Gaussian and plain Adam.

        What stable-baselines3 does to observations before the networks see them is part of it:
        the twin takes Box observations as they are, so not those that count as images. It moves
        every parameter and runs no hooks, so there may be neither frozen parameters nor hooks.
        """
        if type(policy) is not ActorCriticPolicy or not policy.share_features_extractor:
            return False
        space, adam = policy.observation_space, policy.optimizer
        as_it_is = isinstance(space, spaces.Box) and not (
            policy.normalize_images and is_image_space(space)
        )
        plain_adam = (
            type(adam) is th.optim.Adam
            and len(adam.param_groups) == 1
            and not any(
                adam.param_groups[0][name] for name in ("weight_decay", "amsgrad", "maximize")
            )
        )
        parameters, hidden = list(policy.parameters()), policy.mlp_extractor
        return (
            as_it_is
            and plain_adam
            and _same(adam.param_groups[0]["params"], parameters)
            and all(
                p.requires_grad and p.device.type == "cpu" and p.dtype == th.float32
                for p in parameters
            )
            and not any(m._forward_hooks or m._forward_pre_hooks for m in policy.modules())
            and type(policy.action_dist) is DiagGaussianDistribution
            and not policy.squash_output
            and type(policy.features_extractor) in (FlattenExtractor, RunningNormalizer)
            and type(hidden) is MlpExtractor
            and all(
                type(layer) is (nn.Tanh if i % 2 else nn.Linear)
                for net, head in (
                    (hidden.policy_net, policy.action_net),
                    (hidden.value_net, policy.value_net),
                )
                for i, layer in enumerate([*net, head])
            )
        )

    def sync(self) -> None:
        """Adopt the policy again if any of its tensors was replaced; copy its moments."""
        if self._pointers != self._tensor_pointers():
            self._adopt()
        self.refresh_moments()

    def normalize(self, observations: np.ndarray) -> np.ndarray:
        """Return observations (B, O) as the networks take them."""
        x = observations.reshape(len(observations), -1).astype(self.params.dtype, copy=False)
        if self._moments is None:
            return x
        mean, scale = self._moments
        x = (x - mean) / scale
        np.minimum(np.maximum(x, -CLIP, out=x), CLIP, out=x)
        return x

    def refresh_moments(self) -> None:
        """Take over the observation moments of the policy, after they changed."""
        extractor = self.policy.features_extractor
        self._moments: tuple[np.ndarray, np.ndarray] | None = None
        if isinstance(extractor, RunningNormalizer):
            self._moments = extractor.mean_and_scale(self.params.dtype)

    def sample(
        self, x: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Draw actions (E, A), values (E,) and log-probabilities (E,) for normalised x (E, O)."""
        mean = self._actor.forward(x)
        noise = rng.standard_normal(mean.shape, dtype=mean.dtype)
        actions = mean + np.exp(self._log_std) * noise
        log_probs = (-0.5 * noise * noise - self._log_std - _HALF_LOG_2PI).sum(axis=1)
        return actions, self.values(x), log_probs

    def values(self, x: np.ndarray) -> np.ndarray:
        """Return the critic's values (B,) of normalised observations (B, O)."""
        return self._critic.forward(x)[:, 0]

    def gradient(self, batch: Batch, clip_range: float, ent_coef: float, vf_coef: float) -> Losses:
        """Fill ``self.grads`` with the gradient of PPO's clipped loss (Schulman et al., 2017).

        Args:
            batch: The minibatch; its advantages are used as they are.
            clip_range: Epsilon of the clipped surrogate.
            ent_coef: Weight of the entropy bonus.
            vf_coef: Weight of the squared value error.
        """
        size = len(batch.actions)
        std = np.exp(self._log_std)
        standardized = (batch.actions - self._actor.forward(batch.observations)) / std
        log_probs = (-0.5 * standardized**2 - self._log_std - _HALF_LOG_2PI).sum(axis=1)
        log_ratio = log_probs - batch.old_log_probs
        ratio = np.exp(log_ratio)
        surrogate = batch.advantages * ratio
        clipped = batch.advantages * np.clip(ratio, 1.0 - clip_range, 1.0 + clip_range)
        # where the clipped term is the smaller one, it is constant and passes no gradient
        grad_log_prob = np.where(surrogate <= clipped, surrogate, 0.0) / -size
        self._actor.backward(grad_log_prob[:, None] * standardized / std, self._actor_grads)
        self._log_std_grad[...] = grad_log_prob @ (standardized**2 - 1.0) - ent_coef

        error = self._critic.forward(batch.observations)[:, 0] - batch.returns
        self._critic.backward((error * (2.0 * vf_coef / size))[:, None], self._critic_grads)
        return Losses(
            policy=-float(np.minimum(surrogate, clipped).mean()),
            value=float((error**2).mean()),
            approx_kl=float((ratio - 1.0 - log_ratio).mean()),
            clip_fraction=float((np.abs(ratio - 1.0) > clip_range).mean()),
        )

    def adam_step(self, max_grad_norm: float) -> None:
        """Clip the gradient's norm and take one step of Adam (Kingma & Ba, 2015)."""
        grads = self.grads
        if math.isfinite(max_grad_norm):
            norm = float(np.sqrt(grads @ grads))
            grads *= min(1.0, max_grad_norm / (norm + 1e-6))  # torch's clip_grad_norm_
        group = self.policy.optimizer.param_groups[0]
        beta1, beta2 = group["betas"]
        self._steps += 1.0
        step = float(self._steps[0])
        self.exp_avg += (grads - self.exp_avg) * (1.0 - beta1)
        self.exp_avg_sq *= beta2
        grads *= grads
        self.exp_avg_sq += grads * (1.0 - beta2)
        denominator = np.sqrt(self.exp_avg_sq)
        denominator /= math.sqrt(1.0 - beta2**step)
        denominator += group["eps"]
        self.params -= (group["lr"] / (1.0 - beta1**step)) * self.exp_avg / denominator

    def _adopt(self) -> None:
        """Move parameters and Adam's moments into flat vectors and point torch at them."""
        parameters = list(self.policy.parameters())
        dtype = parameters[0].detach().numpy().dtype
        total = sum(p.numel() for p in parameters)
        self.params, self.grads = np.empty(total, dtype), np.zeros(total, dtype)
        self.exp_avg, self.exp_avg_sq = np.zeros(total, dtype), np.zeros(total, dtype)
        self._steps = np.zeros(len(parameters), np.float32)  # one a parameter, as torch has it
        views: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        start = 0
        for i, p in enumerate(parameters):
            part, shape = slice(start, start + p.numel()), tuple(p.shape)
            start += p.numel()
            self.params[part] = p.detach().numpy().reshape(-1)
            p.data = th.from_numpy(self.params[part].reshape(shape))
            views[id(p)] = p.data.numpy(), self.grads[part].reshape(shape)
            self._adopt_moments(p, i, part, shape)
        self._pointers = self._tensor_pointers()
        self._build_towers(views)
        self.refresh_moments()

    def _tensor_pointers(self) -> list[int]:
        """Return where parameters, moments and steps of torch's side lie now."""
        optimizer_state = self.policy.optimizer.state
        return [
            tensor.data_ptr()
            for p in self.policy.parameters()
            for tensor in (p, *(optimizer_state.get(p, {}).get(name, p) for name in _ADAM_STATE))
        ]

    def _adopt_moments(self, p: nn.Parameter, i: int, part: slice, shape: tuple[int, ...]) -> None:
        state = self.policy.optimizer.state[p]
        if state:
            self.exp_avg[part] = state["exp_avg"].numpy().reshape(-1)
            self.exp_avg_sq[part] = state["exp_avg_sq"].numpy().reshape(-1)
            self._steps[i] = float(state["step"])
        state["step"] = th.from_numpy(self._steps[i : i + 1].reshape(()))
        state["exp_avg"] = th.from_numpy(self.exp_avg[part].reshape(shape))
        state["exp_avg_sq"] = th.from_numpy(self.exp_avg_sq[part].reshape(shape))

    def _build_towers(self, views: dict[int, tuple[np.ndarray, np.ndarray]]) -> None:
        policy = self.policy
        self._log_std, self._log_std_grad = views[id(policy.log_std)]

        def tower(hidden: nn.Sequential, head: nn.Module, which: int) -> _Tower:
            linears = [layer for layer in [*hidden, head] if isinstance(layer, nn.Linear)]
            return _Tower([(views[id(n.weight)][which], views[id(n.bias)][which]) for n in linears])

        actor = policy.mlp_extractor.policy_net, policy.action_net
        critic = policy.mlp_extractor.value_net, policy.value_net
        self._actor, self._actor_grads = tower(*actor, 0), tower(*actor, 1)
        self._critic, self._critic_grads = tower(*critic, 0), tower(*critic, 1)
