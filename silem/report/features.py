"""Names of the skeletal features, for figures and tables."""

from __future__ import annotations

from typing import NamedTuple

from silem import bodies
from silem.bodies import BulletBody
from silem.motion.features import FEATURES

_TORSO = (
    "height above start", "bearing, sine", "bearing, cosine", "forward velocity",
    "sideways velocity", "vertical velocity", "roll", "pitch",
)  # fmt: skip
_PARTS = {"b": "back ", "f": "front "}


class Group(NamedTuple):
    """Features that belong together, "left hand" for instance, and are measured in one unit."""

    name: str
    unit: str
    """"" for directions; with a factor where the feature is scaled."""
    columns: tuple[int, ...]
    """Which features, as indices into `feature_names`."""
    labels: tuple[str, ...]
    """What tells them apart within the group, e.g. x, y, z."""


def feature_names(body: str) -> list[str]:
    """Name a body's skeletal features, in their order.

    A PyBullet body's are its observation (g is the identity, see
    `silem.envs.bullet.LocomotionTask`), a humanoid's `silem.motion.features.FEATURES`.
    """
    if not isinstance(bodies.get(body), BulletBody):
        return [feature.label for feature in FEATURES]
    torso, *parts = feature_groups(body)
    names = dict(enumerate(torso.labels))
    for group in parts:
        kind = group.name.rpartition(" ")[2]
        labels = (f"{label} {kind}" for label in group.labels)
        names |= dict(zip(group.columns, labels, strict=True))
    return [names[column] for column in sorted(names)]


def feature_groups(body: str) -> list[Group]:
    """Sort a body's features into groups: a runner's torso, angles, velocities and contacts."""
    known = bodies.get(body)
    if not isinstance(known, BulletBody):
        return _humanoid_groups()
    joints = tuple(_readable(motor.joint, known.family) for motor in known.motors)
    feet = tuple(_readable(foot, known.family) for foot in known.feet)
    first, last = len(_TORSO), len(_TORSO) + 2 * len(joints)
    return [
        Group("torso", "m; 0.3 × m/s; rad", tuple(range(first)), _TORSO),
        Group("joint angle", "−1, 1: its limits", tuple(range(first, last, 2)), joints),
        Group("joint velocity", "0.1 × rad/s", tuple(range(first + 1, last, 2)), joints),
        Group("floor contact", "", tuple(range(last, last + len(feet))), feet),
    ]


def _humanoid_groups() -> list[Group]:
    """Return the limbs' positions, elbows, knees, head, torso's vertical and velocity."""
    members: dict[tuple[str, str], list[tuple[int, str]]] = {}
    for column, feature in enumerate(FEATURES):
        first, _, last = feature.label.rpartition(" ")
        if last in ("elbow", "knee"):  # left and right stand side by side
            first, last = last, first
        members.setdefault((first, feature.unit), []).append((column, last))
    return [
        Group(name, unit, *(tuple(part) for part in zip(*entries, strict=True)))
        for (name, unit), entries in members.items()
    ]


def _readable(name: str, family: str) -> str:
    """Spell HalfCheetah's short names out: ``bthigh`` is the back thigh."""
    if family == "halfcheetah" and name[0] in _PARTS:
        return _PARTS[name[0]] + name[1:]
    return name.replace("_", " ")
