"""A camera that follows a humanoid, drawn offscreen by MuJoCo."""

from __future__ import annotations

import atexit
import copy

import mujoco
import numpy as np

from silem.envs.mujoco.simulator import Simulation
from silem.util.errors import SilemError
from silem.util.offscreen import BACKEND

_AZIMUTH_DEG, _ELEVATION_DEG = 125.0, -12.0  # seen from the front left, from a little above
_LOOK_AT_M = 0.55  # share of the standing head's height that is in the middle of the picture
_DISTANCE = 2.1  # in heights of the standing head
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
        height_m = simulation.body.standing_head_m
        self._camera = mujoco.MjvCamera()
        self._camera.azimuth, self._camera.elevation = _AZIMUTH_DEG, _ELEVATION_DEG
        self._camera.distance = _DISTANCE * height_m
        self._camera.lookat[2] = _LOOK_AT_M * height_m
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
        data = self._simulation.states[0]
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
