"""Retargeting for the baseline Peng20: a demonstrator's motion on a learner's body.

Peng et al. 2020, "Learning Agile Robotic Locomotion Skills by Imitating Animals", match key points
after scaling them to the learner. Here (page "The method", equation eq-targets) hips and feet go
through one similarity transform of the demonstrator's world, by the ratio of the leg lengths:
keeping the forward motion instead would drag every planted foot over the floor. The torso follows
the middle of the hips by the ratio of the spines, the hands the shoulders by that of the arms.
"""

from dataclasses import dataclass, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import mink
import mujoco
import numpy as np
from tqdm import tqdm

from silem import bodies, paper
from silem.bodies import atlas
from silem.bodies.body import MujocoBody
from silem.motion import demonstrations as demos
from silem.motion import kinematics, retargeted
from silem.motion.demonstrations import Demonstrations
from silem.motion.demonstrator import Motion, published_motion, published_name
from silem.motion.features import POINTS, skeletal_features
from silem.motion.kinematics import SIDES, Soles
from silem.util.errors import SilemError

BODIES = ("Humanoid", "HumanoidR", "Atlas")

STANCE_SPEED_M_S = 0.3
"""A demonstrator's foot that is horizontally slower stands: in 08_01 such a foot moves at up to
0.2 m/s, a swinging one at up to 4.7 m/s."""

TOLERANCE_M = 0.03  #: a frame whose targets are all reached to within this counts as converged
LIMIT_TOLERANCE_RAD = 1e-3  #: a joint closer to a limit than this is at it

RETARGETING_VERSION = 1
"""How a motion becomes a learner's: to be raised, and all published anew, when numbers change."""

_SOLVER = "daqp"
_COSTS = {  # of position (per m) and orientation (per rad): what is out of reach, the hands lose
    "torso": (5.0, 5.0),
    "left_hand": (1.0, 0.0),
    "right_hand": (1.0, 0.0),
    "left_foot": (10.0, 0.0),
    "right_foot": (10.0, 0.0),
}
TARGETS = tuple(_COSTS)  #: of the inverse kinematics, each a landmark
_STANDING_COST = 0.004  # towards the standing pose, in what the targets leave open
_PREVIOUS_COST = 0.025  # towards the frame before
_BELOW_FLOOR_COST = 100.0  # counts in whether a step is accepted
_MAX_STEPS = 200
_CONVERGED = 1e-6  # relative decrease of the cost
_DAMPING = (1e-6, 1e4)  # lowest and highest
_LESS, _MORE = 0.25, 8.0  # factors on the damping after a step that did and did not help

