"""A camera that follows a humanoid, drawn offscreen by MuJoCo."""

from __future__ import annotations

import atexit
import copy
import math

import mujoco
import numpy as np

from silem.envs.mujoco.simulator import Simulation
from silem.util.errors import SilemError
from silem.util.offscreen import BACKEND

_VARIED = (0.91, 0.44, 0.16, 1.0)  # the links whose length sets the body apart


class MujocoCamera:
    """Takes pictures of a simulation's first body, always from the same side, in the middle."""

    def __init__(self, simulation: Simulation, width: int = 640, height: int = 480) -> None:
        """Set up the camera.

        Args:
            simulation: Whose body to show.
            width: Of the pictures, in pixels.
            height: Of the pictures, in pixels.

        Raises:
            SilemError: If the size is not positive, or nothing can be drawn offscreen here.
        """
        if min(width, height) < 1:
            raise SilemError(f"picture of {width} x {height} pixels: not positive")
        self._simulation = simulation
        self._model = _painted(simulation, width, height)
        view = simulation.body.view
        x, y, z = view.direction
        self._camera = mujoco.MjvCamera()
        self._camera.azimuth = math.degrees(math.atan2(y, x))
        self._camera.elevation = math.degrees(math.atan2(z, math.hypot(x, y)))
        half_angle_rad = math.radians(self._model.vis.global_.fovy) / 2
        self._camera.distance = view.span_m / 2 / math.tan(half_angle_rad)
        self._camera.lookat[2] = view.look_at_m
        try:
            self._renderer = mujoco.Renderer(self._model, height, width)
        except Exception as error:  # each OpenGL backend raises its own kind
            raise SilemError(
                f"no offscreen rendering with MUJOCO_GL={BACKEND!r} ({error});"
                " the physics works without; allowed: egl, osmesa, or glfw with a display"
            ) from error
        # registered after MuJoCo's own end of OpenGL, so run before it
        atexit.register(self._renderer.close)

    def picture(self) -> np.ndarray:
        """Return a picture (H, W, 3), uint8, of the body as it is now."""
        data = self._simulation.data()
        self._camera.lookat[:2] = data.qpos[:2]
        self._renderer.update_scene(data, self._camera)
        return self._renderer.render()

    def close(self) -> None:
        """Give the renderer's memory back; closing twice is allowed."""
        atexit.unregister(self._renderer.close)
        self._renderer.close()


def _painted(simulation: Simulation, width: int, height: int) -> mujoco.MjModel:
    """Return a copy of the model for such pictures, its varied links in another colour."""
    model = copy.copy(simulation.model)
    model.vis.global_.offwidth, model.vis.global_.offheight = width, height
    for link in simulation.body.varied:
        for geom in np.flatnonzero(model.geom_bodyid == model.body(link).id):
            model.geom_matid[geom] = -1
            model.geom_rgba[geom] = _VARIED
    return model
