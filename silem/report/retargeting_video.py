"""Retargeted motions on film, in step beside the man who was captured."""

from __future__ import annotations

from collections.abc import Sequence

from silem.motion.demonstrator import Motion
from silem.motion.retargeting import IKResult, learner
from silem.report import motion_video, rendering
from silem.report.motion_video import STATES_PER_PICTURE
from silem.report.video import Clip, side_by_side
from silem.util.errors import SilemError

_WIDTH, _HEIGHT = 320, 440  # pixels of one panel


def beside(human: Motion, results: Sequence[IKResult], duration_s: float) -> Clip:
    """Film the demonstrator and his motion on other bodies, side by side and in real time.

    No physics acts: each body is put into one pose after the other, seen by a camera that goes
    along with it.

    Args:
        human: The demonstrator's motion.
        results: The same motion retargeted, one panel each.
        duration_s: How much of it to film, from its beginning; the whole motion if that is shorter.

    Raises:
        SilemError: The duration is not positive, or nothing can be drawn offscreen here.
    """
    if not duration_s > 0:
        raise SilemError(f"duration_s = {duration_s} is not a positive number of seconds")
    bodies = [motion_video.demonstrator(), *(learner(result.body) for result in results)]
    labels = ["the man", *(result.body for result in results)]
    shown = slice(0, int(duration_s * human.rate_hz) + 1, STATES_PER_PICTURE)
    rate_hz = human.rate_hz / STATES_PER_PICTURE
    qpos = [human.qpos, *(result.qpos for result in results)]
    clips = [
        rendering.motion(body, states[shown], rate_hz, _WIDTH, _HEIGHT)
        for body, states in zip(bodies, qpos, strict=True)
    ]
    return side_by_side(clips, labels)
