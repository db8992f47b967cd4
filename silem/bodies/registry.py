"""One name, one body, one Gymnasium id."""

from __future__ import annotations

from typing import TypeVar

import gymnasium

from silem.bodies.body import Body
from silem.util.errors import SilemError, choose

Kind = TypeVar("Kind", bound=Body)

_BODIES: dict[str, Body] = {}

# By name: environments are loaded when one is made.
_ENVIRONMENTS = {
    "bullet": "silem.envs.bullet.single_env:BulletEnv",
    "mujoco": "silem.envs.mujoco.single_env:MujocoEnv",
}
MAX_STEPS = 1000
"""Steps after which an episode is cut off, where nothing else is asked for."""


def register(body: Body) -> Body:
    """Add a body to the registry, register its Gymnasium id ``silem/<name>-v0``, and return it.

    Raises:
        SilemError: If the name is taken.
    """
    if body.name in _BODIES:
        raise SilemError(f"body {body.name!r} is already registered")
    _BODIES[body.name] = body
    gymnasium.register(
        f"silem/{body.name}-v0",
        entry_point=_ENVIRONMENTS[body.engine],
        max_episode_steps=MAX_STEPS,
        kwargs={"body": body.name},
    )
    return body


def get(name: str) -> Body:
    """Return the body of that name.

    Raises:
        SilemError: If there is no such body; the message lists those there are.
    """
    return _BODIES[choose("body", name, _BODIES)]


def of_kind(body: Body | str, kind: type[Kind]) -> Kind:
    """Return a body, given itself or its name, as one of a simulator's kind.

    Args:
        body: A body or its name.
        kind: `BulletBody` or `MujocoBody`.

    Raises:
        SilemError: If there is no such body, or another simulator steps it.
    """
    found = get(body) if isinstance(body, str) else body
    if not isinstance(found, kind):
        wanted = kind.__name__.removesuffix("Body").lower()
        raise SilemError(f"body {found.name!r} is simulated by {found.engine}, not by {wanted}")
    return found


def names(family: str | None = None) -> list[str]:
    """Return the names of all bodies, or of one family's, in the paper's order.

    Raises:
        SilemError: If there is no such family.
    """
    if family is not None:
        choose("family", family, dict.fromkeys(body.family for body in _BODIES.values()))
    return [name for name, body in _BODIES.items() if family in (None, body.family)]
