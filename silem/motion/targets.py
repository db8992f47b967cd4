"""Where a demonstrator's motion puts the torso, hands and feet of a learner with other limbs.

The baseline Peng20 (Peng et al. 2020, "Learning Agile Robotic Locomotion Skills by Imitating
Animals") matches key points after scaling them to the learner. Here:

* Hips and feet: one similarity transform of the demonstrator's world, by the ratio of the leg
  lengths. So the foot relative to the hip, the root's height and the root's forward motion are
  all scaled alike. Keeping the forward motion instead would drag every planted foot over the
  floor at (1 - ratio) times the walking speed. What widens or narrows the hips shifts each foot
  sideways by a constant.
* Torso: the vector from the middle of the hips, by the ratio of the spines; the orientation as
  it is.
* Hands: the vector from the shoulder, by the ratio of that arm's lengths.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from silem.motion.demonstrator import Motion
from silem.motion.features import POINTS
from silem.util.errors import SilemError

TARGETS = ("torso", "left_hand", "right_hand", "left_foot", "right_foot")
"""The targets of the inverse kinematics, each a landmark."""

SIDES = ("left", "right")
STANCE_SPEED_M_S = 0.3
"""A demonstrator's foot slower than this, horizontally, stands. (In 08_01 a standing foot moves
at up to 0.2 m/s, a swinging one at up to 4.7 m/s.)"""

_HORIZONTAL, _UP = np.array([1.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])


class Limbs(NamedTuple):
    """Lengths between a skeleton's landmarks in m, or ratios of two skeletons' lengths.

    Attributes:
        leg: Hip to knee to foot, mean of both sides.
        left_arm: Shoulder to elbow to hand.
        right_arm: Shoulder to elbow to hand.
        spine: Middle of the hips to torso.
        hips: Left hip to right hip.
    """

    leg: float
    left_arm: float
    right_arm: float
    spine: float
    hips: float

    @classmethod
    def of(cls, points: np.ndarray) -> Limbs:
        """Measure the landmarks of one or more poses, (..., P, 3).

        Of several poses the 95 % quantile counts: where a landmark lies beside its joint's axis
        a bent limb looks shorter than it is, and a single broken frame should not matter.
        """
        left_leg, right_leg = (
            _length(points, f"{side}_hip", f"{side}_knee", f"{side}_foot") for side in SIDES
        )
        left_arm, right_arm = (
            _length(points, f"{side}_shoulder", f"{side}_elbow", f"{side}_hand") for side in SIDES
        )
        spine = _usual(np.linalg.norm(_at(points, "torso") - _mid_hip(points), axis=-1))
        hips = _length(points, "left_hip", "right_hip")
        return cls((left_leg + right_leg) / 2, left_arm, right_arm, spine, hips)

    def over(self, other: Limbs) -> Limbs:
        """Return the ratios of these lengths to another skeleton's."""
        return Limbs(*(mine / theirs for mine, theirs in zip(self, other, strict=True)))


@dataclass(frozen=True)
class Targets:
    """What the inverse kinematics has to reach.

    Attributes:
        positions: (T, 5, 3) in the world in m, in the order of `TARGETS`; floor at z = 0, the
            walk starts above the origin.
        torso_axes: (T, 3, 3) forward, left and up of the torso in the world, as rows.
        stance: (T, 2) whether the demonstrator's left and right foot stands.
        ratios: The learner's limbs over the demonstrator's.
        raised_m: (T, 2) by how much a foot's target was raised, because the scaled motion would
            have put it lower than it is on the standing learner.
    """

    positions: np.ndarray
    torso_axes: np.ndarray
    stance: np.ndarray
    ratios: Limbs
    raised_m: np.ndarray


