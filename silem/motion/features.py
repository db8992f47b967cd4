"""Skeletal features g(s) of a humanoid: the quantities of Figures 4a and 4b.

The demonstrator and every learner have their own g, because their models name and orient their
parts differently; all compute the same quantities in the same order, from the same landmarks.
"""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from silem.bodies.body import Skeleton
from silem.util.errors import SilemError

POINTS = Skeleton.points()
"""The landmarks, the torso first."""


class Feature(NamedTuple):
    """One skeletal feature: its name, how figures call it, and its unit."""

    name: str
    label: str
    unit: str


_LIMBS = ("left_hand", "right_hand", "left_foot", "right_foot")
_JOINTS = ("left_elbow", "right_elbow", "left_knee", "right_knee")
_SEGMENTS = {"elbow": ("shoulder", "hand"), "knee": ("hip", "foot")}  # what a joint lies between
_HEAD = POINTS.index("head")


def _vectors() -> tuple[np.ndarray, np.ndarray]:
    """Return where the vectors that features are made of end and start: numbers of landmarks.

    First from the torso to each of `_LIMBS`, then from each of `_JOINTS` to one end of its limb,
    then to the other end.
    """
    pairs = [(limb, "torso") for limb in _LIMBS]
    for end in (0, 1):
        for joint in _JOINTS:
            side, name = joint.split("_")
            pairs.append((f"{side}_{_SEGMENTS[name][end]}", joint))
    ends, starts = np.array([[POINTS.index(name) for name in pair] for pair in pairs]).T
    return ends, starts


_ENDS, _STARTS = _vectors()


def _features() -> tuple[Feature, ...]:
    limbs = [
        Feature(f"{limb}_{axis}", f"{limb.replace('_', ' ')} {axis}", "m")
        for limb in _LIMBS
        for axis in "xyz"
    ]
    joints = [Feature(joint, joint.replace("_", " "), "rad") for joint in _JOINTS]
    head = Feature("head_height", "head height", "m")
    up = [Feature(f"torso_vertical_{axis}", f"torso vertical {axis}", "") for axis in "xyz"]
    velocity = [Feature(f"com_velocity_{axis}", f"velocity {axis}", "m/s") for axis in "xyz"]
    return (*limbs, *joints, head, *up, *velocity)


FEATURES = _features()
"""The F = 23 features, in order. Positions, the vertical and the velocity of the centre of mass
are in the torso's frame (x forward, y left, z up); an elbow's or knee's angle is the one between
the two segments that meet there, pi when the limb is straight."""


class Landmarks:
    """Where a model's landmarks are found in its data.

    Attributes:
        ids: (P,) numbers of the MuJoCo bodies, in the order of `POINTS`.
        root: Number of the body that carries all others.

    Raises:
        SilemError: If the model lacks one of the skeleton's bodies.
    """

    def __init__(self, model: mujoco.MjModel, skeleton: Skeleton) -> None:
        names = [getattr(skeleton, point) for point in POINTS]
        found = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) for name in names]
        missing = [name for name, index in zip(names, found, strict=True) if index < 0]
        if missing:
            raise SilemError(f"the model has no body {', '.join(missing)} that its skeleton names")
        self.ids = np.array(found)
        self.torso = found[0]
        self.root = int(model.body_rootid[self.torso])
        self._axes = np.array(["xyz".index(axis) for axis in skeleton.axes])

    def points(self, data: mujoco.MjData) -> np.ndarray:
        """Return the landmarks' positions in the world in m, (P, 3)."""
        return data.xpos[self.ids]

    def torso_axes(self, data: mujoco.MjData) -> np.ndarray:
        """Return the directions forward, left and up of the torso in the world, as rows (3, 3)."""
        return self.oriented(data.xmat[self.torso])

    def oriented(self, matrices: np.ndarray) -> np.ndarray:
        """Return torso frames (..., 9), as MuJoCo has them, as rows, forward first, (..., 3, 3)."""
        frames = matrices.reshape(*matrices.shape[:-1], 3, 3)
        return frames.swapaxes(-1, -2).take(self._axes, -2)


def skeletal_features(
    points: np.ndarray, torso_axes: np.ndarray, com_velocity: np.ndarray
) -> np.ndarray:
    """Compute g(s) from what a body's own g read off its state.

    Args:
        points: Landmarks in the world in m, (..., P, 3), in the order of `POINTS`.
        torso_axes: Forward, left and up of the torso in the world, as rows, (..., 3, 3).
        com_velocity: Velocity of the whole body's centre of mass in the world in m/s, (..., 3).

    Returns:
        The features (..., F), float32, in the order of `FEATURES`.
    """
    rows = torso_axes.swapaxes(-1, -2)
    vectors = points.take(_ENDS, -2) - points.take(_STARTS, -2)
    offsets = vectors[..., :4, :]
    parts = (
        (offsets @ rows).reshape(*offsets.shape[:-2], 12),
        _angles(vectors[..., 4:, :]),
        points[..., _HEAD, 2:],
        torso_axes[..., 2],
        (com_velocity[..., None, :] @ rows)[..., 0, :],
    )
    return np.concatenate(parts, axis=-1, dtype=np.float32)


def g(model: mujoco.MjModel, data: mujoco.MjData, landmarks: Landmarks) -> np.ndarray:
    """Return the features (F,) of one state; its positions and velocities must be up to date."""
    mujoco.mj_subtreeVel(model, data)
    velocity = data.subtree_linvel[landmarks.root]
    return skeletal_features(landmarks.points(data), landmarks.torso_axes(data), velocity)


def _angles(segments: np.ndarray) -> np.ndarray:
    """Return the angles in rad (..., N) between N vectors and the next N, of (..., 2 N, 3)."""
    n = segments.shape[-2] // 2
    lengths = np.sqrt(np.add.reduce(segments * segments, -1))
    products = np.add.reduce(segments[..., :n, :] * segments[..., n:, :], -1)
    cosines = products / (lengths[..., :n] * lengths[..., n:])
    return np.arccos(np.minimum(np.maximum(cosines, -1.0), 1.0))
