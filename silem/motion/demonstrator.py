"""The demonstrator: a motion capture clip posed on dm_control's ``humanoid_CMU``, and its g.

The model has nearly subject 8's bones, but both its legs are as long as his right one (the left is
3 % shorter), so its feet need not touch the floor where his did. `pose` sets the clip as a whole on
the floor and leaves the rest as captured. The way of a man with other legs is scaled to the
model's, or its planted feet would slide.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
from dm_control.suite import humanoid_CMU
from dm_control.suite.utils.parse_amc import CONVERSION_LENGTH, Amcvals2qpos
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from silem import bodies
from silem.bodies.body import Skeleton
from silem.motion import clips, kinematics
from silem.motion import demonstrations as demos
from silem.motion.clips import ROOT, AmcClip, AsfSkeleton, read_amc, read_asf
from silem.motion.demonstrations import Demonstrations
from silem.motion.features import skeletal_features
from silem.motion.kinematics import SIDES, Soles
from silem.util import files
from silem.util.errors import SilemError, check_name, choose

BODY = "humanoid_CMU"
CLIPS = tuple(f"08_{number:02d}" for number in range(1, 12))  #: subject 8's, all of walking
RATE_HZ = 40.0  #: the control rate of the humanoids
CMU_RATE_HZ = 120.0  #: of subject 8's; the files do not say it, and a few of CMU's have 60

_LIMBS = {"shoulder": "humerus", "elbow": "radius", "hand": "hand"}
_LIMBS |= {"hip": "femur", "knee": "tibia", "foot": "foot"}
SKELETON = Skeleton(
    torso="thorax",
    head="head",
    axes="zxy",
    **{f"{side}_{name}": side[0] + bone for side in SIDES for name, bone in _LIMBS.items()},
)
"""The torso is the thorax: the paper's distances in the default pose, feet 1.13 m and hands 0.74 m
away, are those from `humanoid_CMU`'s thorax."""

FLOOR_SLOPE = 0.0206
"""In all of subject 8's clips the floor rises by this much per metre walked: their coordinates are
tilted. A line through the heights at which the feet stand, 67 times in the eleven clips, has this
slope, with a standard error of 0.0006. Of other clips nothing is known."""

MAX_HELD_S = 0.1  #: a frame may be held this long for the gap to be closed by interpolation
MAX_ROOT_ACCELERATION_M_S2 = 600.0  #: 61 times gravity, which no walking man's pelvis reaches
MIN_SPEED_M_S = 0.1  #: a man who goes no faster has no direction, and shows nothing of walking

FEATURES_VERSION = 1
"""How a clip becomes features: to be raised, and the clips published anew, when numbers change."""

_TURN = Rotation.from_euler("z", 90, degrees=True)  # dm_control has CMU's forward axis at -y
_MAX_FRAME_ERROR_DEG = 5.0  # of a bone's own axes; the model's are 0.35 off subject 8's
_SAME_LEGS = 0.01
_PUBLISHED = ("qpos", "qvel", "points", "torso_axes", "com_velocity")


@dataclass(frozen=True)
class Motion:
    """A demonstrator's motion in the world: x forward, y left, z up, the floor at z = 0."""

    name: str  #: the clip, for example "08_01"
    rate_hz: float  #: states per second
    qpos: np.ndarray  #: (T, 63) its model's pose, the root's position and quaternion first
    qvel: np.ndarray  #: (T, 62) its velocity, by central differences over the neighbouring states
    points: np.ndarray  #: (T, P, 3) landmarks in m, in the order of `silem.motion.features.POINTS`
    torso_axes: np.ndarray  #: (T, 3, 3) forward, left and up of the torso, as rows
    com_velocity: np.ndarray  #: (T, 3) velocity of the whole body's centre of mass in m/s
    features: np.ndarray  #: (T, F) float32 skeletal features
    repairs: tuple[str, ...] = ()  #: what was mended in the clip, one sentence each

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
    """Pose one of `CLIPS` from the raw files (`silem.motion.clips`).

    Raises SilemError: the clip is unknown or cannot be had, or as `read_amc` and `pose`.
    """
    skeleton = read_asf(clips.mocap_file("08/08.asf"))
    amc = read_amc(clips.mocap_file(f"08/{choose('clip', clip, CLIPS)}.amc"), skeleton)
    return pose(amc, CMU_RATE_HZ, rate_hz, floor_slope=FLOOR_SLOPE, heading_rad=0.0)


