"""The registry of bodies: `get`, `names`, `register`, and `describe` for what they are made of."""

from __future__ import annotations

from silem.bodies import ant, atlas, half_cheetah, humanoid
from silem.bodies.body import (
    AliveRule,
    Body,
    BulletBody,
    Motor,
    MujocoBody,
    Part,
    Skeleton,
)
from silem.bodies.describe import describe
from silem.bodies.registry import get, names, of_kind, register

__all__ = [
    "AliveRule",
    "Body",
    "BulletBody",
    "Motor",
    "MujocoBody",
    "Part",
    "Skeleton",
    "describe",
    "get",
    "names",
    "of_kind",
    "register",
]

for _body in (*half_cheetah.BODIES, *ant.BODIES, *humanoid.BODIES, *atlas.BODIES):
    register(_body)