def targets(
    motion: Motion, points: np.ndarray, torso_axes: np.ndarray, scale_limbs: bool = True
) -> Targets:
    """Scale a demonstrator's motion to a learner.

    Args:
        motion: The demonstrator's motion, T frames.
        points: (P, 3) the learner's landmarks in its standing pose, soles on the floor z = 0.
        torso_axes: (3, 3) the learner's torso in that pose: forward, left, up as rows.
        scale_limbs: Whether to scale; without it the demonstrator's own lengths are asked of the
            learner (the negative control).

    Raises:
        SilemError: The motion holds NaN or infinity.
    """
    _check(motion)
    demonstrator, learner = Limbs.of(motion.points), Limbs.of(points)
    ratios = learner.over(demonstrator) if scale_limbs else Limbs(1, 1, 1, 1, 1)
    stance = standing_feet(motion)
    foot_height = float(np.mean([_at(points, f"{side}_foot")[2] for side in SIDES]))
    ground = _ground(motion, stance)
    start = _mid_hip(motion.points)[0] * _HORIZONTAL

    def moved(world: np.ndarray, ground_m: float) -> np.ndarray:
        return ratios.leg * (world - start - ground_m * _UP) + foot_height * _UP

    spine = _at(motion.points, "torso") - _mid_hip(motion.points)
    torso = moved(_mid_hip(motion.points), sum(ground) / 2) + ratios.spine * spine
    hands = [
        torso
        + torso_axes @ (_at(points, f"{side}_shoulder") - points[0]) @ motion.torso_axes
        + ratio * (_at(motion.points, f"{side}_hand") - _at(motion.points, f"{side}_shoulder"))
        for side, ratio in zip(SIDES, (ratios.left_arm, ratios.right_arm), strict=True)
    ]
    wider = (learner.hips - ratios.leg * demonstrator.hips) / 2 * _leftward(motion.torso_axes)
    feet = [
        moved(_at(motion.points, f"{side}_foot"), height) + sign * wider
        for side, height, sign in zip(SIDES, ground, (1, -1), strict=True)
    ]
    raised = np.maximum(foot_height - np.stack(feet, axis=1)[..., 2], 0)
    positions = np.stack([torso, *hands, *feet], axis=1)
    positions[:, 3:, 2] += raised
    return Targets(positions, motion.torso_axes, stance, ratios, raised)


def standing_feet(motion: Motion) -> np.ndarray:
    """Return whether the demonstrator's left and right foot stands in each frame, (T, 2)."""
    return foot_speeds_m_s(motion.points, motion.rate_hz) < STANCE_SPEED_M_S


def foot_speeds_m_s(points: np.ndarray, rate_hz: float) -> np.ndarray:
    """Return how fast the left and the right foot move horizontally, (T, 2), of landmarks in m.

    Args:
        points: (T, P, 3) landmarks in the world in m.
        rate_hz: Frames per second.
    """
    velocity = np.gradient(_feet(points)[..., :2], 1 / rate_hz, axis=0)
    return np.linalg.norm(velocity, axis=-1)


def _ground(motion: Motion, stance: np.ndarray) -> list[float]:
    """Return how high the landmark of the left and of the right foot is when that foot stands.

    It is the median, and targets below it are raised to it: in the clips a foot that stands sinks
    and rises by 1 cm or 2, and on the learner it should be on the floor, not above it.
    """
    return [
        float(np.median(heights[stands]) if stands.any() else heights.min())
        for heights, stands in zip(_feet(motion.points)[..., 2].T, stance.T, strict=True)
    ]


def _feet(points: np.ndarray) -> np.ndarray:
    return np.stack([_at(points, f"{side}_foot") for side in SIDES], axis=1)


def _leftward(torso_axes: np.ndarray) -> np.ndarray:
    """Return the walk's horizontal direction to the left, (3,)."""
    left = torso_axes[:, 1].mean(axis=0) * _HORIZONTAL
    return left / np.linalg.norm(left)


def _at(points: np.ndarray, name: str) -> np.ndarray:
    return points[..., POINTS.index(name), :]


def _mid_hip(points: np.ndarray) -> np.ndarray:
    return (_at(points, "left_hip") + _at(points, "right_hip")) / 2


def _length(points: np.ndarray, *names: str) -> float:
    """Return the usual length along landmarks."""
    chain = np.stack([_at(points, name) for name in names])
    return _usual(np.linalg.norm(np.diff(chain, axis=0), axis=-1).sum(axis=0))


def _usual(lengths: np.ndarray) -> float:
    return float(np.quantile(lengths, 0.95))


def _check(motion: Motion) -> None:
    for name, array in (("points", motion.points), ("torso_axes", motion.torso_axes)):
        broken = ~np.isfinite(array.reshape(len(array), -1)).all(axis=1)
        if broken.any():
            frame = int(np.argmax(broken))
            raise SilemError(f"motion {motion.name}: {name} of frame {frame} hold NaN or infinity")