def pose(
    clip: AmcClip,
    capture_rate_hz: float,
    rate_hz: float = RATE_HZ,
    *,
    floor_slope: float = 0.0,
    heading_rad: float | None = None,
) -> Motion:
    """Pose a clip on the demonstrator's model.

    The world is turned so that the walk goes along x and the floor is level. The walk starts above
    the origin, and is lifted as a whole until the lowest point of the feet's shapes in the whole
    clip is on the floor. Frames that only repeat the one before were held by the recorder, not
    captured: they are replaced by interpolation. Where the longer of the man's legs is not as long
    as the model's, his way is scaled by their ratio. `Motion.repairs` says so.

    Args:
        clip: The frames.
        capture_rate_hz: Frames per second, which the files do not say.
        rate_hz: States per second, up to the capture's; see `silem.motion.kinematics.interpolate`.
        floor_slope: By how many metres the captured floor rises per metre forward.
        heading_rad: Direction of walking, from CMU's forward axis (z) to the left; None means from
            the first frame's place to the last one's.

    Raises SilemError: the clip's skeleton is not the model's, a frame is held for longer than
    `MAX_HELD_S`, the root jumps as no man's can, the clip has no 3 states or goes nowhere, or a
    rate or the slope is not allowed.
    """
    if not 0 < rate_hz <= capture_rate_hz < float("inf"):
        raise SilemError(
            f"cannot resample {capture_rate_hz} Hz to {rate_hz} Hz; allowed: above 0 and up to"
            " the rate of capture"
        )
    if not abs(floor_slope) < 1:
        raise SilemError(f"a floor that rises by {floor_slope} m per metre; allowed: below 1")
    _check_skeleton(clip.skeleton)
    to_qpos = Amcvals2qpos(dict(enumerate([ROOT] * 7 + _hinges())), clip.skeleton.columns)
    captured = np.stack([to_qpos(frame) for frame in clip.frames])
    captured[:, 7:] = np.unwrap(captured[:, 7:], axis=0)
    repairs = _scale_way(captured, clip.skeleton)
    captured, filled = _fill_held(captured, clip, capture_rate_hz)
    n_states = int((len(captured) - 1) / capture_rate_hz * rate_hz + 1e-6) + 1
    if n_states < 3:
        raise SilemError(f"{clip.path} gives {n_states} states at {rate_hz} Hz; allowed: 3 or more")
    _check_root(captured, clip, capture_rate_hz)
    placed = _place(captured, clip, capture_rate_hz, floor_slope, heading_rad)
    times = np.arange(len(captured)) / capture_rate_hz
    qpos = kinematics.interpolate(placed, times, np.arange(n_states) / rate_hz)
    qvel = kinematics.velocities(model(), qpos, rate_hz)
    seen = kinematics.observe(model(), SKELETON, qpos, qvel)
    features = skeletal_features(*seen)
    return Motion(clip.path.stem, rate_hz, qpos, qvel, *seen, features, (*repairs, *filled))


def _hinges() -> list[str]:
    """Return the model's hinges in the order of qpos, named as a clip's columns."""
    return [model().joint(index).name for index in range(1, model().njnt)]


