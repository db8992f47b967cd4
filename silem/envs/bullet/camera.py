"""A camera that follows a body along its track, drawing it by casting one ray per pixel.

Every body here is made of capsules and spheres, for which a ray's hit has a closed form. So a few
lines of NumPy draw them round, with soft shadows and without jagged edges, on any machine and
without OpenGL; PyBullet's own software renderer turns capsules into coarse polyhedra.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pybullet

from silem.bodies import Body
from silem.bodies.mjcf import Shape, shapes
from silem.envs.bullet.simulator import Simulator
from silem.util.errors import SilemError

_VARIED = (0.91, 0.44, 0.16)  # the links whose length sets the body apart in its family
_ROOT = (0.25, 0.29, 0.36)
_LIMBS = ((0.16, 0.40, 0.66), (0.45, 0.68, 0.86))  # alternating from the root outwards

_SUPERSAMPLING = 2  # rays per pixel and axis
_FIELD_OF_VIEW_RAD = np.deg2rad(32)  # from the picture's bottom to its top
_LIGHT = np.array([-0.30, -0.40, 0.866], dtype=np.float32)  # towards the light, of length one
_BACKGROUND = np.array([1.0, 1.0, 1.0], dtype=np.float32)
_TILES = np.array([[0.93, 0.94, 0.95], [0.84, 0.87, 0.90]], dtype=np.float32)
_TILE_M = 0.5
_HAZE_M = 14.0  # the floor has faded to the background at about twice this distance
_PENUMBRA_M = 0.04
_SHADOW = 0.45  # share of light that a shadow takes
_MIN_LENGTH_M = 1e-4  # a sphere is a capsule of this length


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
        self._simulator = simulator
        self._view = np.array(body.view.direction) / np.linalg.norm(body.view.direction)
        self._distance_m = 1.75 * (span_m or body.view.span_m) * height / width
        eye_height = body.view.look_at_m - self._distance_m * self._view[2]
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

    def close(self) -> None:
        """Do nothing: there is nothing to give back."""

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


@dataclass(frozen=True)
class Capsules:
    """K capsules in the world.

    Attributes:
        start: (K, 3) centre of one cap in m.
        end: (K, 3) centre of the other, equal to `start` for a sphere.
        radius: (K,) in m.
        color: (K, 3) red, green and blue in 0..1.
    """

    start: np.ndarray
    end: np.ndarray
    radius: np.ndarray
    color: np.ndarray


class RayCaster:
    """Draws capsules from a fixed direction, standing wherever it is told to.

    The rays' directions, and so where they meet the floor, are computed once.
    """

    def __init__(self, width: int, height: int, view: np.ndarray, eye_height_m: float) -> None:
        """Prepare the rays.

        Args:
            width: Of the pictures, in pixels.
            height: Of the pictures, in pixels.
            view: (3,) direction in which to look, in the world; not straight up or down.
            eye_height_m: Height of the eye over the floor, always the same.
        """
        self._size = np.array([height, width])
        self._eye_height_m = eye_height_m
        self._focus = height / 2 / np.tan(_FIELD_OF_VIEW_RAD / 2)  # in pixels
        forward = view / np.linalg.norm(view)
        right = np.cross(forward, [0, 0, 1]) / np.hypot(forward[0], forward[1])
        self._axes = np.stack([right, np.cross(right, forward), forward])
        self._fine_rays = self._cast(_SUPERSAMPLING)
        rays = self._cast(1)
        reach = np.float32(-eye_height_m) / np.minimum(rays[..., 2], -1e-3)  # to the floor, in m
        self._floor = rays[..., :2] * reach[..., None]  # seen from the point below the eye
        self._blur = (reach / self._focus)[..., None] / np.abs(rays[..., 2:]).clip(0.05)
        clear = np.where(rays[..., 2] < 0, np.exp(-np.square(reach / _HAZE_M)), 0)
        self._clear = clear.astype(np.float32)[..., None]

    def draw(self, capsules: Capsules, eye_xy: np.ndarray) -> np.ndarray:
        """Draw the capsules as seen from a place.

        Args:
            capsules: What to draw.
            eye_xy: (2,) where to stand, in m.

        Returns:
            (height, width, 3) picture, uint8.
        """
        eye = np.array([*eye_xy, self._eye_height_m])
        ends = np.stack([capsules.start, capsules.end], axis=1)
        picture = self._draw_floor(ends, capsules.radius, eye)
        windows = [
            self._window(pair, radius, eye)
            for pair, radius in zip(ends, capsules.radius, strict=True)
        ]
        low = np.min([window[0] for window in windows], axis=0)
        high = np.max([window[1] for window in windows], axis=0)
        inside = slice(low[0], high[0]), slice(low[1], high[1])
        n = _SUPERSAMPLING
        fine = picture[inside].repeat(n, axis=0).repeat(n, axis=1)
        nearest = np.full(fine.shape[:2], np.inf)
        for index, (first, last) in enumerate(windows):
            rows, columns = (slice(n * a, n * b) for a, b in zip(first, last, strict=True))
            hit, depth, normals = hit_capsule(
                eye,
                self._fine_rays[rows, columns],
                ends[index, 0],
                ends[index, 1],
                capsules.radius[index],
            )
            y, x = np.nonzero(hit)
            place = y + rows.start - n * low[0], x + columns.start - n * low[1]
            front = depth < nearest[place]
            place = place[0][front], place[1][front]
            nearest[place] = depth[front]
            rays = self._fine_rays[rows, columns][hit][front]
            fine[place] = _shaded(capsules.color[index], normals[front], rays)
        height, width = high - low
        picture[inside] = fine.reshape(height, n, width, n, 3).mean(axis=(1, 3))
        return (255 * picture.clip(0, 1) + 0.5).astype(np.uint8)

    def _cast(self, n: int) -> np.ndarray:
        """Return the directions of n x n rays per pixel: (n height, n width, 3), float32."""
        rows, columns = n * self._size
        across = (np.arange(columns) - (columns - 1) / 2) / n
        up = ((rows - 1) / 2 - np.arange(rows)) / n
        grid = np.stack(np.broadcast_arrays(across, up[:, None], self._focus), axis=-1)
        rays = grid @ self._axes
        return (rays / np.linalg.norm(rays, axis=-1, keepdims=True)).astype(np.float32)

    def _draw_floor(self, ends: np.ndarray, radii: np.ndarray, eye: np.ndarray) -> np.ndarray:
        """Return (height, width, 3), float32: tiles under haze, with the capsules' shadows."""
        floor = self._floor + eye[:2].astype(np.float32)
        # Distance to the nearest edge of a tile, its sign changing from tile to tile; a pixel
        # that an edge crosses takes its share of both sides.
        phase = floor / _TILE_M
        edge = (0.5 - np.abs(phase % 2 - 1)) * _TILE_M
        sides = (edge / self._blur).clip(-0.5, 0.5)
        tone = 0.5 + 2 * sides[..., :1] * sides[..., 1:]
        picture = _TILES[0] + tone * (_TILES[1] - _TILES[0])
        light = np.ones_like(self._clear)
        for pair, radius in zip(ends, radii, strict=True):
            self._cast_shadow(light, floor, pair, radius, eye)
        return _BACKGROUND + self._clear * (picture * light - _BACKGROUND)

    def _window(
        self, points: np.ndarray, margin_m: float, eye: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return first and last (row, column) that may show (N, 3) points with a margin around."""
        across, up, depth = self._axes @ (points - eye).T
        depth = np.maximum(depth - margin_m, 0.1)
        centers = np.stack([-up, across]) * self._focus / depth + self._size[:, None] / 2
        reach = 1.3 * margin_m * self._focus / depth
        low = np.floor((centers - reach).min(axis=1)).clip(0, self._size).astype(int)
        high = np.ceil((centers + reach).max(axis=1)).clip(0, self._size).astype(int)
        return low, high

    def _cast_shadow(
        self, light: np.ndarray, floor: np.ndarray, ends: np.ndarray, radius: float, eye: np.ndarray
    ) -> None:
        """Take light from the floor where a capsule stands between it and the light's source."""
        reach = radius + _PENUMBRA_M
        fallen = ends - ends[:, 2:] / _LIGHT[2] * _LIGHT  # where the ends' shadows fall
        low, high = self._window(fallen, reach / _LIGHT[2], eye)
        window = slice(low[0], high[0]), slice(low[1], high[1])
        # Seen along the light everything is flat: two coordinates across it, for floor and ends.
        first = np.array([_LIGHT[2], 0, -_LIGHT[0]]) / np.hypot(_LIGHT[0], _LIGHT[2])
        across = np.stack([first, np.cross(_LIGHT, first)]).astype(np.float32)
        points = floor[window] @ across[:, :2].T
        near, far = (ends @ across.T).astype(np.float32)
        span = far - near
        points -= near
        share = (points @ span / max(float(span @ span), 1e-9)).clip(0, 1)
        points -= share[..., None] * span
        distance = np.hypot(points[..., 0], points[..., 1])
        dark = ((reach - distance) / (2 * _PENUMBRA_M)).clip(0, 1)[..., None]
        np.minimum(light[window], 1 - _SHADOW * dark, out=light[window])


def _shaded(color: np.ndarray, normals: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Return (N, 3) colours of a surface with these normals, seen along these rays."""
    diffuse = 0.5 + 0.2 * normals[:, 2] + 0.45 * (normals @ _LIGHT).clip(0)
    halfway = _LIGHT - rays
    halfway /= np.linalg.norm(halfway, axis=-1, keepdims=True)
    gloss = 0.18 * (normals * halfway).sum(axis=-1).clip(0) ** 30
    return diffuse[:, None] * color + gloss[:, None]


def hit_capsule(
    eye: np.ndarray, rays: np.ndarray, start: np.ndarray, end: np.ndarray, radius: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find where rays first meet a capsule.

    Args:
        eye: (3,) where the rays start.
        rays: (..., 3) their directions, of length one.
        start: (3,) centre of one cap.
        end: (3,) centre of the other; may equal `start`.
        radius: Of the capsule.

    Returns:
        Which rays hit (...), and for the N that do their lengths (N,) to the hit and the outward
        normals (N, 3) there.
    """
    axis = end - start
    if axis @ axis < _MIN_LENGTH_M**2:
        axis = np.array([0, 0, _MIN_LENGTH_M])
    length2 = axis @ axis
    offset = eye - start
    # The endless cylinder: distance of the ray's point from the axis equals the radius.
    ray_axis, offset_axis = rays @ axis, offset @ axis
    a = np.maximum(length2 - ray_axis**2, 1e-9)
    b = length2 * (rays @ offset) - offset_axis * ray_axis
    square = b * b - a * (length2 * (offset @ offset - radius**2) - offset_axis**2)
    hit = square >= 0
    rays = rays[hit]
    depth = (-b[hit] - np.sqrt(square[hit])) / a[hit]
    along = offset_axis + depth * ray_axis[hit]
    # Beyond the cylinder's end it is the cap there that the ray meets, or nothing.
    beyond = (along < 0) | (along > length2)
    to_cap = np.where(along[beyond, None] < 0, offset, offset - axis)
    b = (rays[beyond] * to_cap).sum(axis=-1)
    square = b * b - (np.square(to_cap).sum(axis=-1) - radius**2)
    depth[beyond] = np.where(square >= 0, -b - np.sqrt(np.maximum(square, 0)), -1)
    seen = depth > 0
    hit[hit] = seen
    depth, rays = depth[seen], rays[seen]
    point = offset + depth[:, None] * rays
    share = (point @ axis / length2).clip(0, 1)
    return hit, depth, (point - share[:, None] * axis) / radius
