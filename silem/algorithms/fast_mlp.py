"""The tanh MLP actor-critic of PPO in NumPy, on the memory of the torch policy.

A PPO update is hundreds of tiny matrix products, and autograd's bookkeeping costs several times the
arithmetic. Here forward pass, gradient and Adam are written out on one flat vector;
`PPO._refresh_twin` says how it and torch share their memory.
"""

import math
from typing import NamedTuple

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


class Batch(NamedTuple):
    """B transitions for PPO, a minibatch or a rollout; observations are already normalised."""

    observations: np.ndarray  #: (B, O)
    actions: np.ndarray  #: (B, A)
    old_log_probs: np.ndarray  #: (B,)
    advantages: np.ndarray  #: (B,)
    returns: np.ndarray  #: (B,)


class Losses(NamedTuple):
    """What PPO logs of one minibatch, under stable-baselines3's names."""

    policy_gradient_loss: float
    value_loss: float
    entropy_loss: float
    approx_kl: float
    clip_fraction: float


class _Tower:
    """A tanh MLP with a linear head; its layers' arrays are views into flat vectors."""

    def __init__(self, layers: list[list[np.ndarray]]) -> None:
        # weights are (out, in), as torch has them
        columns = zip(*layers, strict=True)
        self._weights, self._grad_weights, self._biases, self._grad_biases = columns
        self._activations: list[np.ndarray] = []

    def forward(self, x: np.ndarray) -> np.ndarray:
        """Return the head's output (B, out), keeping the activations for :meth:`backward`."""
        self._activations = [x]
        for weight, bias in zip(self._weights[:-1], self._biases[:-1], strict=True):
            x = x @ weight.T
            x += bias
            np.tanh(x, out=x)
            self._activations.append(x)
        return x @ self._weights[-1].T + self._biases[-1]

    def backward(self, grad_out: np.ndarray) -> None:
        """Write every weight's and bias's gradient, from that of the head's output, (B, out)."""
        for i in range(len(self._weights) - 1, -1, -1):
            x = self._activations[i]
            np.matmul(grad_out.T, x, out=self._grad_weights[i])
            np.add.reduce(grad_out, axis=0, out=self._grad_biases[i])
            if i > 0:
                grad_out = grad_out @ self._weights[i]
                grad_out *= 1.0 - x * x


def _nets(policy: ActorCriticPolicy) -> tuple[list[nn.Module], list[nn.Module]]:
    """Return the layers of actor and critic, each with its head."""
    hidden = policy.mlp_extractor
    return [*hidden.policy_net, policy.action_net], [*hidden.value_net, policy.value_net]


