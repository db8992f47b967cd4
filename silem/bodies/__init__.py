"""The registry of bodies: one name, one body, built when it is asked for.

Bodies of one's own are registered by modules that are named, or by installed packages.
"""

import dataclasses
import hashlib
import importlib
import importlib.metadata
import os
import re
import sys
import warnings
from functools import cache
from types import ModuleType
from typing import Any, TypeVar

import gymnasium

from silem.bodies import ant, half_cheetah, humanoid
from silem.bodies.body import (
    MAX_STEPS,
    AliveRule,
    Body,
    BulletBody,
    GymnasiumBody,
    Motor,
    MujocoBody,
    Part,
    Skeleton,
    View,
)
from silem.util.errors import SilemError, check_name, choose

__all__ = [
    "AliveRule", "Body", "BulletBody", "GymnasiumBody", "Motor", "MujocoBody", "Part",
    "Skeleton", "View", "describe", "exists", "get", "identity", "load", "load_installed",
    "names", "of_kind", "register",
]  # fmt: skip

Kind = TypeVar("Kind", bound=Body)


_FAMILIES = (half_cheetah, ant, humanoid)
_NUMBER, _SLOPE, STEEPEST_DEG = r"(\d+(?:\.\d+)?)", "-slope-", 45.0
_BODIES: dict[str, Body | ModuleType] = {}  # of one that nobody has asked for yet, its family's
_OWN: dict[str, str] = {}  # of those registered, the module that `load` was loading, or ""
_loading = ""


def _add(name: str, body: Body | ModuleType, max_steps: int = MAX_STEPS) -> None:
    """Put a body into the registry, and give it its Gymnasium id."""
    _BODIES[name] = body
    key = f"silem/{name}-v0"
    gymnasium.registry.pop(key, None)  # a body's that this one replaces
    entry_point = "silem.envs.base:SingleEnv"
    gymnasium.register(key, entry_point, max_episode_steps=max_steps, kwargs={"body": name})


for _family in _FAMILIES:
    for _name in _family.BODIES:
        _add(_name, _family)


def register(body: Body, replace: bool = False) -> Body:
    """Add a body to the registry, give it its Gymnasium id, and return it.

    Registering the same body again changes nothing. With `replace` it may take another's place.
    Raises SilemError if the name is another body's, or cannot be that of a file.
    """
    check_name("body", body.name)
    if body.name in _BODIES and not replace:
        known = get(body.name)
        if known != body or known.model_xml() != body.model_xml():
            raise SilemError(
                f"another body {body.name!r} is already registered; replace=True puts this one"
                " in its place"
            )
        return known
    _add(body.name, body, body.max_steps)
    _described.cache_clear()  # what stood on a slope may be another body now
    _OWN[body.name] = _loading
    return body


def get(name: str) -> Body:
    """Return the body of that name.

    The id of a Gymnasium environment, such as "Pendulum-v1", is the name of what that moves. Some
    names describe a body: "HC-1.25" has a torso of 1.25 m, "HC0-slope-5" runs up a floor that rises
    by 5 degrees. Each family's module says in `NAMED` which; `names` lists none of them. Raises
    SilemError if there is no such body; the message lists those there are.
    """
    if isinstance(name, str) and name not in _BODIES and re.search(r"-v\d+$", name):
        try:
            spec = gymnasium.spec(name)
        except gymnasium.error.Error as error:
            told = f"no body, and no Gymnasium environment {name!r} (one of yours needs --import)"
            raise SilemError(f"{told}: {error}") from error
        if spec.max_episode_steps is None:
            raise SilemError(f"{name} has no limit of steps; evaluation needs episodes that end")
        return GymnasiumBody(name=name, max_steps=spec.max_episode_steps)
    if isinstance(name, str) and name not in _BODIES and (described := _described(name)):
        return described
    patterns = [pattern for family in _FAMILIES for pattern in family.NAMED]
    found = _BODIES[choose("body", name, [*_BODIES, *patterns, f"BODY{_SLOPE}#"])]
    if isinstance(found, ModuleType):
        found = _BODIES[name] = found.BODIES[name]()
    return found


