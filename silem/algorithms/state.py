"""What learns, as named NumPy arrays and back; policies as files that hold numbers alone."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch as th
from gymnasium import spaces
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import FlattenExtractor
from torch import nn

from silem.algorithms.networks import RunningNormalizer
from silem.util import files
from silem.util.errors import SilemError, choose

Learners = Mapping[str, tuple[nn.Module, th.optim.Optimizer | None]]
"""What learns by name: a module, and the Adam optimizer of its parameters."""

_ACTIVATIONS = {made.__name__: made for made in (nn.Tanh, nn.ReLU, nn.ELU, nn.SiLU, nn.GELU)}
_OF_A_RUN = {"activation": "Tanh", "low": "-1", "high": "1"}  # what a run's file need not say


def _tensors(learners: Learners) -> dict[str, th.Tensor]:
    """Return all weights, buffers and Adam moments themselves, named ``owner/part``."""
    found: dict[str, th.Tensor] = {}
    for owner, (module, optimizer) in learners.items():
        found |= {f"{owner}/{name}": tensor for name, tensor in module.state_dict().items()}
        if optimizer is None:
            continue
        for i, p in enumerate(p for group in optimizer.param_groups for p in group["params"]):
            adam = optimizer.state[p]
            for name in ("exp_avg", "exp_avg_sq"):
                found[f"{owner}.adam/{i}.{name}"] = adam.setdefault(name, th.zeros_like(p))
            found[f"{owner}.adam/{i}.step"] = adam.setdefault("step", th.tensor(0.0)).view(1)
    return found


def collect(learners: Learners) -> dict[str, np.ndarray]:
    """Return copies of all weights, buffers and Adam moments, named ``owner/part``."""
    return {name: t.detach().cpu().numpy().copy() for name, t in _tensors(learners).items()}


def restore(learners: Learners, arrays: Mapping[str, np.ndarray]) -> None:
    """Copy :func:`collect`'s arrays back, in place.

    Raises SilemError: a name is missing or unknown, or a shape or a value is wrong; no weight is
    changed then.
    """
    tensors = _tensors(learners)
    for problem, names in (
        ("lacks", tensors.keys() - arrays.keys()),
        ("has unknown", arrays.keys() - tensors.keys()),
    ):
        if names:
            listed = ", ".join(sorted(names)[:5])
            raise SilemError(f"saved state {problem} {len(names)} array(s): {listed}")
    for name, tensor in tensors.items():
        shape, wanted = arrays[name].shape, tuple(tensor.shape)
        if shape != wanted:
            raise SilemError(f"saved state: {name} has shape {shape}, expected {wanted}")
        if not np.isfinite(arrays[name]).all():
            raise SilemError(f"saved state: {name} holds NaN or infinity")
    for name, tensor in tensors.items():
        tensor.copy_(th.from_numpy(np.array(arrays[name])))


def export_policy(policy: ActorCriticPolicy, path: Path, about: Mapping[str, str]) -> None:
    """Write a policy as safetensors, for :func:`load_policy`; see ``PPO.export_policy``."""
    arrays, described = collect({"policy": (policy, None)}), _described(policy)
    try:
        again = _rebuilt(arrays, described)
        whole = again.action_space == policy.action_space
        whole &= again.observation_space.shape == policy.observation_space.shape
    except (LookupError, ValueError):
        whole = False
    if not whole:
        told = f"only an MLP from a flat Box, with {' or '.join(_ACTIVATIONS)}, can be exported"
        raise SilemError(f"{told}; `save` keeps any policy, as a pickle")
    files.write_tensors(path, arrays, {**about, **described})


def _described(policy: ActorCriticPolicy) -> dict[str, str]:
    """Return what a policy's arrays do not tell of it; nothing of one of another kind."""
    if type(policy) is not ActorCriticPolicy or not policy.share_features_extractor:
        return {}
    if policy.use_sde or not isinstance(policy.observation_space, spaces.Box):
        return {}
    space, about = policy.action_space, {"activation": policy.activation_fn.__name__}
    for name in ("low", "high", "nvec"):  # of a Box or a MultiDiscrete
        if isinstance(numbers := getattr(space, name, None), np.ndarray):
            about[name] = " ".join(map(repr, numbers.ravel().tolist()))
    return about | ({"binary": "yes"} if isinstance(space, spaces.MultiBinary) else {})


def load_policy(path: Path | str) -> ActorCriticPolicy:
    """Return a policy that ``export_policy`` wrote, or a run's ``policy.safetensors``.

    Such a file holds numbers alone, no code: a stranger's is safe to load. The policy is
    stable-baselines3's: it has ``predict``, needs no environment, and goes on learning as the
    ``policy`` of a ``PPO``, stable-baselines3's own or this package's. Raises SilemError: the file
    is missing, damaged or no policy.
    """
    arrays, about = files.read_tensors(Path(path))
    try:
        return _rebuilt(arrays, about if "activation" in about else _OF_A_RUN)
    except (LookupError, ValueError) as error:
        raise SilemError(f"{path} holds no policy: {error}") from error


def _rebuilt(arrays: Mapping[str, np.ndarray], about: Mapping[str, str]) -> ActorCriticPolicy:
    """Build the policy whose arrays these are; their shapes tell the networks'."""

    def layers(net: str) -> list[np.ndarray]:
        found = re.compile(rf"policy/mlp_extractor\.{net}_net\.(\d+)\.weight").fullmatch
        weights = {int(match[1]): arrays[name] for name in arrays if (match := found(name))}
        return [weights[i] for i in sorted(weights)]

    n_actions, n_last = arrays["policy/action_net.weight"].shape
    hidden = {"pi": layers("policy"), "vf": layers("value")}
    first = hidden["pi"][0].shape[1] if hidden["pi"] else n_last
    action_space: spaces.Space[Any] = spaces.Discrete(n_actions)
    if "policy/log_std" in arrays:
        bounds = [np.array(about[name].split(), np.float32) for name in ("low", "high")]
        low, high = (np.broadcast_to(bound, n_actions).copy() for bound in bounds)
        action_space = spaces.Box(low, high)
    elif "nvec" in about:
        action_space = spaces.MultiDiscrete([int(n) for n in about["nvec"].split()])
    elif "binary" in about:
        action_space = spaces.MultiBinary(n_actions)
    normalised = "policy/features_extractor.mean" in arrays
    with th.random.fork_rng(devices=[]):  # what the weights begin as does not matter
        policy = ActorCriticPolicy(
            spaces.Box(-np.inf, np.inf, (first,)),
            action_space,
            lr_schedule=lambda _: 0.0,
            net_arch={name: [len(weight) for weight in net] for name, net in hidden.items()},
            activation_fn=_ACTIVATIONS[choose("activation", about["activation"], _ACTIVATIONS)],
            features_extractor_class=RunningNormalizer if normalised else FlattenExtractor,
        )
    restore({"policy": (policy, None)}, arrays)
    policy.set_training_mode(False)
    return policy