class FlatActorCritic:
    """NumPy twin of a policy that it :meth:`supports`; takes over the memory of its parameters."""

    def __init__(self, policy: ActorCriticPolicy) -> None:
        self.policy = policy
        self._pointers: list[int] = []
        self._moments: tuple[np.ndarray, np.ndarray] | None
        self.sync()

    @staticmethod
    def supports(policy: object) -> bool:
        """Tell whether the policy is a CPU tanh MLP with a diagonal Gaussian and plain Adam.

        Observations must reach its networks as they are: from a Box, and not as images. It moves
        every parameter and runs no hooks, so there may be neither frozen parameters nor hooks.
        """
        if type(policy) is not ActorCriticPolicy or not policy.share_features_extractor:
            return False
        space, adam, parameters = policy.observation_space, policy.optimizer, [*policy.parameters()]
        if type(adam) is not th.optim.Adam or len(adam.param_groups) != 1:
            return False
        group = adam.param_groups[0]
        return (
            isinstance(space, spaces.Box)
            and not (policy.normalize_images and is_image_space(space))
            and not any(group[name] for name in ("weight_decay", "amsgrad", "maximize"))
            and [*map(id, group["params"])] == [*map(id, parameters)]
            and all(
                p.requires_grad and p.device.type == "cpu" and p.dtype == th.float32
                for p in parameters
            )
            and not any(m._forward_hooks or m._forward_pre_hooks for m in policy.modules())
            and type(policy.action_dist) is DiagGaussianDistribution
            and not policy.squash_output
            and type(policy.features_extractor) in (FlattenExtractor, RunningNormalizer)
            and type(policy.mlp_extractor) is MlpExtractor
            and all(
                type(layer) is (nn.Tanh if i % 2 else nn.Linear)
                for net in _nets(policy)
                for i, layer in enumerate(net)
            )
        )

    def sync(self) -> None:
        """Adopt the policy again if any of its tensors was replaced; copy its moments."""
        if self._pointers != self._tensor_pointers():
            self._adopt()
        extractor = self.policy.features_extractor
        self._moments = None
        if isinstance(extractor, RunningNormalizer):
            self._moments = extractor.mean_and_scale(self.params.dtype)

    def normalize(self, observations: np.ndarray) -> np.ndarray:
        """Return observations (B, O), or one, as the networks take them, (B, O)."""
        x = np.reshape(observations, (-1, self.policy.features_dim))
        x = x.astype(self.params.dtype, copy=False)
        if self._moments is None:
            return x
        mean, scale = self._moments
        x = (x - mean) / scale
        np.minimum(np.maximum(x, -CLIP, out=x), CLIP, out=x)
        return x

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

        The minibatch's advantages are used as they are; ``clip_range`` is epsilon, the other two
        are the weights of the entropy bonus and of the squared value error.
        """
        size = len(batch.actions)
        std = np.exp(self._log_std)
        standardized = (batch.actions - self._actor.forward(batch.observations)) / std
        log_probs = (-0.5 * standardized**2 - self._log_std - _HALF_LOG_2PI).sum(axis=1)
        log_ratio = log_probs - batch.old_log_probs
        ratio = np.exp(log_ratio)
        surrogate = batch.advantages * ratio
        clipped = batch.advantages * ratio.clip(1.0 - clip_range, 1.0 + clip_range)
        # where the clipped term is the smaller one, it is constant and passes no gradient
        grad_log_prob = np.where(surrogate <= clipped, surrogate, 0.0) / -size
        self._actor.backward(grad_log_prob[:, None] * standardized / std)
        self._log_std_grad[...] = grad_log_prob @ (standardized**2 - 1.0) - ent_coef

        error = self._critic.forward(batch.observations)[:, 0] - batch.returns
        self._critic.backward((error * (2.0 * vf_coef / size))[:, None])
        return Losses(  # sums: NumPy's mean takes longer than all of these
            policy_gradient_loss=-float(np.minimum(surrogate, clipped).sum() / size),
            value_loss=float((error**2).sum() / size),
            entropy_loss=-float(self._log_std.sum()) - len(std) * (0.5 + _HALF_LOG_2PI),
            approx_kl=float((ratio - 1.0 - log_ratio).sum() / size),
            clip_fraction=np.count_nonzero(np.abs(ratio - 1.0) > clip_range) / size,
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
        policy, parameters = self.policy, list(self.policy.parameters())

        def pieces(flat: np.ndarray) -> list[th.Tensor]:
            parts = th.from_numpy(flat).split([p.numel() for p in parameters])
            return [part.view(p.shape) for part, p in zip(parts, parameters, strict=True)]

        self.params = np.concatenate([p.detach().numpy().ravel() for p in parameters])
        self.grads, self.exp_avg, self.exp_avg_sq = (np.zeros_like(self.params) for _ in range(3))
        self._steps = np.zeros(len(parameters), np.float32)  # one a parameter, as torch has it
        moments = th.from_numpy(self._steps).unbind(), pieces(self.exp_avg), pieces(self.exp_avg_sq)
        views: dict[th.Tensor, list[np.ndarray]] = {}
        for p, value, grad, *own in zip(
            parameters, pieces(self.params), pieces(self.grads), *moments, strict=True
        ):
            p.data, views[p] = value, [value.numpy(), grad.numpy()]
            adam = policy.optimizer.state[p]
            for name, moment in zip(_ADAM_STATE, own, strict=True):
                adam[name] = moment.copy_(adam[name]) if name in adam else moment
        self._pointers = self._tensor_pointers()
        self._log_std, self._log_std_grad = views[policy.log_std]
        self._actor, self._critic = (
            _Tower([views[n.weight] + views[n.bias] for n in net if isinstance(n, nn.Linear)])
            for net in _nets(policy)
        )

    def _tensor_pointers(self) -> list[int]:
        """Return where parameters, moments and steps of torch's side lie now."""
        adam = self.policy.optimizer.state
        return [
            tensor.data_ptr()
            for p in self.policy.parameters()
            for tensor in (p, *(adam.get(p, {}).get(name, p) for name in _ADAM_STATE))
        ]
