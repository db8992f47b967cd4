"""HC0, HC1 and HC2: HalfCheetah with a torso of length 1, 2 and 3 (Figure 2a)."""

from functools import partial

from silem.bodies.body import AliveRule, BulletBody, Motor, Part, View, pybullet_model

FAMILY = "halfcheetah"

TORSO_LENGTHS_M = {"HC0": 1.0, "HC1": 2.0, "HC2": 3.0}

_POWER = 0.90  # of PyBullet's HalfCheetah task, on top of each joint's coefficient
_COEFFICIENTS = {"bthigh": 120, "bshin": 90, "bfoot": 60, "fthigh": 140, "fshin": 60, "ffoot": 30}
_LOWER_LIMBS = ("bshin", "bfoot", "fshin", "ffoot")
_HEAD_OVERHANG_M = 0.1  # from the torso's front end to the middle of the head


def model(torso_length_m: float) -> str:
    """Return the MJCF text of a HalfCheetah with a torso of the given length.

    The torso's capsule is stretched; the head and both thighs keep hanging on its ends. Length 1
    is PyBullet's own file, byte for byte.
    """
    half = torso_length_m / 2
    edits = {
        ("geom", "torso", "fromto"): (-half, 0, 0, half, 0, 0),
        ("geom", "head", "pos"): (half + _HEAD_OVERHANG_M, 0, 0.1),
        ("body", "bthigh", "pos"): (-half, 0, 0),
        ("body", "fthigh", "pos"): (half, 0, 0),
    }
    original = torso_length_m == TORSO_LENGTHS_M["HC0"]
    return pybullet_model("half_cheetah.xml", {} if original else edits)


def body(name: str, torso_length_m: float) -> BulletBody:
    """Return the registry entry of a HalfCheetah with a torso of the given length."""
    return BulletBody(
        name=name,
        family=FAMILY,
        description=f"HalfCheetah with a torso of length {torso_length_m:g}",
        build=partial(model, torso_length_m),
        root="torso",
        root_joints=("ignorex", "ignorez", "ignorey"),
        motors=tuple(Motor(joint, _POWER * c) for joint, c in _COEFFICIENTS.items()),
        feet=("ffoot", "fshin", "fthigh", "bfoot", "bshin", "bthigh"),
        # 17 parts: PyBullet splits each limb into a massless link and the limb proper, which
        # coincide, and the torso into four; the last part is the floor. The thighs hang on the
        # torso's ends, opposite around its centre, so the torso stands for them.
        parts=(Part("torso", 4 + 2 * 2), *(Part(limb, 2) for limb in _LOWER_LIMBS)),
        n_parts=17,
        alive=AliveRule(max_pitch_rad=1.0, no_contact=("fshin", "fthigh", "bshin", "bthigh")),
        length=("length of the torso", torso_length_m),
        varied=("torso",),
        view=View((0.0, 1.0, -0.18), look_at_m=0.42, span_m=1.5 + torso_length_m),
    )


NAMED = {"HC-#": body}
"""Bodies that are named by a number in the place of #: this one by the length of its torso in m."""

BODIES = {name: partial(body, name, length) for name, length in TORSO_LENGTHS_M.items()}
