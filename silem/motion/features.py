"""Skeletal features g(s) of a humanoid: the quantities of Figures 4a and 4b.

The demonstrator and every learner have their own g, because their models name and orient their
parts differently; all compute the same quantities in the same order, from the same landmarks.
"""

from typing import NamedTuple

import mujoco
import numpy as np

from silem.bodies.body import Skeleton
from silem.util.errors import SilemError

POINTS = Skeleton.points()  #: the landmarks, the torso first


class Feature(NamedTuple):
    """One skeletal feature."""

    name: str
    label: str  #: in figures
    unit: str


_LIMBS = ("left_hand", "right_hand", "left_foot", "right_foot")
_JOINTS = {  # and the ends of the two segments that meet there
    f"{side}_{joint}": (f"{side}_{start}", f"{side}_{end}")
    for joint, start, end in (("elbow", "shoulder", "hand"), ("knee", "hip", "foot"))
    for side in ("left", "right")
}
_HEAD = POINTS.index("head")

# Features' vectors: from the torso to each of the limbs, from each joint to one end and the other.
_PAIRS = [(limb, "torso") for limb in _LIMBS]
_PAIRS += [(ends[i], joint) for i in (0, 1) for joint, ends in _JOINTS.items()]
_ENDS, _STARTS = np.array([[POINTS.index(name) for name in pair] for pair in _PAIRS]).T


def _features() -> tuple[Feature, ...]:
    vectors = [*((limb, "m") for limb in _LIMBS), ("torso_vertical", ""), ("com_velocity", "m/s")]
    named = [(f"{name}_{axis}", unit) for name, unit in vectors for axis in "xyz"]
    named[12:12] = [*((joint, "rad") for joint in _JOINTS), ("head_height", "m")]
    return tuple(Feature(n, n.removeprefix("com_").replace("_", " "), unit) for n, unit in named)


FEATURES = _features()
"""The F = 23 features, in order. Positions, the vertical and the velocity of the centre of mass
are in the torso's frame (x forward, y left, z up); an elbow's or knee's angle is the one between
the two segments that meet there, pi when the limb is straight."""


class Landmarks:
    """Where a model's landmarks are found in its data: the numbers of its bodies.

    Raises SilemError if the model lacks one of the skeleton's bodies.
    """

    def __init__(self, model: mujoco.MjModel, skeleton: Skeleton) -> None:
        names = [getattr(skeleton, point) for point in POINTS]
        found = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) for name in names]
        missing = [name for name, index in zip(names, found, strict=True) if index < 0]
        if missing:
            raise SilemError(f"the model has no body {', '.join(missing)} that its skeleton names")
        self.ids = np.array(found)  #: (P,) in the order of `POINTS`
        self.torso = found[0]
        self.root = int(model.body_rootid[self.torso])  #: carries all others
        columns = ["xyz".index(axis) for axis in skeleton.axes]
        self._rows = np.arange(9).reshape(3, 3).T[columns]  # of a torso frame's nine numbers

    def oriented(self, matrices: np.ndarray) -> np.ndarray:
        """Return torso frames (..., 9), as MuJoCo has them, as rows, forward first, (..., 3, 3)."""
        return matrices.take(self._rows, -1)


def skeletal_features(
    points: np.ndarray,
    torso_axes: np.ndarray,
    com_velocity: np.ndarray,
    up: tuple[float, float, float] | None = None,
) -> np.ndarray:
    """Compute g(s), (..., F), float32, from what a body's own g read off its state.

    Args:
        points: Landmarks in the world in m, (..., P, 3), in the order of `POINTS`.
        torso_axes: Forward, left and up of the torso in the world, as rows, (..., 3, 3).
        com_velocity: Velocity of the whole body's centre of mass in the world in m/s, (..., 3).
        up: The vertical in the world; None is z.
    """
    rows = torso_axes.swapaxes(-1, -2)
    vectors = points.take(_ENDS, -2) - points.take(_STARTS, -2)
    offsets, segments = vectors[..., :4, :], vectors[..., 4:, :]
    n = segments.shape[-2] // 2  # of angles between N vectors and the next N
    lengths = np.sqrt(np.add.reduce(segments * segments, -1))
    products = np.add.reduce(segments[..., :n, :] * segments[..., n:, :], -1)
    cosines = products / (lengths[..., :n] * lengths[..., n:])
    parts = (
        (offsets @ rows).reshape(*offsets.shape[:-2], 12),
        np.arccos(np.minimum(np.maximum(cosines, -1.0), 1.0)),
        points[..., _HEAD, 2:],
        torso_axes[..., 2] if up is None else torso_axes @ np.array(up),
        (com_velocity[..., None, :] @ rows)[..., 0, :],
    )
    return np.concatenate(parts, axis=-1, dtype=np.float32)