def _check_skeleton(skeleton: AsfSkeleton) -> None:
    """Raise unless the bones turn about the same axes as the model's."""
    wanted, found = set(_hinges()), set(skeleton.columns[6:])
    for problem, joints in (("lacks", wanted - found), ("has too much", found - wanted)):
        if joints:
            bone, axis = min(joints)[:-2], min(joints)[-2:]
            raise SilemError(
                f"{skeleton.path} is not the skeleton of {BODY}: it {problem}"
                f" axis {axis} of bone {bone!r} ({len(joints)} such axes)"
            )
    data = mujoco.MjData(model())
    data.qpos[3:7] = 1, 0, 0, 0
    mujoco.mj_kinematics(model(), data)
    for name in skeleton.dof:
        angles_deg = skeleton.bones[name].frame_deg
        if np.isnan(angles_deg).any():
            raise SilemError(f"{skeleton.path} does not say how the axes of bone {name!r} lie")
        frame = Rotation.from_euler("xyz", angles_deg, degrees=True)
        theirs = Rotation.from_matrix(data.body(name).xmat.reshape(3, 3))
        error_deg = np.degrees((theirs.inv() * frame).magnitude())
        if error_deg > _MAX_FRAME_ERROR_DEG:
            raise SilemError(
                f"{skeleton.path}: the axes of bone {name!r} are {error_deg:.0f} degrees off"
                f" {BODY}'s; allowed: {_MAX_FRAME_ERROR_DEG:g}"
            )


def _scale_way(captured: np.ndarray, skeleton: AsfSkeleton) -> tuple[str, ...]:
    """Scale the root's way in place from the man's legs to the model's, if they differ."""
    bones, body = skeleton.bones, model().body
    theirs = np.max([bones[f"{side}femur"].length + bones[f"{side}tibia"].length for side in "lr"])
    shank, foot = body(SKELETON.right_knee).pos, body(SKELETON.right_foot).pos
    ours = np.linalg.norm(shank) + np.linalg.norm(foot)
    ratio = float(ours / (theirs * CONVERSION_LENGTH)) if theirs > 0 else np.nan  # or one is NaN
    if not np.isfinite(ratio):
        raise SilemError(f"{skeleton.path} does not say how long the bones of the legs are")
    if abs(ratio - 1) <= _SAME_LEGS:
        return ()
    captured[:, :3] *= ratio
    return (f"the root's way is scaled by {ratio:.4f}, from the skeleton's legs to the model's",)