@cache
def _described(name: str) -> Body | None:
    """Return the body that a name describes, of a known kind and its numbers, or None."""
    found = None
    for family in _FAMILIES:
        for pattern, make in family.NAMED.items():
            match = re.fullmatch(pattern.replace("#", _NUMBER), name)
            if match and all(f"{float(text):g}" == text != "0" for text in match.groups()):
                found = make(name, *map(float, match.groups()))
    base, _, text = name.rpartition(_SLOPE)
    if base and re.fullmatch(_NUMBER, text) and f"{float(text):g}" == text:
        flat = get(base)
        if flat.engine == "gymnasium" or flat.slope_deg or not 0 < float(text) <= STEEPEST_DEG:
            raise SilemError(f"no {name!r}: a slope has up to {STEEPEST_DEG:g} degrees, above 0")
        about = f"{flat.description}, on a floor that rises by {text} degrees"
        found = dataclasses.replace(flat, name=name, description=about, slope_deg=float(text))
    return found


def exists(name: str) -> bool:
    """Tell whether a body is registered, or described by its name; Gymnasium's are neither."""
    return name in _BODIES or _described(name) is not None


def of_kind(body: Body | str, kind: type[Kind]) -> Kind:
    """Return a body, given itself or its name, as a `BulletBody` or a `MujocoBody`.

    Raises SilemError if there is no such body, or another simulator steps it.
    """
    found = get(body) if isinstance(body, str) else body
    if not isinstance(found, kind):
        wanted = kind.__name__.removesuffix("Body").lower()
        raise SilemError(f"body {found.name!r} is simulated by {found.engine}, not by {wanted}")
    return found


def names(family: str | None = None) -> list[str]:
    """Return the names of all bodies, or of a known family's, in the paper's order."""
    known = {n: b.family if isinstance(b, Body) else b.FAMILY for n, b in _BODIES.items()}
    if family is not None:
        choose("family", family, dict.fromkeys(known.values()))
    return [name for name in known if family in (None, known[name])]


def describe(body: Body | str) -> dict[str, Any]:
    """Return a body's lengths, masses, joints and actuators, as its simulator has them.

    Returns:
        `name`, `family`, `description`; `lengths_m`: each capsule's length between the centres
        of its caps and each sphere's radius, by the name of its geom; `masses_kg` by link,
        massless links left out; `total_mass_kg`; `joints`: lower and upper limit in rad of each
        hinge, None where the model sets none; `root_joints`: those along which a planar root moves;
        `actuators`: torque in N m at action 1, by joint.

    Raises SilemError if there is no such body.
    """
    from silem.bodies import measure  # which needs the simulators

    return measure.describe(get(body) if isinstance(body, str) else body)


def load(module: str) -> None:
    """Import a module that registers bodies of one's own, looked for in the working folder too.

    Raises SilemError: it cannot be imported, whatever the reason.
    """
    global _loading
    if (here := os.getcwd()) not in sys.path:
        sys.path.insert(0, here)  # as `python -m` has it; a console script has not
    _loading = module
    try:
        importlib.import_module(module)
    except Exception as error:  # a stranger's module may raise anything
        raise SilemError(f"cannot import {module}: {type(error).__name__}: {error}") from error
    finally:
        _loading = ""


def load_installed() -> None:
    """Load the bodies of installed packages: their entry points in the group ``silem.bodies``.

    An entry point names a module, whose import registers them, or a function, which is called. One
    that fails is told of in a warning; the others are loaded nevertheless.
    """
    for point in importlib.metadata.entry_points(group="silem.bodies"):
        try:
            found = point.load()
            if callable(found):
                found()
        except Exception as error:
            problem = f"{type(error).__name__}: {error}"
            warnings.warn(f"the bodies of {point.value} are left out: {problem}", stacklevel=2)


def identity(name: str) -> dict[str, str] | None:
    """Return what tells a body of one's own from others of its name, or None for any other body.

    That is a hash of it, and the `module` whose `load` registered it, or "".
    """
    if name not in _OWN:
        return None
    body = get(name)
    told = {
        field.name: getattr(body, field.name) for field in dataclasses.fields(body) if field.repr
    }
    del told["description"]
    if not body.slope_deg:
        del told["slope_deg"]  # so that bodies on flat floors are what they were
    digest = hashlib.sha256(f"{told}\n{body.model_xml()}".encode()).hexdigest()
    return {"module": _OWN[name], "sha256": digest}
