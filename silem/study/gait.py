"""How a runner moves, measured on its features: pitch, joints at their limits, failures."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from silem import bodies
from silem.bodies import BulletBody
from silem.motion.demonstrations import Demonstrations
from silem.util.errors import SilemError

AT_LIMIT = 0.99
"""|scaled angle| beyond which a joint is at its limit, as `silem.envs.bullet.task` charges it."""

_FORWARD, _PITCH, _FIRST_ANGLE = 3, 7, 8  # columns of `silem.envs.bullet.task.LocomotionTask`
_VELOCITY_SCALE = 0.3  # of the forward velocity, likewise


class Gait(NamedTuple):
    """What the manifest says of an expert's demonstrations beside their mean return.

    A failed episode returns less than half of what the median episode does. None is left out.
    """

    speed_m_s: float
    pitch_rad: float  # mean over all states; positive is nose down
    pitch_std_rad: float
    limit_share: float  # of the states, those with any joint at its limit
    joints_at_limit: float  # mean number of joints at their limits, which the task charges
    return_worst: float | None  # None where the returns are unknown
    n_failed: int | None


def pitch_rad(features: np.ndarray) -> np.ndarray:
    """Return the torso's pitch of every state, (..., F) to (...); positive is nose down."""
    return np.asarray(features[..., _PITCH], dtype=np.float64)


def joints_at_limit(features: np.ndarray, body: str) -> np.ndarray:
    """Count the joints at their limits in every state, (..., F) to (...).

    Raises:
        SilemError: The body is no runner, or has another number of features.
    """
    found = bodies.get(body)
    if not isinstance(found, BulletBody):
        raise SilemError(f"a gait is measured on HalfCheetahs and Ants, not on {body}")
    n_joints = len(found.motors)
    n_features = _FIRST_ANGLE + 2 * n_joints + len(found.feet)
    if features.shape[-1] != n_features:
        raise SilemError(f"{features.shape[-1]} features, {body} has {n_features}")
    angles = features[..., _FIRST_ANGLE : _FIRST_ANGLE + 2 * n_joints : 2]
    return np.asarray((np.abs(angles) > AT_LIMIT).sum(axis=-1))


def failed(returns: np.ndarray) -> np.ndarray:
    """Tell of every episode, (N,), whether it returns less than half of what the median does."""
    median = float(np.median(returns))
    return np.asarray(returns < median - abs(median) / 2)


def measure(demonstrations: Demonstrations) -> Gait:
    """Measure the gait of a runner's demonstrations over all of their states.

    Raises:
        SilemError: They are no runner's.
    """
    states = np.concatenate(demonstrations.features)
    at_limits = joints_at_limit(states, demonstrations.body)
    pitch = pitch_rad(states)
    returns = np.array(demonstrations.returns)
    return Gait(
        speed_m_s=float(states[:, _FORWARD].mean(dtype=np.float64)) / _VELOCITY_SCALE,
        pitch_rad=float(pitch.mean()),
        pitch_std_rad=float(pitch.std()),
        limit_share=float((at_limits > 0).mean()),
        joints_at_limit=float(at_limits.mean()),
        return_worst=float(returns.min()) if len(returns) else None,
        n_failed=int(failed(returns).sum()) if len(returns) else None,
    )
