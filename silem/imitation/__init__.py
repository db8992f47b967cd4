"""Adversarial imitation from observation: SILEM and its ablations (Algorithm 1)."""

from silem.imitation.silem import SILEM

__all__ = ["SILEM"]
