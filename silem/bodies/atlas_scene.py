"""What Atlas looks like and stands in: dm_control's floor, sky, light and cameras; its colours."""

from __future__ import annotations

import mujoco

_WHITE = [0.72, 0.74, 0.77, 1.0]
_DARK = [0.20, 0.22, 0.26, 1.0]
_STEEL = [0.40, 0.44, 0.50, 1.0]
_BLUE = [0.16, 0.40, 0.66, 1.0]
_ORANGE = [0.93, 0.52, 0.15, 1.0]

_COLOURS = {
    "head": _ORANGE,
    "utorso": _WHITE,
    "mtorso": _DARK,
    "ltorso": _DARK,
    "pelvis": _STEEL,
    "clav": _STEEL,
    "scap": _BLUE,
    "uarm": _WHITE,
    "larm": _BLUE,
    "ufarm": _WHITE,
    "lfarm": _DARK,
    "hand": _ORANGE,
    "uglut": _DARK,
    "lglut": _DARK,
    "uleg": _WHITE,
    "lleg": _BLUE,
    "talus": _DARK,
    "foot": _ORANGE,
}


def colour(link: str) -> list[float]:
    """Return the colour (red, green, blue, opacity) of a link's shapes."""
    return _COLOURS[link.removeprefix("l_").removeprefix("r_")]


def add_scene(spec: mujoco.MjSpec) -> None:
    """Add the floor, the sky and the light settings of dm_control's humanoid."""
    spec.stat.extent, spec.stat.center = 2.0, [0.0, 0.0, 1.0]
    head = spec.visual.headlight
    head.ambient, head.diffuse, head.specular = [0.4] * 3, [0.8] * 3, [0.1] * 3
    spec.visual.map.znear = 0.01
    spec.visual.quality.shadowsize = 2048
    spec.add_texture(
        name="skybox",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.4, 0.6, 0.8],
        rgb2=[0.0, 0.0, 0.0],
        width=800,
        height=800,
        mark=mujoco.mjtMark.mjMARK_RANDOM,
        markrgb=[1.0, 1.0, 1.0],
    )
    spec.add_texture(
        name="grid",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.1, 0.2, 0.3],
        rgb2=[0.2, 0.3, 0.4],
        width=300,
        height=300,
        mark=mujoco.mjtMark.mjMARK_EDGE,
        markrgb=[0.2, 0.3, 0.4],
    )
    grid = spec.add_material(name="grid", texrepeat=[1, 1], texuniform=True, reflectance=0.2)
    grid.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "grid"
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    spec.worldbody.add_geom(name="floor", type=plane, size=[100, 100, 0.2], material="grid")


def add_views(root: mujoco.MjsBody) -> None:
    """Add the light and the two cameras that follow the body, as dm_control's humanoid has them."""
    follow = mujoco.mjtCamLight.mjCAMLIGHT_TRACKCOM
    root.add_light(name="top", pos=[0, 0, 2], mode=follow)
    views = {"back": ((-3.6, 0, 1.0), (0, -1, 0)), "side": ((0, -3.6, 1.0), (1, 0, 0))}
    for name, (position, right) in views.items():
        camera = root.add_camera(name=name, pos=position, mode=follow)
        camera.alt.type = mujoco.mjtOrientation.mjORIENTATION_XYAXES
        up = (right[1] * -0.3, right[0] * 0.3, 1)  # tilted down a little
        camera.alt.xyaxes = (*right, *up)
