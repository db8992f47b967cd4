"""The demonstrator's clips as published demonstrations: written once, read with no raw file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tqdm import tqdm

from silem.motion import demonstrations as demos
from silem.motion import fetch
from silem.motion.demonstrations import Demonstrations
from silem.motion.demonstrator import (
    BODY,
    CAPTURE_RATE_HZ,
    CLIPS,
    FLOOR_SLOPE,
    Motion,
    load_motion,
)

FEATURES_VERSION = 1
"""How a clip becomes features: to be raised, and the clips published anew, when numbers change."""

_EXTRA = ("qpos", "qvel", "points", "torso_axes", "com_velocity")


def published_name(clip: str) -> str:
    """Return the name of a clip's demonstrations: "cmu_08_01" for the clip "08_01"."""
    return f"cmu_{clip}"


def demonstrations_of(motion: Motion) -> Demonstrations:
    """Return a motion as demonstrations of one trajectory, all else about it as extra arrays."""
    extra = {name: getattr(motion, name) for name in _EXTRA}
    return Demonstrations((motion.features,), body=BODY, extra=extra)


def published_motion(clip: str) -> Motion:
    """Return the motion that was published for a clip, one of `CLIPS`.

    Raises:
        SilemError: It was not published, or its file is damaged.
    """
    about = demos.entry(published_name(clip))
    there = Demonstrations.load(published_name(clip))
    return Motion(
        name=clip,
        rate_hz=about["rate_hz"],
        features=there.features[0],
        repairs=tuple(about["repairs"]),
        **there.extra,
    )


def publish_clips(clips: Sequence[str] = CLIPS, *, progress: bool = False) -> list[Path]:
    """Compute clips from the raw files (`silem.motion.fetch`) and publish them.

    Args:
        clips: Which ones.
        progress: Show a progress bar.

    Returns:
        The files, one per clip; the same clip always gives the same bytes.

    Raises:
        SilemError: As `load_motion`, or another process is publishing.
    """
    written = []
    with demos.publishing():
        for clip in tqdm(clips, "clips", disable=not progress):
            motion = load_motion(clip)
            written.append(
                demos.publish(published_name(clip), demonstrations_of(motion), _about(motion))
            )
    return written


def _about(motion: Motion) -> dict[str, Any]:
    """Return what the manifest says of a clip."""
    subject = motion.name.partition("_")[0]
    source = f"{subject}/{motion.name}.amc"
    return {
        "clip": motion.name,
        "source": fetch.URL + source,
        "source_sha256": fetch.SHA256[source],
        "skeleton_source": f"{fetch.URL}{subject}/{subject}.asf",
        "licence": fetch.LICENCE,
        "acknowledgement": fetch.ACKNOWLEDGEMENT,
        "capture_rate_hz": CAPTURE_RATE_HZ,
        "rate_hz": motion.rate_hz,
        "n_states": len(motion.features),
        "duration_s": round(motion.duration_s, 6),
        "speed_m_s": round(motion.speed_m_s, 6),
        "floor_slope": FLOOR_SLOPE,
        "repairs": list(motion.repairs),
        "features_version": FEATURES_VERSION,
    }