def _fill_held(
    captured: np.ndarray, clip: AmcClip, capture_rate_hz: float
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Close the gaps of frames that equal the one before; at the clip's end they are dropped."""
    held = np.append(False, (np.diff(clip.frames, axis=0) == 0).all(axis=1))
    if not held.any():
        return captured, ()
    true, allowed = np.flatnonzero(~held), round(MAX_HELD_S * capture_rate_hz)
    longest = int(np.diff([*true, len(held)]).max()) - 1
    if longest > allowed:
        raise SilemError(
            f"{clip.path}: {longest} frames in a row only repeat the one before; allowed: {allowed}"
        )
    frames = ", ".join(str(index + clip.first) for index in np.flatnonzero(held))
    repair = f"frames {frames} repeat the one before: interpolated between their neighbours"
    return kinematics.interpolate(captured[true], true, np.arange(true[-1] + 1)), (repair,)


def _check_root(captured: np.ndarray, clip: AmcClip, rate_hz: float) -> None:
    """Raise where the root's velocity changes as no man's can."""
    velocity = np.diff(captured[:, :3], axis=0) * rate_hz
    changes = np.linalg.norm(np.diff(velocity, axis=0), axis=1)
    at = int(changes.argmax())
    allowed = MAX_ROOT_ACCELERATION_M_S2 / rate_hz
    if changes[at] > allowed:
        # the larger of the two steps is the jump
        after = np.linalg.norm(velocity[at + 1]) >= np.linalg.norm(velocity[at])
        raise SilemError(
            f"{clip.path}: the root jumps at frame {at + (2 if after else 1) + clip.first}: its"
            f" velocity changes by {changes[at]:.1f} m/s from one frame to the next;"
            f" allowed: {allowed:.1f} m/s"
        )


def _place(
    captured: np.ndarray, clip: AmcClip, rate_hz: float, slope: float, heading_rad: float | None
) -> np.ndarray:
    """Turn a clip to x and level it, start it at the origin, set it on the floor."""
    if heading_rad is None:
        way = _TURN.apply(captured[-1, :3] - captured[0, :3])[:2]
        speed_m_s = np.linalg.norm(way) * rate_hz / (len(captured) - 1)
        if speed_m_s < MIN_SPEED_M_S:
            raise SilemError(
                f"{clip.path} goes nowhere: {speed_m_s:.2f} m/s from the first frame to the last;"
                f" allowed: {MIN_SPEED_M_S} m/s or more"
            )
        heading_rad = np.arctan2(way[1], way[0])
    level = Rotation.from_euler("y", np.arctan(slope))
    turn = level * Rotation.from_euler("z", -heading_rad) * _TURN
    placed = captured.copy()
    placed[:, :3] = turn.apply(captured[:, :3])
    placed[:, 3:7] = kinematics.quaternions(turn * kinematics.rotations(captured))
    placed[:, :2] -= placed[0, :2]
    placed[:, 2] -= Soles(model(), SKELETON).lowest(placed).min()
    return placed


def published_name(clip: str) -> str:
    """Return the name of a clip's demonstrations: "cmu_08_01" for "08_01"; an own clip has its."""
    return f"cmu_{clip}" if clip in CLIPS else clip


def published_motion(clip: str) -> Motion:
    """Return the motion that was published for a clip: one of `CLIPS`, or an own one."""
    name = published_name(clip)
    about, (there, _) = demos.entry(name), demos.load_published(name)
    if there.body != BODY or set(there.extra) != set(_PUBLISHED):
        raise SilemError(f"demonstrations {name!r} are no captured motion")
    (features,), repairs = there.features, tuple(about["repairs"])
    return Motion(clip, about["rate_hz"], features=features, repairs=repairs, **there.extra)


def publish_clips(names: Sequence[str] = CLIPS, *, progress: bool = False) -> list[Path]:
    """Compute subject 8's clips from their raw files (`silem.motion.clips`); publish each."""
    with demos.publishing():
        return [
            _publish(
                load_motion(clip), CMU_RATE_HZ, FLOOR_SLOPE,
                source=f"{clips.URL}08/{clip}.amc",
                source_sha256=clips.SHA256[f"08/{clip}.amc"],
                skeleton_source=f"{clips.URL}08/08.asf",
                licence=clips.LICENCE,
                acknowledgement=clips.ACKNOWLEDGEMENT,
            )
            for clip in tqdm(names, "clips", disable=not progress)
        ]  # fmt: skip


def publish_own(
    name: str, asf: Path | str, amc: Path | str, capture_rate_hz: float, floor_slope: float = 0.0
) -> Path:
    """Publish a clip of your own, of another of CMU's subjects for example, as demonstrations.

    Runs find it by its name; what had this name is replaced. Rate and slope are those of `pose`.
    Raises SilemError: the name is not allowed, as `read_asf`, `read_amc` and `pose`, or another
    process is publishing.
    """
    taken = {*bodies.names(), *map(published_name, CLIPS)}
    if check_name("clip", name) in taken or "." in name or "_on_" in name:
        raise SilemError(
            f"a clip cannot be named {name!r}; allowed: neither a body's name nor that of one of"
            " subject 8's clips, no '.', and no '_on_'"
        )
    motion = pose(read_amc(amc, read_asf(asf)), capture_rate_hz, floor_slope=floor_slope)
    with demos.publishing():
        return _publish(
            replace(motion, name=name), capture_rate_hz, floor_slope,
            source=Path(amc).name,
            source_sha256=files.sha256(Path(amc)),
            skeleton_source=Path(asf).name,
            skeleton_sha256=files.sha256(Path(asf)),
            licence="",
            acknowledgement="",
        )  # fmt: skip


def _publish(motion: Motion, capture_rate_hz: float, floor_slope: float, **source: str) -> Path:
    about = {
        "clip": motion.name,
        **source,
        "capture_rate_hz": capture_rate_hz,
        "rate_hz": motion.rate_hz,
        "n_states": len(motion.features),
        "duration_s": round(motion.duration_s, 6),
        "speed_m_s": round(motion.speed_m_s, 6),
        "floor_slope": floor_slope,
        "repairs": list(motion.repairs),
        "features_version": FEATURES_VERSION,
    }
    extra = {name: getattr(motion, name) for name in _PUBLISHED}
    demonstrations = Demonstrations((motion.features,), body=BODY, extra=extra)
    return demos.publish(published_name(motion.name), demonstrations, about)
