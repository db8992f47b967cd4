"""Names of the skeletal features, for figures and tables."""

from __future__ import annotations

from typing import NamedTuple

from silem import bodies
from silem.bodies import Body, BulletBody
from silem.motion.features import FEATURES

_TORSO = (
    "height above start",
    "bearing, sine",
    "bearing, cosine",
    "forward velocity",
    "sideways velocity",
    "vertical velocity",
    "roll",
    "pitch",
)
_PARTS = {"b": "back ", "f": "front "}


class Group(NamedTuple):
    """Features that belong together and are measured in one unit.

    Attributes:
        name: What they are, e.g. "left hand".
        unit: Their unit, "" for directions, and a factor where the feature is scaled.
        columns: Which features, as indices into `feature_names`.
        labels: What tells them apart within the group, e.g. x, y, z.
    """

    name: str
    unit: str
    columns: tuple[int, ...]
    labels: tuple[str, ...]


def feature_names(body: str) -> list[str]:
    """Name a body's skeletal features, in their order.

    A PyBullet body's are its observation (g is the identity, see
    `silem.envs.bullet.task.LocomotionTask`): the torso's, then each motor's angle and velocity,
    then the feet's contacts. A humanoid's are
    `silem.motion.features.FEATURES`.

    Args:
        body: The body's name.

    Returns:
        F names.

    Raises:
        SilemError: If the body is unknown.
    """
    known = bodies.get(body)
    if not isinstance(known, BulletBody):
        return [feature.label for feature in FEATURES]
    joints = [_readable(motor.joint, known.family) for motor in known.motors]
    motion = [f"{joint} {quantity}" for joint in joints for quantity in ("angle", "velocity")]
    feet = [f"{_readable(foot, known.family)} contact" for foot in known.feet]
    return [*_TORSO, *motion, *feet]


def feature_groups(body: str) -> list[Group]:
    """Sort a body's skeletal features into groups, each with its unit.

    Args:
        body: The body's name.

    Raises:
        SilemError: If the body is unknown.
    """
    known = bodies.get(body)
    return _runner_groups(known) if isinstance(known, BulletBody) else _humanoid_groups()


def _runner_groups(body: Body) -> list[Group]:
    """Return torso, joint angles, joint velocities and floor contacts."""
    names = feature_names(body.name)
    kinds = (
        ("joint angle", "−1, 1: its limits", " angle"),
        ("joint velocity", "0.1 × rad/s", " velocity"),
        ("floor contact", "", " contact"),
    )
    n_torso = len(_TORSO)
    torso = Group("torso", "m; 0.3 × m/s; rad", tuple(range(n_torso)), _TORSO)
    groups = [torso]
    for kind, unit, end in kinds:
        columns = [i for i in range(n_torso, len(names)) if names[i].endswith(end)]
        labels = [names[i].removesuffix(end) for i in columns]
        groups.append(Group(kind, unit, tuple(columns), tuple(labels)))
    return groups


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
