"""A camera that follows a body, whichever simulator moves it: MuJoCo draws it, offscreen."""

import atexit
import math

import mujoco
import numpy as np

from silem.bodies import Body, MujocoBody, measure
from silem.util.errors import SilemError
from silem.util.offscreen import BACKEND

_VARIED = (0.91, 0.44, 0.16, 1.0)  # the links whose length sets the body apart in its family
_ROOT = (0.25, 0.29, 0.36, 1.0)
_LIMBS = ((0.16, 0.40, 0.66, 1.0), (0.45, 0.68, 0.86, 1.0))  # alternating from the root outwards
_TILES = ((0.93, 0.94, 0.95), (0.84, 0.87, 0.90))
_TILE_M = 0.5
_FIELD_OF_VIEW_DEG = 32.0  # from the picture's bottom to its top
_LIGHT_FROM_M = (-1.2, -1.6, 3.5)  # seen from the root
_HAZE_M = (6.0, 28.0)  # where it begins, and where nothing is seen any more
_EXTENT_M = 4.0  # the unit of MuJoCo's distances


class Camera:
    """Takes pictures of a body, always from the same side, in the middle.

    HalfCheetah is seen from its right, running to the right of the picture. The links whose
    length sets a body apart in its family are orange.
    """

    def __init__(
        self, body: Body, width: int = 640, height: int = 480, span_m: float | None = None
    ) -> None:
        """Set up a camera for pictures of `width` times `height` pixels.

        `span_m` is what is seen at the body, in place of its view's; the same for several bodies
        shows them to scale. Raises SilemError: a size or the span is not positive, or nothing can
        be drawn offscreen here.
        """
        span_m = body.view.span_m if span_m is None else span_m
        if min(width, height) < 1 or not span_m > 0:
            raise SilemError(f"picture of {width} x {height} pixels, {span_m} m: not positive")
        self._body, self._model = body, _scene(body, width, height)
        self._data = mujoco.MjData(self._model)
        self._at_rest = _at_rest(body, self._model)
        x, y, z = body.view.direction
        self._camera = mujoco.MjvCamera()
        self._camera.azimuth = math.degrees(math.atan2(y, x))
        self._camera.elevation = math.degrees(math.atan2(z, math.hypot(x, y)))
        span_m *= 1 if isinstance(body, MujocoBody) else height / width
        self._camera.distance = span_m / 2 / math.tan(math.radians(_FIELD_OF_VIEW_DEG) / 2)
        self._camera.lookat[2] = body.view.look_at_m
        try:
            self._renderer = mujoco.Renderer(self._model, height, width)
        except Exception as error:  # each OpenGL backend raises its own kind
            raise SilemError(
                f"no offscreen rendering with MUJOCO_GL={BACKEND!r} ({error});"
                " the physics works without; allowed: egl, osmesa, or glfw with a display"
            ) from error
        # registered after MuJoCo's own end of OpenGL, so run before it
        atexit.register(self._renderer.close)
        self.picture()  # OpenGL's first differs in a few bits from the next of the same scene

    def picture(self, qpos: np.ndarray | None = None) -> np.ndarray:
        """Return a picture (H, W, 3), uint8, in a pose (nq,) in MuJoCo's order.

        None is at rest: a humanoid stands, a runner's joints are as near zero as they go.
        """
        model, data = self._model, self._data
        data.qpos[:] = self._at_rest if qpos is None else qpos
        for place in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_camlight):
            place(model, data)
        data.light_xpos[:] = data.xpos[1] + _LIGHT_FROM_M
        self._camera.lookat[:2] = data.xpos[1, :2]
        self._renderer.update_scene(data, self._camera)
        if self._body.slope_deg:  # the picture's vertical is gravity's, not the floor's
            for camera in self._renderer.scene.camera:
                up, ahead = np.array(self._body.up), camera.forward
                up -= up @ ahead * ahead
                camera.up = up / np.linalg.norm(up)
        self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_FOG] = 1
        return self._renderer.render()

    def close(self) -> None:
        """Give the renderer's memory back; closing twice is allowed."""
        atexit.unregister(self._renderer.close)
        if (context := self._renderer._gl_context) is not None:
            context.make_current()  # or the textures of whichever was last used are deleted
        self._renderer.close()


def _at_rest(body: Body, model: mujoco.MjModel) -> np.ndarray:
    if isinstance(body, MujocoBody):
        return np.array(body.standing_pose)
    qpos, limited = model.qpos0.copy(), model.jnt_limited.astype(bool)
    low, high = model.jnt_range[limited].T
    qpos[model.jnt_qposadr[limited]] = np.clip(0.0, low, high)
    return qpos


def _scene(body: Body, width: int, height: int) -> mujoco.MjModel:
    """Compile a body on a tiled floor under one light, for such pictures."""
    spec = measure.spec(body)
    kind, pattern = mujoco.mjtTexture, mujoco.mjtBuiltin
    skies = [texture for texture in spec.textures if texture.type == kind.mjTEXTURE_SKYBOX]
    for thing in (*skies, *spec.lights):
        spec.delete(thing)
    spec.stat.extent = _EXTENT_M
    look = spec.visual
    look.rgba.fog = (1, 1, 1, 1)
    look.map.fogstart, look.map.fogend = np.divide(_HAZE_M, _EXTENT_M)
    look.map.znear, look.map.zfar, look.map.shadowclip = 0.02, 20, 2
    look.quality.shadowsize = 2048
    look.headlight.ambient, look.headlight.diffuse = [0.45] * 3, [0.2] * 3
    look.headlight.specular = [0] * 3
    look.global_.offwidth, look.global_.offheight = width, height
    look.global_.fovy = _FIELD_OF_VIEW_DEG
    size = {"width": 64, "height": 64}
    white = {"builtin": pattern.mjBUILTIN_FLAT, "rgb1": [1] * 3, "rgb2": [1] * 3}
    spec.add_texture(name="haze", type=kind.mjTEXTURE_SKYBOX, **white, **size)
    tiles = {"builtin": pattern.mjBUILTIN_CHECKER, "rgb1": _TILES[0], "rgb2": _TILES[1]}
    spec.add_texture(name="tiles", type=kind.mjTEXTURE_2D, **tiles, **size)
    repeat = [0.5 / _TILE_M] * 2
    material = spec.add_material(name="tiles", texrepeat=repeat, texuniform=True, specular=0)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "tiles"
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    floors = [geom for geom in spec.worldbody.geoms if geom.type == plane]
    for floor in floors or [spec.worldbody.add_geom(type=plane, size=[0, 0, 1])]:
        floor.material, floor.rgba = "tiles", (1, 1, 1, 1)
    spec.worldbody.add_light(
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        dir=np.negative(_LIGHT_FROM_M),
        diffuse=[0.5] * 3,
        specular=[0.3] * 3,
    )
    model = spec.compile()
    _paint(body, model)
    return model


def _paint(body: Body, model: mujoco.MjModel) -> None:
    """Colour the varied links, and of bodies without colours of their own the others too."""
    depth = [-1] * model.nbody
    for link in range(1, model.nbody):
        depth[link] = depth[model.body_parentid[link]] + 1
        own = np.flatnonzero(model.geom_bodyid == link)
        if model.body(link).name in body.varied:
            model.geom_matid[own], model.geom_rgba[own] = -1, _VARIED
        elif not isinstance(body, MujocoBody):
            model.geom_rgba[own] = _LIMBS[depth[link] % 2] if depth[link] else _ROOT
