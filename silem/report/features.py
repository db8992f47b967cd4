"""Names of the skeletal features, for figures and tables."""

from __future__ import annotations

from silem import bodies

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


def feature_names(body: str) -> list[str]:
    """Name a PyBullet body's skeletal features, which are its observation (g is the identity).

    Args:
        body: The body's name.

    Returns:
        F names, in the order of the observation (`silem.envs.tasks.LocomotionTask`): the torso's,
        then each motor's angle and velocity, then the feet's contacts.

    Raises:
        SilemError: If the body is unknown.
    """
    known = bodies.get(body)
    joints = [_readable(motor.joint, known.family) for motor in known.motors]
    motion = [f"{joint} {quantity}" for joint in joints for quantity in ("angle", "velocity")]
    feet = [f"{_readable(foot, known.family)} contact" for foot in known.feet]
    return [*_TORSO, *motion, *feet]


def _readable(name: str, family: str) -> str:
    """Spell HalfCheetah's short names out: ``bthigh`` is the back thigh."""
    if family == "halfcheetah" and name[0] in _PARTS:
        return _PARTS[name[0]] + name[1:]
    return name.replace("_", " ")
