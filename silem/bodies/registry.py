"""One name, one body."""

from __future__ import annotations

from typing import TypeVar

from silem.bodies.body import Body
from silem.util.errors import SilemError, choose

Kind = TypeVar("Kind", bound=Body)

_BODIES: dict[str, Body] = {}


def register(body: Body) -> Body:
    """Add a body to the registry and return it.

    Raises:
        SilemError: If the name is taken.
    """
    if body.name in _BODIES:
        raise SilemError(f"body {body.name!r} is already registered")
    _BODIES[body.name] = body
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
