"""Sequences of poses (T, nq) of a model with a free root joint first, and the soles of its feet."""

import itertools

import mink
import mujoco
import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from silem.bodies.body import Skeleton
from silem.motion.features import Landmarks
from silem.util.errors import SilemError

SIDES = ("left", "right")
_GAIN = 0.9  # share of the gap that one step may close: the constraint is linearised


def interpolate(qpos: np.ndarray, times: np.ndarray, new_times: np.ndarray) -> np.ndarray:
    """Return poses (S, nq) at new times (S,) that lie within the times (T,) of poses (T, nq).

    Interpolation is linear, of the root's orientation along the great arc (slerp).
    """
    resampled = np.stack([np.interp(new_times, times, column) for column in qpos.T], axis=1)
    resampled[:, 3:7] = quaternions(Slerp(times, rotations(qpos))(new_times))
    return resampled


def rotations(qpos: np.ndarray) -> Rotation:
    """Return the root's orientations (T,)."""
    return Rotation.from_quat(qpos[:, 3:7], scalar_first=True)


def quaternions(orientations: Rotation) -> np.ndarray:
    """Return quaternions (T, 4), real part first, none on the other side of the one before."""
    result = orientations.as_quat(scalar_first=True)
    turns = np.where((result[1:] * result[:-1]).sum(axis=1) < 0, -1.0, 1.0)
    result[1:] *= np.cumprod(turns)[:, None]
    return result


def velocities(model: mujoco.MjModel, qpos: np.ndarray, rate_hz: float) -> np.ndarray:
    """Return velocities (T, nv) of poses (T, nq): central differences, one-sided at both ends."""
    qvel = np.zeros((len(qpos), model.nv))
    last = len(qpos) - 1
    for state, row in enumerate(qvel):
        before, after = max(state - 1, 0), min(state + 1, last)
        duration_s = (after - before) / rate_hz
        mujoco.mj_differentiatePos(model, row, duration_s, qpos[before], qpos[after])
    return qvel


def observe(
    model: mujoco.MjModel, skeleton: Skeleton, qpos: np.ndarray, qvel: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what `silem.motion.features.skeletal_features` takes, of states (T, nq), (T, nv)."""
    data, landmarks, seen = mujoco.MjData(model), Landmarks(model, skeleton), []
    for data.qpos[:], data.qvel[:] in zip(qpos, qvel, strict=True):
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        torso_axes = landmarks.oriented(data.xmat[landmarks.torso])
        velocity = data.subtree_linvel[landmarks.root].copy()
        seen.append((data.xpos[landmarks.ids], torso_axes, velocity))
    points, torso_axes, com_velocity = (np.array(column) for column in zip(*seen, strict=True))
    return points, torso_axes, com_velocity


class Soles(mink.Limit):
    """The K points of the feet that can touch the floor first: capsule ends and box corners.

    For inverse kinematics, the constraint that none of them goes below the floor z = 0. Raises
    SilemError: a foot has no shape that collides, or one that is no sphere, capsule or box.
    """

    def __init__(self, model: mujoco.MjModel, skeleton: Skeleton) -> None:
        self._model, rows = model, []
        collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
        for number, side in enumerate(SIDES):
            foot = getattr(skeleton, f"{side}_foot")
            geoms = mink.get_subtree_geom_ids(model, model.body(foot).id)
            if not collides[geoms].any():
                raise SilemError(f"foot {foot!r} has no shape that could touch the floor")
            for geom in sorted(geom for geom in geoms if collides[geom]):
                points, radius = _extremes(model, geom)
                rows += [(model.geom_bodyid[geom], point, radius, number) for point in points]
        columns = (np.array(column) for column in zip(*rows, strict=True))
        # the body that carries each point, its place in that body's frame, the radius, which foot
        self._bodies, self._offsets, self._radii, self._foot = columns

    def _centers(self, data: mujoco.MjData) -> np.ndarray:
        """Return the points in the world, (K, 3)."""
        frames = data.xmat[self._bodies].reshape(-1, 3, 3)
        return data.xpos[self._bodies] + (frames @ self._offsets[..., None])[..., 0]

    def heights(self, data: mujoco.MjData) -> np.ndarray:
        """Return how far the shape around each point is above the floor in m, (K,)."""
        return self._centers(data)[:, 2] - self._radii

    def lowest(self, qpos: np.ndarray) -> np.ndarray:
        """Return the height of each foot's lowest point in m, (T, 2), in poses (T, nq)."""
        data, lowest = mujoco.MjData(self._model), np.empty((len(qpos), len(SIDES)))
        for data.qpos[:], row in zip(qpos, lowest, strict=True):
            mujoco.mj_kinematics(self._model, data)
            heights = self.heights(data)
            row[:] = [heights[self._foot == foot].min() for foot in range(len(SIDES))]
        return lowest

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.Constraint:
        """Return G and h: a step dq with G dq <= h lowers no point by more than its height."""
        del dt  # a limit on the step, not on a velocity
        data = configuration.data
        jacobians = np.empty((len(self._bodies), 3, self._model.nv))
        for jacobian, *at in zip(jacobians, self._centers(data), self._bodies, strict=True):
            mujoco.mj_jac(self._model, data, jacobian, None, *at)
        return mink.Constraint(G=-jacobians[:, 2], h=_GAIN * self.heights(data))


def _extremes(model: mujoco.MjModel, geom: int) -> tuple[np.ndarray, float]:
    """Return the extreme points of a shape in its body's frame, (n, 3), and a radius, in m."""
    size, kind = model.geom_size[geom], mujoco.mjtGeom(model.geom_type[geom])
    extents = {
        mujoco.mjtGeom.mjGEOM_SPHERE: np.zeros(3),
        mujoco.mjtGeom.mjGEOM_CAPSULE: np.array([0, 0, size[1]]),
        mujoco.mjtGeom.mjGEOM_BOX: size,
    }
    if kind not in extents:
        name, shape = model.geom(geom).name, kind.name.removeprefix("mjGEOM_").lower()
        raise SilemError(f"shape {name!r} of a foot is a {shape}; allowed: sphere, capsule, box")
    points = np.unique(list(itertools.product((-1, 1), repeat=3)) * extents[kind], axis=0)
    radius = 0.0 if kind == mujoco.mjtGeom.mjGEOM_BOX else float(size[0])
    frame = np.empty(9)
    mujoco.mju_quat2Mat(frame, model.geom_quat[geom])
    return model.geom_pos[geom] + points @ frame.reshape(3, 3).T, radius
