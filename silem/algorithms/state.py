"""Torch modules and Adam optimizers as flat dictionaries of named NumPy arrays, and back."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch as th

from silem.util.errors import SilemError

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
