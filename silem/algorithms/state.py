"""Torch modules and Adam optimizers as named NumPy arrays, policies as files, and back."""

from __future__ import annotations

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

_ACTIVATIONS = {made.__name__: made for made in (nn.Tanh, nn.ReLU, nn.ELU, nn.SiLU, nn.GELU)}
_OF_A_RUN = {"activation": "Tanh", "low": "-1", "high": "1"}  # what a run's file need not say
_MOMENTS = ("exp_avg", "exp_avg_sq")


def collect(
    modules: Mapping[str, th.nn.Module], optimizers: Mapping[str, th.optim.Optimizer]
) -> dict[str, np.ndarray]:
    """Return copies of all weights, buffers and Adam moments, named ``owner/part``."""
    arrays = {
        f"{owner}/{name}": tensor.detach().cpu().numpy().copy()
        for owner, module in modules.items()
        for name, tensor in module.state_dict().items()
    }
    for owner, optimizer in optimizers.items():
        for i, p in enumerate(_parameters(optimizer)):
            state = optimizer.state.get(p) or {}
            for moment in _MOMENTS:
                value = state[moment] if state else th.zeros_like(p)
                arrays[f"{owner}.adam/{i}.{moment}"] = value.detach().cpu().numpy().copy()
            step = float(state["step"]) if state else 0.0
            arrays[f"{owner}.adam/{i}.step"] = np.array([step], np.float32)
    return arrays


def restore(
    modules: Mapping[str, th.nn.Module],
    optimizers: Mapping[str, th.optim.Optimizer],
    arrays: Mapping[str, np.ndarray],
) -> None:
    """Copy :func:`collect`'s arrays back, in place.

    Raises:
        SilemError: If a name is missing or unknown, or a shape or a value is wrong; nothing is
            changed then.
    """
    _check(collect(modules, optimizers), arrays)
    for owner, module in modules.items():
        for name, tensor in module.state_dict().items():
            tensor.copy_(th.from_numpy(np.array(arrays[f"{owner}/{name}"])))
    for owner, optimizer in optimizers.items():
        for i, p in enumerate(_parameters(optimizer)):
            state = optimizer.state[p]
            for moment in _MOMENTS:
                value = th.from_numpy(np.array(arrays[f"{owner}.adam/{i}.{moment}"]))
                state.setdefault(moment, th.zeros_like(p)).copy_(value)
            step = float(arrays[f"{owner}.adam/{i}.step"][0])
            state.setdefault("step", th.tensor(0.0)).fill_(step)


def _parameters(optimizer: th.optim.Optimizer) -> list[th.Tensor]:
    return [p for group in optimizer.param_groups for p in group["params"]]


def _check(expected: Mapping[str, np.ndarray], arrays: Mapping[str, np.ndarray]) -> None:
    for problem, names in (
        ("lacks", expected.keys() - arrays.keys()),
        ("has unknown", arrays.keys() - expected.keys()),
    ):
        if names:
            listed = ", ".join(sorted(names)[:5])
            raise SilemError(f"saved state {problem} {len(names)} array(s): {listed}")
    for name, array in expected.items():
        if arrays[name].shape != array.shape:
            raise SilemError(
                f"saved state: {name} has shape {arrays[name].shape}, expected {array.shape}"
            )
        if not np.isfinite(arrays[name]).all():
            raise SilemError(f"saved state: {name} holds NaN or infinity")


def export_policy(policy: object, path: Path, about: Mapping[str, str]) -> None:
    """Write a policy as safetensors, for :func:`load_policy`; see ``PPO.export_policy``."""
    arrays = collect({"policy": policy}, {}) if isinstance(policy, nn.Module) else {}
    described = _described(policy)
    try:
        again = _rebuilt(arrays, described or {})
    except (LookupError, ValueError):
        again = None
    if not (
        again is not None
        and isinstance(policy, ActorCriticPolicy)
        and again.action_space == policy.action_space
        and again.observation_space.shape == policy.observation_space.shape
    ):
        raise SilemError(
            "only a multi-layer perceptron from a flat Box of observations, with one of the"
            f" activations {', '.join(_ACTIVATIONS)}, can be exported; `save` keeps any policy, as"
            " a pickle"
        )
    files.write_tensors(path, arrays, {**about, **(described or {})})


def _described(policy: object) -> dict[str, str] | None:
    """Return what a policy's arrays do not tell of it, or None if it is of another kind."""
    if type(policy) is not ActorCriticPolicy or not policy.share_features_extractor:
        return None
    if policy.use_sde or not isinstance(policy.observation_space, spaces.Box):
        return None
    space, about = policy.action_space, {"activation": policy.activation_fn.__name__}
    if isinstance(space, spaces.Box):
        about |= {name: _text(getattr(space, name)) for name in ("low", "high")}
    elif isinstance(space, spaces.MultiDiscrete):
        about["nvec"] = _text(space.nvec)
    elif isinstance(space, spaces.MultiBinary):
        about["binary"] = "yes"
    return about


def _text(numbers: np.ndarray) -> str:
    return " ".join(repr(number) for number in numbers.ravel().tolist())


def load_policy(path: Path | str) -> ActorCriticPolicy:
    """Return a policy that ``export_policy`` wrote, or a run's ``policy.safetensors``.

    Such a file holds numbers alone, no code: a stranger's is safe to load. The policy is
    stable-baselines3's: it has ``predict``, needs no environment, and goes on learning as the
    ``policy`` of a ``PPO``, stable-baselines3's own or this package's.

    Raises:
        SilemError: The file is missing, damaged or no policy.
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
    restore({"policy": policy}, {}, arrays)
    policy.set_training_mode(False)
    return policy
