"""Limb distances: how far hands and feet are from the torso, ours beside the paper's.

The paper explains with them why Peng20, TPIL and SILEM⁻ do better on Atlas than on the others.
"""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
import pandas as pd
from pandas.io.formats.style import Styler

from silem import bodies, paper
from silem.bodies import MujocoBody, Skeleton
from silem.motion import demonstrator
from silem.motion.features import POINTS, Landmarks
from silem.report.tables import DASH, number, styled
from silem.util.errors import SilemError

DEMONSTRATOR = "demonstrator"
LIMBS = ("left_foot", "right_foot", "left_hand", "right_hand")

_PRINTED = (DEMONSTRATOR, "Humanoid", "Atlas")  # the paper's order
_EQUAL_M = 0.005  # left and right are written as one number where they differ by less


def measured() -> dict[str, dict[str, float]]:
    """Measure the demonstrator and every humanoid with all joints at zero.

    Returns:
        Name of the body -> name of the limb (`LIMBS`) -> distance from the torso in m.
    """
    found = {DEMONSTRATOR: distances(demonstrator.model(), demonstrator.SKELETON)}
    for name in bodies.names("humanoid"):
        body = bodies.of_kind(name, MujocoBody)
        model = mujoco.MjModel.from_xml_string(body.model_xml())
        found[name] = distances(model, body.skeleton)
    return found


def distances(model: mujoco.MjModel, skeleton: Skeleton) -> dict[str, float]:
    """Return the distances in m of a model's hands and feet from its torso, all joints at zero."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    points = Landmarks(model, skeleton).points(data)
    from_torso = np.linalg.norm(points - points[POINTS.index("torso")], axis=1)
    return {limb: float(from_torso[POINTS.index(limb)]) for limb in LIMBS}


def table(found: Mapping[str, Mapping[str, float]]) -> Styler:
    """Return a table of limb distances: the paper's, ours, and the difference.

    Args:
        found: Distances in m by body and limb, from `measured`.

    Raises:
        SilemError: Some body lacks a limb.
    """
    printed = {
        part: dict(zip(_PRINTED, paper.number(f"{part}_distances"), strict=True))
        for part in ("feet", "hand")
    }
    rows = []
    for body, limbs in found.items():
        if missing := [limb for limb in LIMBS if limb not in limbs]:
            raise SilemError(f"no distance of {', '.join(missing)} on {body}")
        row = {("", "body"): body}
        for part, limb in (("feet", "foot"), ("hand", "hand")):
            ours = [limbs[f"{side}_{limb}"] for side in ("left", "right")]
            theirs = printed[part].get(body)
            heading = f"{'feet' if part == 'feet' else 'hands'} from the torso (m)"
            row[heading, "paper"] = number(theirs, 2)
            row[heading, "ours"] = _pair(ours)
            row[heading, "difference"] = DASH if theirs is None else _signed(np.mean(ours) - theirs)
        rows.append(row)
    columns = pd.MultiIndex.from_tuples(list(rows[0]))
    return styled(pd.DataFrame([list(row.values()) for row in rows], columns=columns))


def _pair(values: list[float]) -> str:
    left, right = values
    if abs(left - right) < _EQUAL_M:
        return number((left + right) / 2, 2)
    return f"{number(left, 2)} left, {number(right, 2)} right"


def _signed(value: float) -> str:
    rounded = round(float(value), 2) + 0.0  # never a negative zero
    return ("+" if rounded > 0 else "") + number(rounded, 2)
