"""Peng20's demonstrations: a clip retargeted to each humanoid, published with how well it went."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from silem import bodies, paper
from silem.bodies import atlas
from silem.bodies.body import MujocoBody
from silem.motion import demonstrations as demos
from silem.motion.clips import published_motion, published_name
from silem.motion.demonstrations import Demonstrations
from silem.motion.inverse_kinematics import SOLVER
from silem.motion.retarget import TOLERANCE_M, IKResult, retarget_clip
from silem.motion.targets import SIDES, TARGETS, Limbs
from silem.study.settings import retargeted

BODIES = ("Humanoid", "HumanoidR", "Atlas")

RETARGETING_VERSION = 1
"""How a motion becomes a learner's: to be raised, and all published anew, when numbers change."""

_ARRAYS = (
    "qpos",
    "qvel",
    "points",
    "residuals",
    "torso_tilt_rad",
    "converged",
    "at_limit",
    "foot_skate_m_s",
    "raised_m",
    "sole_height_m",
)
_COPIED = ("source", "source_sha256", "licence", "acknowledgement")  # from the clip's entry


def learner(name: str) -> MujocoBody:
    """Return a humanoid as Peng20 has it: Atlas with the ankles of its best combination."""
    if name == "Atlas":
        return atlas.body(paper.best_combination(name, "peng20")["ankle_range_rad"])
    return bodies.of_kind(name, MujocoBody)


def summary(result: IKResult) -> dict[str, Any]:
    """Return the figures of a retargeting that the pages and the manifest show.

    Returns:
        Residuals in mm (mean and worst per target), the share of frames that converged, the
        torso's largest tilt in degrees, foot skate in m/s (mean and worst per foot), the mean
        speed in m/s, and per joint the share of frames in which it is at a limit, if any.
    """
    residuals_mm = dict(zip(TARGETS, 1000 * result.residuals.T, strict=True))
    skates = dict(zip(SIDES, result.foot_skate_m_s.T, strict=True))
    shares = dict(zip(result.joint_names, result.at_limit.mean(axis=0), strict=True))
    way_m = np.linalg.norm(result.points[-1, 0, :2] - result.points[0, 0, :2])
    return {
        "residual_mean_mm": {name: _rounded(mm.mean()) for name, mm in residuals_mm.items()},
        "residual_worst_mm": {name: _rounded(mm.max()) for name, mm in residuals_mm.items()},
        "converged_share": _rounded(result.converged.mean()),
        "torso_tilt_worst_deg": _rounded(np.degrees(result.torso_tilt_rad.max())),
        "foot_skate_mean_m_s": {side: _rounded(np.nanmean(v)) for side, v in skates.items()},
        "foot_skate_worst_m_s": {side: _rounded(np.nanmax(v)) for side, v in skates.items()},
        "speed_m_s": _rounded(way_m * result.rate_hz / (len(result.points) - 1)),
        "at_limit_share": {name: _rounded(share) for name, share in shares.items() if share > 0},
    }


def publish_retargeted(clip: str = "08_01", *, progress: bool = False) -> list[Path]:
    """Retarget a published clip to the three humanoids, and publish the result.

    Args:
        clip: Which of `silem.motion.demonstrator.CLIPS`.
        progress: Show progress bars.

    Returns:
        The files, one per body; the same clip always gives the same bytes.

    Raises:
        SilemError: The clip was not published, or as `retarget_clip`, or another process is
            publishing.
    """
    motion = published_motion(clip)
    written = []
    with demos.publishing():
        for body in BODIES:
            result = retarget_clip(motion, learner(body), progress_bar=progress)
            extra = {array: getattr(result, array) for array in _ARRAYS}
            demonstrations = Demonstrations((result.features,), body=body, extra=extra)
            name = retargeted(published_name(clip), body)
            written.append(demos.publish(name, demonstrations, _about(result)))
    return written


def published_retargeting(body: str, clip: str = "08_01") -> IKResult:
    """Return the retargeting that was published for a body.

    Raises:
        SilemError: It was not published, or its file is damaged.
    """
    name = retargeted(published_name(clip), body)
    about, there = demos.entry(name), Demonstrations.load(name)
    return IKResult(
        body=body,
        motion=clip,
        rate_hz=about["rate_hz"],
        features=there.features[0],
        joint_names=tuple(about["joint_names"]),
        ratios=Limbs(**about["limb_ratios"]),
        **there.extra,
    )


def _about(result: IKResult) -> dict[str, Any]:
    """Return what the manifest says of a retargeted clip."""
    name = published_name(result.motion)
    clip = demos.entry(name)
    return {
        "clip": result.motion,
        "retargeted_from": name,
        "retargeted_from_sha256": clip["sha256"],
        **{key: clip[key] for key in _COPIED},
        "rate_hz": result.rate_hz,
        "n_states": len(result.features),
        "solver": f"mink {version('mink')}, {SOLVER} {version(SOLVER)}",
        "tolerance_m": TOLERANCE_M,
        "limb_ratios": {limb: float(ratio) for limb, ratio in result.ratios._asdict().items()},
        "joint_names": list(result.joint_names),
        "summary": summary(result),
        "retargeting_version": RETARGETING_VERSION,
    }


def _rounded(value: float | np.floating[Any]) -> float:
    return round(float(value), 3)
