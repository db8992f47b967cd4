"""The registry of bodies: `get`, `names`, `register`, and `describe` for what they are made of."""

from __future__ import annotations

from silem.bodies import ant, half_cheetah
from silem.bodies.body import AliveRule, Body, Motor, Part
from silem.bodies.describe import describe
from silem.bodies.registry import get, names, register

__all__ = ["AliveRule", "Body", "Motor", "Part", "describe", "get", "names", "register"]

for _body in (*half_cheetah.BODIES, *ant.BODIES):
    register(_body)
