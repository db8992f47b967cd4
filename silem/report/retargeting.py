"""Tables of a retargeting: limb ratios, what the hands could not reach, foot skate, starts."""

from __future__ import annotations

from collections.abc import Iterable

import mujoco
import numpy as np
import pandas as pd

from silem.envs.mujoco.simulator import body_of
from silem.motion import retargeted
from silem.motion.demonstrator import Motion
from silem.motion.features import POINTS
from silem.motion.kinematics import SIDES
from silem.motion.retargeting import (
    TARGETS,
    TOLERANCE_M,
    IKResult,
    Limbs,
    demonstration_states,
    foot_speeds_m_s,
    learner,
    standing_feet,
    targets,
)
from silem.study.config import RunConfig
from silem.study.settings import HUMAN

_OUTWARDS = {"left": 1.0, "right": -1.0}  # along the torso's axis to the left


def limb_ratios(human: Motion, results: Iterable[IKResult]) -> pd.DataFrame:
    """Return the demonstrator's limbs in m, and each learner's as ratios to them."""
    rows = {"the man's, in m": Limbs.of(human.points)}
    rows |= {f"{result.body}'s over his": result.ratios for result in results}
    labels = [name.replace("_", " ") for name in Limbs._fields]
    return pd.DataFrame(rows.values(), rows, labels).rename_axis("lengths")


def hands(human: Motion, results: Iterable[IKResult]) -> pd.DataFrame:
    """Return how far each learner's hands stay from their targets, and why.

    Args:
        human: The demonstrator's motion.
        results: The same motion on some bodies.

    Returns:
        One row per hand. The columns from "beyond" on are over the frames in which the hand is
        further from its target than the tolerance: their share, by how much the hand is too far
        forward and outward in the torso's frame, and the shares in which the target is behind the
        shoulder and in which a joint of this arm is at a limit.
    """
    return pd.DataFrame([_hand(human, result, side) for result in results for side in SIDES])


def _hand(human: Motion, result: IKResult, side: str) -> dict[str, str | float]:
    wanted = hand_targets(human, result)[:, SIDES.index(side)]
    hand, shoulder = (result.points[:, POINTS.index(f"{side}_{n}")] for n in ("hand", "shoulder"))
    distance = result.residuals[:, TARGETS.index(f"{side}_hand")]
    beyond = distance > TOLERANCE_M
    forward, left, _ = np.einsum("tij,tj->it", human.torso_axes, hand - wanted)
    ahead = np.einsum("tj,tj->t", human.torso_axes[:, 0], wanted - shoulder)
    stopped = result.at_limit[:, _arm_joints(result, side)].sum(axis=1) > 0
    return {
        "body": result.body,
        "hand": side,
        "mean (mm)": 1000 * distance.mean(),
        "worst (mm)": 1000 * distance.max(),
        "beyond (%)": 100 * beyond.mean(),
        "forward (mm)": 1000 * _mean(forward[beyond]),
        "outward (mm)": 1000 * _mean(_OUTWARDS[side] * left[beyond]),
        "behind (%)": 100 * _mean(ahead[beyond] < 0),
        "at limit (%)": 100 * _mean(stopped[beyond]),
    }


def foot_skate(human: Motion, results: Iterable[IKResult]) -> pd.DataFrame:
    """Return the speeds of the ankles in m/s while the man's feet stand: his own and the learners'.

    Args:
        human: The demonstrator's motion.
        results: The same motion on some bodies.

    Returns:
        Mean and largest speed of the left and of the right ankle, one row per body.
    """
    skates = {"the man": own_foot_skate(human)}
    skates |= {result.body: result.foot_skate_m_s for result in results}
    rows = {
        name: {
            f"{side} {what} (m/s)": of(speeds)
            for side, speeds in zip(SIDES, skate.T, strict=True)
            for what, of in (("mean", np.nanmean), ("largest", np.nanmax))
        }
        for name, skate in skates.items()
    }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("body")


def own_foot_skate(human: Motion) -> np.ndarray:
    """Return the speed of the demonstrator's own standing ankles in m/s, (T, 2); NaN in swing."""
    return np.where(standing_feet(human), foot_speeds_m_s(human.points, human.rate_hz), np.nan)


def hand_targets(human: Motion, result: IKResult) -> np.ndarray:
    """Return where the left and the right hand of a learner should be, (T, 2, 3) in m."""
    wanted = targets(human, learner(result.body)).positions
    return wanted[:, [TARGETS.index(f"{side}_hand") for side in SIDES]]


def starts(results: Iterable[IKResult]) -> pd.DataFrame:
    """Return what a SILEM run's body changes in the retargeted states to start episodes from them.

    Args:
        results: Retargetings of the study's clip.

    Returns:
        One row per body: how many states there are, in how many a joint had to be put to its
        limit, how far at most, and by how much the body was then lifted at most.
    """
    rows = []
    for result in results:
        body = body_of(RunConfig.create(result.body, "silem").learner)
        qpos, _ = demonstration_states(retargeted(HUMAN, body.name), body)
        moved = np.abs(qpos - result.qpos)
        rows.append(
            {
                "body": body.name,
                "states": len(qpos),
                "changed": int((moved[:, 7:] > 0).any(axis=1).sum()),
                "joint at most by (rad)": moved[:, 7:].max(),
                "lifted at most by (mm)": 1000 * moved[:, 2].max(),
            }
        )
    return pd.DataFrame(rows)


def _arm_joints(result: IKResult, side: str) -> np.ndarray:
    """Return which of the joints lie between the torso and the hand of a side, (J,)."""
    body = learner(result.body)
    model = mujoco.MjModel.from_xml_string(body.model_xml())
    torso = model.body(body.skeleton.torso).id
    link, arm = model.body(getattr(body.skeleton, f"{side}_hand")).id, []
    while link != torso:
        arm.append(link)
        link = model.body_parentid[link]
    return np.isin([model.joint(name).bodyid[0] for name in result.joint_names], arm)


def _mean(values: np.ndarray) -> float:
    """Return the mean, NaN where there is nothing."""
    return float(values.mean()) if len(values) else float("nan")
