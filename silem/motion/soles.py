"""The soles of a body's feet, and the inverse kinematics' constraint to keep them off the floor."""

from __future__ import annotations

import itertools

import mink
import mujoco
import numpy as np

from silem.util.errors import SilemError

_GAIN = 0.9  # share of the gap that one step may close: the constraint is linearised


class Soles:
    """The points of the feet that can touch the floor first: capsule ends and box corners.

    Attributes:
        bodies: (K,) number of the MuJoCo body that carries each point.
        offsets: (K, 3) the point in that body's frame, in m.
        radii: (K,) radius around it, in m.
        foot: (K,) which of the feet it belongs to.

    Raises:
        SilemError: A foot has no shape that collides, or one that is no sphere, capsule or box.
    """

    def __init__(self, model: mujoco.MjModel, feet: list[str]) -> None:
        rows = []
        for number, foot in enumerate(feet):
            geoms = _colliding_geoms(model, model.body(foot).id)
            if not geoms:
                raise SilemError(f"foot {foot!r} has no shape that could touch the floor")
            for geom in geoms:
                points, radius = _extremes(model, geom)
                rows += [(model.geom_bodyid[geom], point, radius, number) for point in points]
        bodies, offsets, radii, numbers = zip(*rows, strict=True)
        self.bodies = np.array(bodies)
        self.offsets = np.array(offsets)
        self.radii = np.array(radii)
        self.foot = np.array(numbers)

    def centers(self, data: mujoco.MjData) -> np.ndarray:
        """Return the points in the world, (K, 3)."""
        frames = data.xmat[self.bodies].reshape(-1, 3, 3)
        return data.xpos[self.bodies] + (frames @ self.offsets[..., None])[..., 0]

    def heights(self, data: mujoco.MjData) -> np.ndarray:
        """Return how far the shape around each point is above the floor z = 0, in m, (K,)."""
        return self.centers(data)[:, 2] - self.radii

    def lowest(self, data: mujoco.MjData) -> np.ndarray:
        """Return the height of each foot's lowest point in m, (n_feet,)."""
        heights = self.heights(data)
        return np.array([heights[self.foot == foot].min() for foot in np.unique(self.foot)])


class FloorLimit(mink.Limit):
    """No point of the soles goes below the floor z = 0."""

    def __init__(self, model: mujoco.MjModel, soles: Soles) -> None:
        self._model = model
        self._soles = soles

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.Constraint:
        """Return G and h: a step dq with G dq <= h lowers no point by more than its height."""
        del dt  # a limit on the step, not on a velocity
        data, soles = configuration.data, self._soles
        rows = np.empty((len(soles.bodies), self._model.nv))
        jacobian = np.empty((3, self._model.nv))
        for row, point, body in zip(rows, soles.centers(data), soles.bodies, strict=True):
            mujoco.mj_jac(self._model, data, jacobian, None, point, body)
            row[:] = -jacobian[2]
        return mink.Constraint(G=rows, h=_GAIN * soles.heights(data))


def _colliding_geoms(model: mujoco.MjModel, foot: int) -> list[int]:
    """Return the shapes of a body and of what hangs on it, those only for show left out."""
    family = {foot}
    for body in range(foot + 1, model.nbody):  # MuJoCo numbers parents before children
        if model.body_parentid[body] in family:
            family.add(body)
    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    return [int(geom) for geom in np.flatnonzero(collides) if model.geom_bodyid[geom] in family]


def _extremes(model: mujoco.MjModel, geom: int) -> tuple[np.ndarray, float]:
    """Return the extreme points of a shape in its body's frame, (n, 3), and a radius, in m."""
    size = model.geom_size[geom]
    kind = mujoco.mjtGeom(model.geom_type[geom])
    radius = 0.0 if kind == mujoco.mjtGeom.mjGEOM_BOX else float(size[0])
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        points = np.zeros((1, 3))
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        points = np.array([[0, 0, -size[1]], [0, 0, size[1]]])
    elif kind == mujoco.mjtGeom.mjGEOM_BOX:
        points = np.array(list(itertools.product((-1, 1), repeat=3))) * size
    else:
        name, shape = model.geom(geom).name, kind.name.removeprefix("mjGEOM_").lower()
        raise SilemError(f"shape {name!r} of a foot is a {shape}; allowed: sphere, capsule, box")
    frame = np.empty(9)
    mujoco.mju_quat2Mat(frame, model.geom_quat[geom])
    return model.geom_pos[geom] + points @ frame.reshape(3, 3).T, radius
