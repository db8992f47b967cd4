"""A camera that follows a body along its track."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pybullet

from silem.bodies import Body
from silem.bodies.shapes import Shape, shapes
from silem.envs.bullet.raycast import Capsules, RayCaster
from silem.envs.bullet.simulator import Simulator
from silem.util.errors import SilemError

_VARIED = (0.91, 0.44, 0.16)  # the links whose length sets the body apart in its family
_ROOT = (0.25, 0.29, 0.36)
_LIMBS = ((0.16, 0.40, 0.66), (0.45, 0.68, 0.86))  # alternating from the root outwards
_VIEWS = {  # direction of view, height of what is looked at in m, metres seen beside the body
    "halfcheetah": ((0.0, 1.0, -0.18), 0.42, 1.5),
    "ant": ((0.45, 1.0, -0.55), 0.25, 2.7),
}


class Camera:
    """Takes pictures of a simulator's body, always from the same side, in the middle.

    HalfCheetah is seen from its right, running to the right of the picture. The links whose
    length sets a body apart in its family are orange.
    """

    def __init__(
        self,
        simulator: Simulator,
        width: int = 640,
        height: int = 480,
        span_m: float | None = None,
    ) -> None:
        """Set up the camera.

        Args:
            simulator: Whose body to show.
            width: Of the pictures, in pixels.
            height: Of the pictures, in pixels.
            span_m: Width of what is seen at the body; by default, so that the body fits. The same
                value for several bodies shows them to scale.

        Raises:
            SilemError: If the size or the span is not positive.
        """
        if min(width, height) < 1 or (span_m is not None and span_m <= 0):
            raise SilemError(f"picture of {width} x {height} pixels, {span_m} m: not positive")
        body = simulator.body
        view, self._look_at_m, margin_m = _VIEWS[body.family]
        span = span_m or margin_m + 2 ** (body.family == "ant") * body.length[1]
        self._simulator = simulator
        self._view = np.array(view) / np.linalg.norm(view)
        self._distance_m = 1.75 * span * height / width
        eye_height = self._look_at_m - self._distance_m * self._view[2]
        self._caster = RayCaster(width, height, self._view, eye_height)
        self._shapes = shapes(body)
        self._radii = np.array([shape.radius_m for shape in self._shapes])
        self._colors = np.array([_color(shape, body) for shape in self._shapes], dtype=np.float32)

    def picture(self) -> np.ndarray:
        """Return a picture (H, W, 3), uint8, of the body as it is now."""
        capsules = self._capsules()
        root = self._simulator.read().parts[0]
        eye = np.array(root) - self._distance_m * self._view
        return self._caster.draw(capsules, eye[:2])

    def _capsules(self) -> Capsules:
        """Return the body's shapes where they are now."""
        simulator = self._simulator
        ends = []
        for shape in self._shapes:
            place = simulator.place(shape.link)
            ends.append([_on_link(place, shape.start), _on_link(place, shape.end)])
        start, end = np.array(ends).swapaxes(0, 1)
        return Capsules(start, end, self._radii, self._colors)


def _on_link(place: tuple[Sequence[float], Sequence[float]], point: np.ndarray) -> Sequence[float]:
    """Return where in the world a point on a link is."""
    return pybullet.multiplyTransforms(*place, point.tolist(), (0, 0, 0, 1))[0]


def _color(shape: Shape, body: Body) -> tuple[float, float, float]:
    if shape.link in body.varied:
        return _VARIED
    return _LIMBS[shape.depth % 2] if shape.depth else _ROOT
