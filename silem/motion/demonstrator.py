"""The demonstrator: a motion capture clip posed on dm_control's ``humanoid_CMU``, and its g.

A clip gives the path of a man's pelvis and the angles of his joints. The model that takes them has
nearly subject 8's bones, but both its legs are as long as his right one (the left is 3 % shorter),
so its feet need not touch the floor where his did. `pose` sets the clip as a whole on the floor and
leaves the rest as captured.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
from dm_control.suite import humanoid_CMU
from dm_control.suite.utils.parse_amc import Amcvals2qpos
from scipy.spatial.transform import Rotation

from silem.bodies.body import Skeleton
from silem.motion import fetch, poses
from silem.motion.features import Landmarks, skeletal_features
from silem.motion.mocap import AmcClip, AsfSkeleton, read_amc, read_asf
from silem.motion.soles import Soles
from silem.util.errors import SilemError, choose

BODY = "humanoid_CMU"
CLIPS = tuple(f"08_{number:02d}" for number in range(1, 12))
"""Subject 8's clips, all of walking."""

RATE_HZ = 40.0
"""The control rate of the humanoids."""

CAPTURE_RATE_HZ = 120.0
"""CMU's frame rate, which the files do not say."""

SKELETON = Skeleton(
    torso="thorax",
    head="head",
    left_shoulder="lhumerus",
    left_elbow="lradius",
    left_hand="lhand",
    right_shoulder="rhumerus",
    right_elbow="rradius",
    right_hand="rhand",
    left_hip="lfemur",
    left_knee="ltibia",
    left_foot="lfoot",
    right_hip="rfemur",
    right_knee="rtibia",
    right_foot="rfoot",
    axes="zxy",
)
"""The torso is the thorax: the paper's distances in the default pose, feet 1.13 m and hands 0.74 m
away, are those from `humanoid_CMU`'s thorax."""

FLOOR_SLOPE = 0.0206
"""In all of subject 8's clips the floor rises by this much per metre walked, 1.2 degrees: the
captured coordinates are tilted. A line through the heights at which the feet stand, 67 times in the
eleven clips, has this slope, with a standard error of 0.0006."""

MAX_HELD_FRAMES = 12
"""A frame may be held this long, 0.1 s, for the gap to be closed by interpolation."""

_TURN = Rotation.from_euler("z", 90, degrees=True)  # dm_control has CMU's forward axis at -y


@dataclass(frozen=True)
class Motion:
    """A demonstrator's motion in the world: x forward, y left, z up, the floor at z = 0.

    Attributes:
        name: The clip, for example "08_01".
        rate_hz: States per second.
        qpos: (T, 63) the model's pose: the root's position and quaternion, then hinges.
        qvel: (T, 62) its velocity, by central differences over the neighbouring states.
        points: (T, P, 3) landmarks in m, in the order of `silem.motion.features.POINTS`.
        torso_axes: (T, 3, 3) forward, left and up of the torso, as rows.
        com_velocity: (T, 3) velocity of the whole body's centre of mass in m/s.
        features: (T, F) float32 skeletal features.
        repairs: What was mended in the clip, one sentence each.
    """

    name: str
    rate_hz: float
    qpos: np.ndarray
    qvel: np.ndarray
    points: np.ndarray
    torso_axes: np.ndarray
    com_velocity: np.ndarray
    features: np.ndarray
    repairs: tuple[str, ...] = ()

    @property
    def duration_s(self) -> float:
        """Time from the first state to the last."""
        return (len(self.qpos) - 1) / self.rate_hz

    @property
    def speed_m_s(self) -> float:
        """Mean speed: the root's way over the floor, from the first state to the last."""
        return float(np.linalg.norm(self.qpos[-1, :2] - self.qpos[0, :2])) / self.duration_s


@cache
def model() -> mujoco.MjModel:
    """Return the demonstrator's model, dm_control's ``humanoid_CMU``, compiled."""
    return mujoco.MjModel.from_xml_string(*humanoid_CMU.get_model_and_assets())


def load_motion(clip: str, rate_hz: float = RATE_HZ) -> Motion:
    """Pose one of subject 8's clips, from the raw files (`silem.motion.fetch`).

    Args:
        clip: Its name, one of `CLIPS`.
        rate_hz: States per second.

    Raises:
        SilemError: The clip is unknown or cannot be had, or as `read_amc` and `pose`.
    """
    choose("clip", clip, CLIPS)
    subject = clip.partition("_")[0]
    skeleton = read_asf(fetch.mocap_file(f"{subject}/{subject}.asf"))
    amc = read_amc(fetch.mocap_file(f"{subject}/{clip}.amc"), skeleton)
    return replace(pose(amc, rate_hz), name=clip)


