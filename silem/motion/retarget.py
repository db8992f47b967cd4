"""Retargeting for the baseline Peng20: a demonstrator's motion on a learner's body.

`targets` scales the demonstrator's hands, feet and torso to the learner's limbs, and
`inverse_kinematics` poses the learner, frame by frame, each starting from the pose before: so the
motion is continuous. What could not be reached is reported for every frame, not hidden.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from tqdm import tqdm

from silem.bodies.body import MujocoBody
from silem.motion import poses
from silem.motion.demonstrator import Motion
from silem.motion.features import POINTS, Landmarks, g
from silem.motion.inverse_kinematics import PoseSolver
from silem.motion.soles import Soles
from silem.motion.targets import SIDES, TARGETS, Limbs, Targets, foot_speeds_m_s, targets
from silem.util.errors import SilemError

TOLERANCE_M = 0.03
"""A frame whose targets are all reached to within this counts as converged."""

LIMIT_TOLERANCE_RAD = 1e-3
"""A joint closer to a limit than this is at it."""


@dataclass(frozen=True)
class IKResult:
    """A motion retargeted to a body, with what could not be reached.

    Attributes:
        body: Name of the learner's body.
        motion: Name of the demonstrator's motion.
        rate_hz: Frames per second.
        qpos: (T, nq) positions; the walk starts above the world's origin, the floor is z = 0.
        qvel: (T, nv) velocities, central differences.
        points: (T, P, 3) landmarks in the world, in m.
        features: (T, F) skeletal features by the learner's own g.
        residuals: (T, 5) distance of each landmark from its target in m, in the order of
            `TARGETS`.
        torso_tilt_rad: (T,) angle between the torso's orientation and its target.
        converged: (T,) whether every residual is within the tolerance.
        joint_names: Names of the hinges, J.
        at_limit: (T, J) whether a hinge is at a limit.
        foot_skate_m_s: (T, 2) horizontal speed of the left and right foot while the
            demonstrator's stands; NaN while it swings.
        raised_m: (T, 2) by how much a foot's target was raised to keep the sole off the floor.
        sole_height_m: (T, 2) height of each foot's lowest point.
        ratios: The learner's limb lengths over the demonstrator's.
    """

    body: str
    motion: str
    rate_hz: float
    qpos: np.ndarray
    qvel: np.ndarray
    points: np.ndarray
    features: np.ndarray
    residuals: np.ndarray
    torso_tilt_rad: np.ndarray
    converged: np.ndarray
    joint_names: tuple[str, ...]
    at_limit: np.ndarray
    foot_skate_m_s: np.ndarray
    raised_m: np.ndarray
    sole_height_m: np.ndarray
    ratios: Limbs


def retarget_clip(
    motion: Motion,
    body: MujocoBody,
    *,
    scale_limbs: bool = True,
    tolerance_m: float = TOLERANCE_M,
    strict: bool = False,
    progress_bar: bool = False,
) -> IKResult:
    """Pose a body so that its hands, feet and torso follow a demonstrator's, frame by frame.

    Args:
        motion: The demonstrator's motion, T frames.
        body: The learner's body.
        scale_limbs: Whether targets are scaled to the learner's limbs (see `targets`).
        tolerance_m: Residual up to which a frame counts as converged.
        strict: Whether a frame that does not converge is an error.
        progress_bar: Whether to show one.

    Raises:
        SilemError: The motion holds NaN or infinity; no frame converges; or, if `strict`, any
            frame does not (the message names frame and target).
    """
    model = mujoco.MjModel.from_xml_string(body.model_xml())
    solver = PoseSolver(model, body)
    wanted = targets(motion, solver.standing_points, solver.standing_axes, scale_limbs)
    qpos = _solve(solver, wanted, f"{motion.name} on {body.name}" if progress_bar else None)
    result = _measure(model, body, motion, wanted, qpos, tolerance_m)
    _check_converged(result, tolerance_m, strict)
    return result


def _solve(solver: PoseSolver, wanted: Targets, title: str | None) -> np.ndarray:
    """Return the poses (T, nq), found twice.

    From the standing pose the first frames would end in a minimum with a twisted waist; going
    through the clip backwards first gives them a start from within the walk.
    """
    frames = list(zip(wanted.positions, wanted.torso_axes, strict=True))
    with tqdm(total=2 * len(frames), desc=title, disable=title is None) as bar:
        for frame in reversed(frames):
            solver.solve(*frame)
            bar.update()
        qpos = np.empty((len(frames), len(solver.standing_pose)))
        for row, frame in zip(qpos, frames, strict=True):
            row[:] = solver.solve(*frame)
            bar.update()
    return qpos


def _measure(
    model: mujoco.MjModel,
    body: MujocoBody,
    motion: Motion,
    wanted: Targets,
    qpos: np.ndarray,
    tolerance_m: float,
) -> IKResult:
    """Put together the result from the poses found."""
    data, landmarks = mujoco.MjData(model), Landmarks(model, body.skeleton)
    soles = Soles(model, [getattr(body.skeleton, f"{side}_foot") for side in SIDES])
    qvel = poses.velocities(model, qpos, motion.rate_hz)
    seen = []
    for data.qpos[:], data.qvel[:] in zip(qpos, qvel, strict=True):
        mujoco.mj_forward(model, data)
        places = landmarks.points(data), landmarks.torso_axes(data)
        seen.append((*places, g(model, data, landmarks), soles.lowest(data)))
    points, axes, features, sole_height_m = (np.array(column) for column in zip(*seen, strict=True))
    reached = points[:, [POINTS.index(name) for name in TARGETS]]
    residuals = np.linalg.norm(reached - wanted.positions, axis=-1)
    hinges, at_limit = _hinges_at_limit(model, qpos)
    return IKResult(
        body=body.name,
        motion=motion.name,
        rate_hz=motion.rate_hz,
        qpos=qpos,
        qvel=qvel,
        points=points,
        features=features,
        residuals=residuals,
        torso_tilt_rad=_angle_between(axes, wanted.torso_axes),
        converged=(residuals <= tolerance_m).all(axis=1),
        joint_names=hinges,
        at_limit=at_limit,
        foot_skate_m_s=np.where(wanted.stance, foot_speeds_m_s(points, motion.rate_hz), np.nan),
        raised_m=wanted.raised_m,
        sole_height_m=sole_height_m,
        ratios=wanted.ratios,
    )


def _hinges_at_limit(model: mujoco.MjModel, qpos: np.ndarray) -> tuple[tuple[str, ...], np.ndarray]:
    """Return the names of the limited hinges and whether each is at a limit, (T, J)."""
    hinges = np.flatnonzero(model.jnt_limited)
    angles = qpos[:, model.jnt_qposadr[hinges]]
    lower, upper = model.jnt_range[hinges].T
    at_limit = (angles < lower + LIMIT_TOLERANCE_RAD) | (angles > upper - LIMIT_TOLERANCE_RAD)
    return tuple(model.joint(int(hinge)).name for hinge in hinges), at_limit


def _angle_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the angle in rad of the rotation from one frame to another, (T,)."""
    cosine = (np.einsum("tij,tij->t", first, second) - 1) / 2
    return np.arccos(np.clip(cosine, -1.0, 1.0))


def _check_converged(result: IKResult, tolerance_m: float, strict: bool) -> None:
    """Raise if no frame converged or, if `strict`, if one did not."""
    if result.converged.all() or (result.converged.any() and not strict):
        return
    frame = int(np.argmin(result.converged))
    worst = int(np.argmax(result.residuals[frame]))
    scope = "some frames" if result.converged.any() else "any frame"
    raise SilemError(
        f"{result.body} cannot follow {result.motion} in {scope}: in frame {frame} its "
        f"{TARGETS[worst]} stays {1000 * result.residuals[frame, worst]:.0f} mm from its target, "
        f"allowed: {1000 * tolerance_m:.0f} mm"
    )
