"""Adversarial imitation from observation: SILEM, its ablations and TPIL."""

from silem.imitation.silem import SILEM
from silem.imitation.tpil import TPIL

__all__ = ["SILEM", "TPIL"]
