"""Adversarial imitation from observation on PPO: SILEM, its ablations and TPIL."""

from silem.algorithms.ppo import PPO
from silem.algorithms.silem import SILEM
from silem.algorithms.tpil import TPIL

__all__ = ["PPO", "SILEM", "TPIL"]
