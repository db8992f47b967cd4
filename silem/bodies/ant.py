"""Ant0 to Ant6: Ant with longer links next to its body (Figure 2c)."""

from functools import partial

from silem.bodies.body import AliveRule, BulletBody, Motor, Part, View, pybullet_model

FAMILY = "ant"

LINK_OFFSETS = {f"Ant{i}": round(0.20 + 0.05 * i, 2) for i in range(7)}

_POWER = 2.5 * 100.0  # PyBullet's Ant task: its power times the default joint coefficient
_LEG_SIGNS = {1: (1, 1), 2: (-1, 1), 3: (-1, -1), 4: (1, -1)}  # of x and y, by leg number
_FEET = ("front_left_foot", "front_right_foot", "left_back_foot", "right_back_foot")


def model(offset: float) -> str:
    """Return the MJCF text of an Ant whose innermost links reach `offset` in x and in y.

    In the model that link is the geom `aux_i_geom`, and the body `aux_i` hangs on its end; an
    offset of 0.2 is PyBullet's own file, byte for byte.
    """
    edits: dict[tuple[str, str, str], tuple[float, ...]] = {}
    for leg, (x, y) in _LEG_SIGNS.items():
        end = (x * offset, y * offset, 0.0)
        edits["geom", f"aux_{leg}_geom", "fromto"] = (0.0, 0.0, 0.0, *end)
        edits["body", f"aux_{leg}", "pos"] = end
    return pybullet_model("ant.xml", {} if offset == LINK_OFFSETS["Ant0"] else edits)


def body(name: str, offset: float) -> BulletBody:
    """Return the registry entry of an Ant whose innermost links have the given offset."""
    return BulletBody(
        name=name,
        family=FAMILY,
        description=f"Ant whose links closest to the body have offset {offset:.2f}",
        build=partial(model, offset),
        root="torso",
        root_joints=(),
        motors=tuple(
            Motor(f"{joint}_{leg}", _POWER) for leg in _LEG_SIGNS for joint in ("hip", "ankle")
        ),
        feet=_FEET,
        # 22 parts: the torso, the floor, and per leg the inner link, the hip's massless link,
        # aux, the ankle's massless link and the foot. Inner links and hips are opposite in pairs
        # around the torso and stand for it, eight times; aux's centre lies halfway between hip
        # and ankle, so each aux and ankle make 1.5 ankles and, through the hip, half a torso.
        # A foot's frame is its ankle's; an inner link's frame is the torso's. (The torso itself
        # would not do: the positions PyBullet reports for links trail the base's by a substep.)
        parts=(
            Part("torso", 1),
            Part("front_left_leg", 8 + 4 * 0.5, "origin"),
            *(Part(foot, 1.5, "origin") for foot in _FEET),
            *(Part(foot, 1) for foot in _FEET),
        ),
        n_parts=22,
        alive=AliveRule(min_height_m=0.26, terminates=True),
        length=("offset of the links closest to the body", offset),
        varied=("front_left_leg", "front_right_leg", "left_back_leg", "right_back_leg"),
        view=View((0.45, 1.0, -0.55), look_at_m=0.25, span_m=2.7 + 2 * offset),
    )


NAMED = {"Ant-#": body}
"""Bodies that are named by a number in the place of #: this one by its links' offset in m."""

BODIES = {name: partial(body, name, offset) for name, offset in LINK_OFFSETS.items()}