def pose(clip: AmcClip, rate_hz: float = RATE_HZ, floor_slope: float = FLOOR_SLOPE) -> Motion:
    """Pose a clip on the demonstrator's model.

    The world is turned so that CMU's forward axis is x, and by the floor's slope, so that the
    floor is level. The walk starts above the origin, and is lifted (or lowered) as a whole until
    the lowest point of the feet's shapes in the whole clip is on the floor. Frames that only
    repeat the one before were held by the recorder, not captured: they are replaced by
    interpolation, and `Motion.repairs` says so.

    Args:
        clip: The frames.
        rate_hz: States per second, up to the capture's 120. Positions and hinges are interpolated
            linearly, the root's orientation along the great arc (slerp).
        floor_slope: By how many metres the captured floor rises per metre forward.

    Raises:
        SilemError: The clip's skeleton is not the model's, a frame is held for longer than
            0.1 s, the root jumps as no man's can, the clip has no 3 states, or the rate is not
            allowed.
    """
    if not 0 < rate_hz <= CAPTURE_RATE_HZ:
        raise SilemError(f"cannot resample to {rate_hz} Hz; allowed: up to {CAPTURE_RATE_HZ}")
    _check_skeleton(clip.skeleton)
    to_qpos = Amcvals2qpos(_joint_of_qpos(), clip.skeleton.columns)
    captured = np.stack([to_qpos(frame) for frame in clip.frames])
    captured[:, 7:] = np.unwrap(captured[:, 7:], axis=0)
    captured, repairs = _fill_held(captured, clip)
    n_states = int((len(captured) - 1) / CAPTURE_RATE_HZ * rate_hz + 1e-6) + 1
    if n_states < 3:
        raise SilemError(f"{clip.path} gives {n_states} states at {rate_hz} Hz; allowed: 3 or more")
    _check_root(captured, clip.path)
    times = np.arange(len(captured)) / CAPTURE_RATE_HZ
    qpos = poses.interpolate(_place(captured, floor_slope), times, np.arange(n_states) / rate_hz)
    return _measure(clip.path.stem, qpos, rate_hz, repairs)


def _joint_of_qpos() -> dict[int, str]:
    """Return the joint that each number of qpos belongs to, named as a clip's columns."""
    joints = [model().joint(index) for index in range(model().njnt)]
    return {
        int(joint.qposadr[0]) + i: joint.name
        for joint in joints
        for i in range(7 if joint.type[0] == mujoco.mjtJoint.mjJNT_FREE else 1)
    }


def _check_skeleton(skeleton: AsfSkeleton) -> None:
    wanted = set(list(_joint_of_qpos().values())[7:])
    found = set(skeleton.columns[6:])
    for problem, joints in (("lacks", wanted - found), ("has too much", found - wanted)):
        if joints:
            bone, axis = min(joints)[:-2], min(joints)[-2:]
            raise SilemError(
                f"{skeleton.path} is not the skeleton of {BODY}: it {problem}"
                f" axis {axis} of bone {bone!r} ({len(joints)} such axes)"
            )


def _fill_held(captured: np.ndarray, clip: AmcClip) -> tuple[np.ndarray, tuple[str, ...]]:
    """Close the gaps of frames that equal the one before; at the clip's end they are dropped."""
    held = np.append(False, (np.diff(clip.frames, axis=0) == 0).all(axis=1))
    if not held.any():
        return captured, ()
    if poses.longest_run(held) > MAX_HELD_FRAMES:
        raise SilemError(
            f"{clip.path}: {poses.longest_run(held)} frames in a row only repeat the one before;"
            f" allowed: {MAX_HELD_FRAMES}"
        )
    true = np.flatnonzero(~held)
    frames = ", ".join(str(index + 1) for index in np.flatnonzero(held))
    repair = f"frames {frames} repeat the one before: interpolated between their neighbours"
    return poses.interpolate(captured[true], true, np.arange(true[-1] + 1)), (repair,)


def _check_root(captured: np.ndarray, path: Path) -> None:
    index, change = poses.root_jump(captured, CAPTURE_RATE_HZ)
    if change > poses.MAX_ROOT_VELOCITY_CHANGE_M_S:
        raise SilemError(
            f"{path}: the root jumps at frame {index + 1}: its velocity changes by {change:.1f} m/s"
            f" from one frame to the next; allowed: {poses.MAX_ROOT_VELOCITY_CHANGE_M_S} m/s"
        )


def _place(captured: np.ndarray, floor_slope: float) -> np.ndarray:
    """Turn a clip to x and level it, start it at the origin, set it on the floor."""
    turn = Rotation.from_euler("y", np.arctan(floor_slope)) * _TURN
    placed = captured.copy()
    placed[:, :3] = turn.apply(captured[:, :3])
    placed[:, 3:7] = poses.quaternions(turn * poses.rotations(captured))
    placed[:, :2] -= placed[0, :2]
    placed[:, 2] -= min(_soles_m(placed))
    return placed


def _soles_m(qpos: np.ndarray) -> list[float]:
    """Return the height of the lowest point of the feet in each pose."""
    compiled = model()
    data = mujoco.MjData(compiled)
    soles = Soles(compiled, [compiled.body(foot).id for foot in ("lfoot", "rfoot")])
    heights = []
    for row in qpos:
        data.qpos[:] = row
        mujoco.mj_kinematics(compiled, data)
        heights.append(float(soles.lowest(data).min()))
    return heights


def _measure(name: str, qpos: np.ndarray, rate_hz: float, repairs: tuple[str, ...]) -> Motion:
    compiled = model()
    data, landmarks = mujoco.MjData(compiled), Landmarks(compiled, SKELETON)
    qvel = poses.velocities(compiled, qpos, rate_hz)
    points, torso_axes, com_velocity = [], [], []
    for position, velocity in zip(qpos, qvel, strict=True):
        data.qpos[:], data.qvel[:] = position, velocity
        mujoco.mj_forward(compiled, data)
        mujoco.mj_subtreeVel(compiled, data)
        points.append(landmarks.points(data))
        torso_axes.append(landmarks.torso_axes(data))
        com_velocity.append(data.subtree_linvel[landmarks.root].copy())
    seen = np.stack(points), np.stack(torso_axes), np.stack(com_velocity)
    return Motion(name, rate_hz, qpos, qvel, *seen, skeletal_features(*seen), repairs)
