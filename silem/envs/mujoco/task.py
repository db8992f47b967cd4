"""The walking task of the humanoids: observation and reward of dm_control's `humanoid walk`.

Everything is computed for a batch of environments at once. The only change to dm_control's task
is the speed that earns the full reward: the demonstrator's, which the paper's reward asks to be
matched (Figure 3b), in place of 1 m/s.
"""

from __future__ import annotations

from typing import NamedTuple

import gymnasium
import numpy as np

from silem.bodies import MujocoBody
from silem.motion.features import FEATURES, POINTS, skeletal_features
from silem.util.errors import SilemError

_UPRIGHT_FROM = 0.9  # cosine of the torso's tilt
_UPRIGHT_MARGIN = 1.9
_LOG_MARGIN_VALUE = np.log(0.1)  # dm_control's default value of its Gaussian at the margin
_FEATURE_NAMES = [feature.name for feature in FEATURES]
_OBSERVED = np.array(
    [_FEATURE_NAMES.index("head_height")]
    + [
        _FEATURE_NAMES.index(f"{vector}_{axis}")
        for vector in ("left_hand", "left_foot", "right_hand", "right_foot", "torso_vertical")
        for axis in "xyz"
    ]
)
_HEAD = POINTS.index("head")


class Reading(NamedTuple):
    """What a simulation of E bodies holds after a step.

    Attributes:
        qpos: Positions of all joints, (E, nq): free root (position, quaternion), hinges in rad.
        qvel: Their velocities, (E, nv).
        points: Landmarks in the world in m, (E, P, 3).
        torso_axes: Forward, left and up of the torso in the world, as rows, (E, 3, 3).
        com_velocity: Of the centre of mass, in the world in m/s, (E, 3).
    """

    qpos: np.ndarray
    qvel: np.ndarray
    points: np.ndarray
    torso_axes: np.ndarray
    com_velocity: np.ndarray

    @property
    def head_m(self) -> np.ndarray:
        """Height of the head, (E,)."""
        return self.points[:, _HEAD, 2]

    def joined(self, other: Reading) -> Reading:
        """Return this reading's states and, after them, another's."""
        return Reading(*map(np.concatenate, zip(self, other, strict=True)))

    def features(self) -> np.ndarray:
        """Return the skeletal features (E, F), float32."""
        return skeletal_features(self.points, self.torso_axes, self.com_velocity)


def observation_space(body: MujocoBody) -> gymnasium.spaces.Box:
    """Return the space of observations (O,): see `observe`."""
    n_hinges = body.action_size
    size = n_hinges + len(_OBSERVED) + 3 + 6 + n_hinges
    return gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float32)


def target_speed(body: MujocoBody, speed_m_s: float | None) -> float:
    """Return the speed wanted, for None the body's; raises SilemError if it is not above 0."""
    speed_m_s = body.target_speed_m_s if speed_m_s is None else speed_m_s
    if not speed_m_s > 0:
        raise SilemError(f"speed of {speed_m_s} m/s; allowed: above 0")
    return speed_m_s


def observe(reading: Reading, features: np.ndarray) -> np.ndarray:
    """Return dm_control's observation of a humanoid, (E, O) float32.

    In order: hinges in rad; height of the head in m; left hand, left foot, right hand, right foot
    relative to the torso, in its frame, in m; the vertical in the torso's frame; velocity of the
    centre of mass in the world in m/s; velocity of all joints. `features` are g(s), (E, F).
    """
    parts = (reading.qpos[:, 7:], features.take(_OBSERVED, 1), reading.com_velocity, reading.qvel)
    return np.concatenate(parts, axis=1, dtype=np.float32)


def rewards(
    reading: Reading, actions: np.ndarray, standing_head_m: float, speed_m_s: float
) -> np.ndarray:
    """Return dm_control's reward for walking, (E,), each from 0 to 1.

    The product of standing (head up and torso upright), small control, and speed of the centre
    of mass in any horizontal direction.

    Args:
        reading: State after the step.
        actions: (E, A), clipped to -1..1.
        standing_head_m: Head height from which a body counts as standing.
        speed_m_s: Speed that earns the full reward.
    """
    # tolerance() with a Gaussian that falls to 0.1 a margin below the bound
    below = np.maximum(standing_head_m - reading.head_m, 0.0) / (standing_head_m / 4)
    standing = np.exp(_LOG_MARGIN_VALUE * np.square(below))
    short = np.maximum(_UPRIGHT_FROM - reading.torso_axes[:, 2, 2], 0.0)
    upright = np.maximum(1.0 - short / _UPRIGHT_MARGIN, 0.0)
    saved = np.add.reduce(1.0 - np.square(actions), 1)
    small_control = (4.0 + saved / actions.shape[1]) / 5.0
    speed = np.sqrt(np.add.reduce(np.square(reading.com_velocity[:, :2]), 1))
    move = (5.0 * np.minimum(speed / speed_m_s, 1.0) + 1.0) / 6.0
    return small_control * standing * upright * move
