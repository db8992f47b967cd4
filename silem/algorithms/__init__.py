"""Adversarial imitation from observation on PPO: GAIfO, SILEM and TPIL."""

from silem.algorithms.gaifo import GAIfO
from silem.algorithms.ppo import PPO
from silem.algorithms.silem import SILEM
from silem.algorithms.state import load_policy
from silem.algorithms.tpil import TPIL

__all__ = ["PPO", "SILEM", "TPIL", "GAIfO", "load_policy"]
