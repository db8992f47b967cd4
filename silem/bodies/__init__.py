
from __future__ import annotations

from silem.bodies import ant, half_cheetah
from silem.bodies.body import AliveRule, Body, Motor
from silem.bodies.registry import get, names, register


for _body in (*half_cheetah.BODIES, *ant.BODIES):
    register(_body)
