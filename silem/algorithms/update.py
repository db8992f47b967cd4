"""A rollout as PPO's update takes it, and what the update logs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch as th
from stable_baselines3.common.buffers import RolloutBuffer

from silem.algorithms.fast_mlp import FlatActorCritic, Losses, MiniBatch


@dataclass(frozen=True)
class FlatRollout:
    """One iteration's N transitions, environments one after another as in ``RolloutBuffer.get``.

    Attributes:
        inputs: Normalised observations, (N, O).
        actions: (N, A).
        log_probs: Of the actions when they were drawn, (N,).
        advantages: (N,), not yet normalised.
        returns: Targets of the value function, (N,).
    """

    inputs: np.ndarray
    actions: np.ndarray
    log_probs: np.ndarray
    advantages: np.ndarray
    returns: np.ndarray

    def minibatches(
        self, order: np.ndarray, size: int, normalize_advantage: bool
    ) -> Iterator[MiniBatch]:
        """Yield one epoch's minibatches: ``order`` (N,) cut into pieces of ``size``."""
        inputs, actions, log_probs = self.inputs[order], self.actions[order], self.log_probs[order]
        all_advantages, returns = self.advantages[order], self.returns[order]
        for start in range(0, len(order), size):
            rows = slice(start, start + size)
            advantages = all_advantages[rows]
            if normalize_advantage and len(advantages) > 1:
                advantages = (advantages - advantages.mean()) / (advantages.std(ddof=1) + 1e-8)
            yield MiniBatch(inputs[rows], actions[rows], log_probs[rows], advantages, returns[rows])


def store(buffer: RolloutBuffer, step: int, **rows: Any) -> None:
    """Put one step into a rollout buffer: its arrays' rows by name, e.g. ``values`` (E,).

    ``RolloutBuffer.add`` copies tensors; writing plain arrays into its rows is several times
    faster. Dictionaries of observations go through ``add``.
    """
    if isinstance(rows["observations"], dict):
        tensors = (th.from_numpy(rows[name]) for name in ("values", "log_probs"))
        names = ("observations", "actions", "rewards", "episode_starts")
        buffer.add(*(rows[name] for name in names), *tensors)
        return
    for name, row in rows.items():
        into = getattr(buffer, name)[step]
        into[...] = np.reshape(row, into.shape)
    buffer.pos = step + 1
    buffer.full = buffer.pos == buffer.buffer_size


def flatten(buffer: RolloutBuffer, fast: FlatActorCritic) -> FlatRollout:
    """Return a full rollout buffer (T, E, ...) as one flat rollout."""
    flat = buffer.swap_and_flatten
    return FlatRollout(
        fast.normalize(flat(buffer.observations)),
        flat(buffer.actions),
        flat(buffer.log_probs)[:, 0],
        flat(buffer.advantages)[:, 0],
        flat(buffer.returns)[:, 0],
    )


def summary(
    losses: Sequence[Losses], log_std: np.ndarray, ent_coef: float, vf_coef: float
) -> dict[str, float]:
    """Return what stable-baselines3's PPO logs of an update, under its names."""
    means = {
        name: float(np.mean([getattr(loss, name) for loss in losses]))
        for name in Losses.__dataclass_fields__
    }
    entropy = float(log_std.sum() + len(log_std) * (0.5 + 0.5 * np.log(2 * np.pi)))
    return {
        "entropy_loss": -entropy,
        "policy_gradient_loss": means["policy"],
        "value_loss": means["value"],
        "approx_kl": means["approx_kl"],
        "clip_fraction": means["clip_fraction"],
        "loss": losses[-1].policy - ent_coef * entropy + vf_coef * losses[-1].value,
        "std": float(np.exp(log_std).mean()),
    }