_HORIZONTAL, _UP = np.array([1.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
_COPIED = ("source", "source_sha256", "licence", "acknowledgement")  # from the clip's entry


def learner(name: str) -> MujocoBody:
    """Return a humanoid as Peng20 has it: Atlas with the ankles of its best combination."""
    if name == "Atlas":
        return atlas.body(paper.best_combination(name, "peng20")[0]["ankle_range_rad"])
    return bodies.of_kind(name, MujocoBody)


class Limbs(NamedTuple):
    """Lengths between a skeleton's landmarks in m, or ratios of two skeletons' lengths."""

    leg: float  #: hip to knee to foot, mean of both sides
    left_arm: float  #: shoulder to elbow to hand
    right_arm: float
    spine: float  #: middle of the hips to torso
    hips: float  #: left hip to right hip

    @classmethod
    def of(cls, points: np.ndarray) -> "Limbs":
        """Measure the landmarks (..., P, 3) of one or more poses: of several, the 95 % quantile.

        Where a landmark lies beside its joint's axis a bent limb looks shorter than it is, and a
        single broken frame should not matter.
        """

        def lengths(*chain: np.ndarray) -> list[float]:
            parts = np.linalg.norm(np.diff(np.stack(chain), axis=0), axis=-1).sum(axis=0)
            found: list[float] = np.quantile(parts.reshape(-1, parts.shape[-1]), 0.95, 0).tolist()
            return found

        hips, torso = _both(points, "hip"), points[..., :1, :]
        legs = lengths(hips, _both(points, "knee"), _both(points, "foot"))
        arms = lengths(*(_both(points, name) for name in ("shoulder", "elbow", "hand")))
        spine, width = lengths(hips.mean(-2, keepdims=True), torso), lengths(*np.split(hips, 2, -2))
        return cls(sum(legs) / 2, *arms, *spine, *width)


class Targets(NamedTuple):
    """What the inverse kinematics has to reach; no foot lower than on the standing learner."""

    positions: np.ndarray  #: (T, 5, 3) of `TARGETS` in m; floor at z = 0, from above the origin
    stance: np.ndarray  #: (T, 2) whether the demonstrator's left and right foot stands
    ratios: Limbs  #: the learner's limbs over the demonstrator's
    raised_m: np.ndarray  #: (T, 2) by how much a foot's target was raised


def targets(motion: Motion, body: MujocoBody) -> Targets:
    """Scale a demonstrator's motion, T frames, to a learner; SilemError on NaN or infinity."""
    for name in ("points", "torso_axes"):
        _check_finite(getattr(motion, name), f"motion {motion.name}: {name} of frame", "hold")
    model = _compiled(body)
    standing = np.array([body.standing_pose]), np.zeros((1, model.nv))
    (points,), (torso_axes,), _ = kinematics.observe(model, body.skeleton, *standing)
    demonstrator, own = Limbs.of(motion.points), Limbs.of(points)
    ratios = Limbs(*np.divide(own, demonstrator).tolist())
    stance, feet = standing_feet(motion), _both(motion.points, "foot")
    foot_height = float(_both(points, "foot")[:, 2].mean())
    # Where the landmark of a foot is when that foot stands: the median, to which targets below it
    # are raised. In the clips a foot that stands sinks and rises by 1 cm or 2; the learner's should
    # be on the floor.
    ground = [
        [float(np.median(heights[stands]) if stands.any() else heights.min())]
        for heights, stands in zip(feet[..., 2].T, stance.T, strict=True)
    ]
    mid_hip = _both(motion.points, "hip").mean(axis=-2, keepdims=True)

    def moved(world: np.ndarray, ground_m: Any) -> np.ndarray:
        start = mid_hip[0] * _HORIZONTAL
        return ratios.leg * (world - start - ground_m * _UP) + foot_height * _UP

    torso = moved(mid_hip, np.mean(ground)) + ratios.spine * (motion.points[:, :1] - mid_hip)
    shoulders = (_both(points, "shoulder") - points[0]) @ torso_axes.T @ motion.torso_axes
    arms = _both(motion.points, "hand") - _both(motion.points, "shoulder")
    hands = torso + shoulders + np.array([[ratios.left_arm], [ratios.right_arm]]) * arms
    left = motion.torso_axes[:, 1].mean(axis=0) * _HORIZONTAL
    wider = (own.hips - ratios.leg * demonstrator.hips) / 2 * (left / np.linalg.norm(left))
    feet = moved(feet, np.array(ground)) + np.array([[1], [-1]]) * wider
    raised = np.maximum(foot_height - feet[..., 2], 0)
    feet[..., 2] += raised
    return Targets(np.concatenate([torso, hands, feet], axis=1), stance, ratios, raised)


def standing_feet(motion: Motion) -> np.ndarray:
    """Return whether the demonstrator's left and right foot stands in each frame, (T, 2)."""
    return foot_speeds_m_s(motion.points, motion.rate_hz) < STANCE_SPEED_M_S


def foot_speeds_m_s(points: np.ndarray, rate_hz: float) -> np.ndarray:
    """Return how fast the left and right foot of landmarks (T, P, 3) move horizontally, (T, 2)."""
    velocity = np.gradient(_both(points, "foot")[..., :2], 1 / rate_hz, axis=0)
    return np.linalg.norm(velocity, axis=-1)


def _check_finite(array: np.ndarray, what: str, hold: str = "holds") -> None:
    finite = np.isfinite(array).reshape(len(array), -1).all(axis=1)
    if not finite.all():
        raise SilemError(f"{what} {finite.argmin()} {hold} NaN or infinity")


def _both(points: np.ndarray, name: str) -> np.ndarray:
    """Return the left and the right landmark of a name, (..., 2, 3)."""
    return points[..., [POINTS.index(f"{side}_{name}") for side in SIDES], :]


def _compiled(body: MujocoBody) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(body.model_xml())


def _solve(
    model: mujoco.MjModel, body: MujocoBody, wanted: np.ndarray, torso_axes: np.ndarray, bar: Any
) -> np.ndarray:
    """Return the poses (T, nq) that bring landmarks (T, 5, 3) and torso (T, 3, 3) to their targets.

    mink states a step as a quadratic program, with joint limits and the floor as hard constraints;
    its steps are repeated, with damping by Levenberg and Marquardt's rule, until the pose is at a
    minimum. Self-collision is not looked at.
    """
    standing = np.array(body.standing_pose)
    configuration, soles = mink.Configuration(model, standing), Soles(model, body.skeleton)
    frames = [
        mink.FrameTask(getattr(body.skeleton, name), "body", *_COSTS[name]) for name in TARGETS
    ]
    previous, posture = (mink.PostureTask(model, c) for c in (_PREVIOUS_COST, _STANDING_COST))
    posture.set_target(standing)
    tasks = [*frames, previous, posture]
    limits = [mink.ConfigurationLimit(model), soles]
    columns = ["xyz".index(axis) for axis in body.skeleton.axes]

    def cost() -> float:
        errors = [task.cost * task.compute_error(configuration) for task in tasks]
        errors.append(_BELOW_FLOOR_COST * np.minimum(soles.heights(configuration.data), 0.0))
        return float(sum(error @ error for error in errors))

    def descend() -> None:
        # Full steps would overshoot again and again at a leg that is nearly straight and at a
        # target just out of reach: a step that does not help is taken back, a shorter one tried.
        now, damping = cost(), _DAMPING[0]
        for _ in range(_MAX_STEPS):
            before = configuration.q
            step = mink.solve_ik(configuration, tasks, 1.0, _SOLVER, damping=damping, limits=limits)
            configuration.integrate_inplace(step, 1.0)
            decrease = now - cost()
            if decrease > 0:
                now -= decrease
                damping = max(damping * _LESS, _DAMPING[0])
                if decrease < _CONVERGED * now:
                    return
            else:
                configuration.update(before)
                damping *= _MORE
                if damping > _DAMPING[1]:
                    return

    qpos = np.empty((len(wanted), model.nq))
    # From the standing pose the first frames would end in a minimum with a twisted waist; going
    # through the clip backwards first gives them a start from within the walk.
    for frame in (*reversed(range(len(wanted))), *range(len(wanted))):
        matrix = np.empty((3, 3))
        matrix[:, columns] = torso_axes[frame].T
        rotation = mink.SO3.from_matrix(matrix)  # has no cost except at the torso
        for task, position in zip(frames, wanted[frame], strict=True):
            task.set_target(mink.SE3.from_rotation_and_translation(rotation, position))
        previous.set_target(configuration.q)
        descend()
        qpos[frame] = configuration.q
        bar.update()
    return qpos


@dataclass(frozen=True)
class IKResult:
    """A motion of T frames retargeted to a body with J hinges, and what could not be reached."""

    body: str
    motion: str  #: name of the demonstrator's motion
    rate_hz: float  #: frames per second
    joint_names: tuple[str, ...]  #: of the J hinges
    ratios: Limbs  #: the learner's limbs over the demonstrator's
    features: np.ndarray  #: (T, F) skeletal features by the learner's own g
    qpos: np.ndarray  #: (T, nq) positions; the walk starts above the world's origin
    qvel: np.ndarray  #: (T, nv) velocities, central differences
    points: np.ndarray  #: (T, P, 3) landmarks in the world, in m
    residuals: np.ndarray  #: (T, 5) distance of each of `TARGETS` from where it should be, in m
    torso_tilt_rad: np.ndarray  #: (T,) angle between the torso's orientation and its target
    converged: np.ndarray  #: (T,) whether every residual is within the tolerance
    at_limit: np.ndarray  #: (T, J) whether a hinge is at a limit
    foot_skate_m_s: np.ndarray  #: (T, 2) each foot's horizontal speed; NaN while the man's swings
    raised_m: np.ndarray  #: (T, 2) by how much a foot's target was raised (see `Targets`)
    sole_height_m: np.ndarray  #: (T, 2) height of each foot's lowest point


_PUBLISHED = [field.name for field in fields(IKResult)][6:]


def retarget_clip(motion: Motion, body: MujocoBody, *, progress: bool = False) -> IKResult:
    """Pose a body so that its hands, feet and torso follow a demonstrator's, frame by frame.

    Raises SilemError: the motion holds NaN or infinity, or no frame converges.
    """
    model, wanted = _compiled(body), targets(motion, body)
    title, n_solved = f"{motion.name} on {body.name}", 2 * len(motion.points)
    with tqdm(total=n_solved, desc=title, disable=not progress) as bar:
        qpos = _solve(model, body, wanted.positions, motion.torso_axes, bar)
    qvel = kinematics.velocities(model, qpos, motion.rate_hz)
    seen = points, torso_axes, _ = kinematics.observe(model, body.skeleton, qpos, qvel)
    reached = points[:, [POINTS.index(name) for name in TARGETS]]
    residuals = np.linalg.norm(reached - wanted.positions, axis=-1)
    converged = (residuals <= TOLERANCE_M).all(axis=1)
    if not converged.any():
        raise SilemError(
            f"{body.name} cannot follow {motion.name} in any frame: in frame 0 its"
            f" {TARGETS[residuals[0].argmax()]} stays {1000 * residuals[0].max():.0f} mm from its"
            f" target, allowed: {1000 * TOLERANCE_M:g} mm"
        )
    cosine = (np.einsum("tij,tij->t", torso_axes, motion.torso_axes) - 1) / 2
    hinges = np.flatnonzero(model.jnt_limited)
    lower, upper = model.jnt_range[hinges].T + np.array([[1], [-1]]) * LIMIT_TOLERANCE_RAD
    angles = qpos[:, model.jnt_qposadr[hinges]]
    return IKResult(
        body=body.name,
        motion=motion.name,
        rate_hz=motion.rate_hz,
        joint_names=tuple(model.joint(int(hinge)).name for hinge in hinges),
        ratios=wanted.ratios,
        features=skeletal_features(*seen),
        qpos=qpos,
        qvel=qvel,
        points=points,
        residuals=residuals,
        torso_tilt_rad=np.arccos(np.clip(cosine, -1.0, 1.0)),
        converged=converged,
        at_limit=(angles < lower) | (angles > upper),
        foot_skate_m_s=np.where(wanted.stance, foot_speeds_m_s(points, motion.rate_hz), np.nan),
        raised_m=wanted.raised_m,
        sole_height_m=Soles(model, body.skeleton).lowest(qpos),
    )


def publish_retargeted(clip: str = "08_01", *, progress: bool = False) -> list[Path]:
    """Retarget a published clip to the three humanoids, and publish the result, a file per body."""
    source, written = published_name(clip), []
    with demos.publishing():
        motion, entry = published_motion(clip), demos.entry(source)
        for body in BODIES:
            result = retarget_clip(motion, learner(body), progress=progress)
            extra = {array: getattr(result, array) for array in _PUBLISHED}
            demonstrations = Demonstrations((result.features,), body=body, extra=extra)
            about = {
                "clip": clip,
                "retargeted_from": source,
                "retargeted_from_sha256": entry["sha256"],
                **{key: entry[key] for key in _COPIED},
                "rate_hz": result.rate_hz,
                "n_states": len(result.features),
                "solver": f"mink {version('mink')}, {_SOLVER} {version(_SOLVER)}",
                "tolerance_m": TOLERANCE_M,
                "limb_ratios": result.ratios._asdict(),
                "joint_names": list(result.joint_names),
                "retargeting_version": RETARGETING_VERSION,
            }
            written.append(demos.publish(retargeted(source, body), demonstrations, about))
    return written


def published_retargeting(body: str, clip: str = "08_01") -> IKResult:
    """Return the retargeting that was published for a body."""
    name = retargeted(published_name(clip), body)
    about, (there, _) = demos.entry(name), demos.load_published(name)
    joints, ratios = tuple(about["joint_names"]), Limbs(**about["limb_ratios"])
    return IKResult(body, clip, about["rate_hz"], joints, ratios, *there.features, **there.extra)


def demonstration_states(name: str, body: MujocoBody) -> tuple[np.ndarray, np.ndarray]:
    """Return states (S, nq), (S, nv) of retargeted demonstrations as states of a learner's body.

    Peng20 retargets to an Atlas whose ankles turn further than those of the Atlas that other
    methods train. A hinge beyond its range is put to the limit, at rest, and the body is lifted
    until both soles are above the floor; states that fit are returned as they are. Raises
    SilemError as `silem.motion.demonstrations.load_published`, or there are no states, or those of
    another body or with NaN or infinity.
    """
    extra = demos.load_published(name)[0].extra
    missing = [array for array in ("qpos", "qvel") if array not in extra]
    if missing:
        raise SilemError(f"demonstrations {name!r} hold no states: they lack {', '.join(missing)}")
    qpos, qvel, model = extra["qpos"], extra["qvel"], _compiled(body)
    if qpos.shape[1:] != (model.nq,) or qvel.shape[1:] != (model.nv,):
        raise SilemError(
            f"demonstrations {name!r} hold states of shape {qpos.shape[1:]} and {qvel.shape[1:]};"
            f" {body.name} needs ({model.nq},) and ({model.nv},)"
        )
    _check_finite(np.hstack([qpos, qvel]), f"demonstrations {name!r}: state")
    hinges = np.flatnonzero(model.jnt_limited)
    places, rates = model.jnt_qposadr[hinges], model.jnt_dofadr[hinges]
    allowed = np.clip(qpos[:, places], *model.jnt_range[hinges].T)
    beyond = np.abs(qpos[:, places] - allowed) > LIMIT_TOLERANCE_RAD
    qpos[:, places] = np.where(beyond, allowed, qpos[:, places])
    qvel[:, rates] = np.where(beyond, 0.0, qvel[:, rates])
    changed = beyond.any(axis=1)
    lowest = Soles(model, body.skeleton).lowest(qpos[changed]).min(axis=1)
    qpos[changed, 2] += np.maximum(0.0, -lowest)
    return qpos, qvel
