"""The registry of bodies: one name, one body, built when it is asked for."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

from silem.bodies import ant, half_cheetah, humanoid
from silem.bodies.body import (
    MAX_STEPS,
    AliveRule,
    Body,
    BulletBody,
    Engine,
    GymnasiumBody,
    Motor,
    MujocoBody,
    Part,
    Skeleton,
    View,
)
from silem.util.errors import SilemError, choose

__all__ = [
    "AliveRule", "Body", "BulletBody", "Entry", "GymnasiumBody", "Motor", "MujocoBody", "Part",
    "Skeleton", "View", "describe", "get", "names", "of_kind", "register", "watch",
]  # fmt: skip

Kind = TypeVar("Kind", bound=Body)


class Entry(NamedTuple):
    """A body that nobody has asked for yet: what is known of it, and what builds it."""

    name: str
    family: str
    engine: Engine
    make: Callable[[], Body]
    max_steps: int = MAX_STEPS


_BODIES: dict[str, Body | Entry] = {
    name: Entry(name, family.FAMILY, family.ENGINE, make)
    for family in (half_cheetah, ant, humanoid)
    for name, make in family.BODIES.items()
}
_WATCHERS: list[Callable[[Body | Entry], None]] = []


def register(body: Body, replace: bool = False) -> Body:
    """Add a body to the registry, give it its Gymnasium id, and return it.

    Registering the same body again changes nothing.

    With `replace` it may take the place of another one of that name.

    Raises:
        SilemError: If the name is another body's, or is not fit for an id or a file.
    """
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]*", body.name):
        raise SilemError(f"body named {body.name!r}; allowed: letters, digits, _, - and .")
    if body.name in _BODIES and not replace:
        known = get(body.name)
        if known != body or known.model_xml() != body.model_xml():
            raise SilemError(
                f"another body {body.name!r} is already registered; replace=True puts this one"
                " in its place"
            )
        return known
    _BODIES[body.name] = body
    for watcher in _WATCHERS:
        watcher(body)
    return body


def watch(watcher: Callable[[Body | Entry], None]) -> None:
    """Call a function for each body that is registered, and at once for those that are."""
    _WATCHERS.append(watcher)
    for body in _BODIES.values():
        watcher(body)


def get(name: str) -> Body:
    """Return the body of that name.

    The id of a Gymnasium environment, such as "Pendulum-v1", is the name of what that moves.

    Raises:
        SilemError: If there is no such body; the message lists those there are.
    """
    if isinstance(name, str) and name not in _BODIES and re.search(r"-v\d+$", name):
        import gymnasium  # which no body of the paper needs

        try:
            spec = gymnasium.spec(name)
        except gymnasium.error.Error as error:
            raise SilemError(f"no body, and no Gymnasium environment {name!r}: {error}") from error
        if spec.max_episode_steps is None:
            raise SilemError(f"{name} has no limit of steps; evaluation needs episodes that end")
        return GymnasiumBody(name=name, max_steps=spec.max_episode_steps)
    found = _BODIES[choose("body", name, _BODIES)]
    if isinstance(found, Entry):
        found = _BODIES[name] = found.make()
    return found


def of_kind(body: Body | str, kind: type[Kind]) -> Kind:
    """Return a body, given itself or its name, as a `BulletBody` or a `MujocoBody`.

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


def describe(body: Body | str) -> dict[str, Any]:
    """Return a body's lengths, masses, joints and actuators, as its simulator has them.

    Returns:
        `name`, `family`, `description`; `lengths_m`: each capsule's length between the centres
        of its caps and each sphere's radius, by the name of its geom; `masses_kg` by link,
        massless links left out; `total_mass_kg`; `joints`: lower and upper limit in rad of each
        hinge, None where the model sets none; `root_joints`: those along which a planar root moves;
        `actuators`: torque in N m at action 1, by joint.

    Raises:
        SilemError: If there is no such body.
    """
    from silem.bodies import measure  # which needs the simulators

    return measure.describe(get(body) if isinstance(body, str) else body)
