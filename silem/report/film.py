"""Films: a body at rest, under a policy or along a motion; labelled grids of them; their files.

A picture is a uint8 array (H, W, 3), a `Clip` a sequence of them. Every clip comes from `rollout`
(what a policy does) or from `motion` (given poses), with one frame for every two control steps.
Clips become H.264 that every browser plays.
"""

import math
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import gymnasium
import imageio.v3 as imageio
import mujoco
import numpy as np
from dm_control.suite import humanoid_CMU
from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont
from tqdm import tqdm

import silem
from silem import bodies
from silem.bodies import Body, MujocoBody
from silem.envs import Camera
from silem.motion import demonstrator
from silem.study.evaluate import Policy, RandomPolicy, load_policy, seeded
from silem.study.runs import RunRecord
from silem.util import files, seeding
from silem.util.errors import BOUND, RATE, SilemError, choose, reason

Size = tuple[int, int]

SIZE: Size = (640, 480)
"""Width and height of a film by itself, pixels."""

PANEL: Size = (320, 440)
"""Width and height of one humanoid in a grid, pixels."""

_STEPS_PER_FRAME = 2  # 30 frames a second of runners, 20 of humanoids
_GAP = 8  # pixels between the clips of a grid; even, as a video's width has to be
_INK, _CHALK = (32, 32, 32), (245, 245, 245)
_DARK = 96  # a background of less light than this gets a label in chalk
_LABEL_SIZE = 0.055  # of the picture's height
_STRIP_WIDTH, _WEBP_WIDTH = 1500, 320
_GALLERY: Size = (480, 300)


@dataclass(frozen=True)
class Clip:
    """A body in motion: pictures (T, H, W, 3), uint8, and how many make a simulated second."""

    frames: np.ndarray
    frames_per_s: float

    @property
    def duration_s(self) -> float:
        """Length in seconds."""
        return len(self.frames) / self.frames_per_s

    def _ipython_display_(self) -> None:
        """As the last value of a cell it prints nothing: `notebook.play` has shown it."""


def rollout(
    body: Body | str,
    policy: Policy | None = None,
    *,
    duration_s: float = 6.0,
    seed: int = 0,
    size: Size = SIZE,
    progress: bool = True,
) -> Clip:
    """Film a policy, None for random actions, from the start of an episode, at most to its end.

    It acts stochastically, as in evaluation; the seed is that of the start and of its actions.
    `progress` shows a bar.

    Raises:
        SilemError: The duration is not positive, or nothing can be drawn offscreen here.
    """
    found = bodies.get(body) if isinstance(body, str) else body
    RATE.check("duration_s", duration_s)
    frame_s = _STEPS_PER_FRAME * found.control_step_s
    n_steps = (max(1, round(duration_s / frame_s)) - 1) * _STEPS_PER_FRAME
    policy = policy or RandomPolicy(found)
    drawn: dict[str, Any] = {"render_mode": "rgb_array"} if found.engine == "gymnasium" else {}
    made: Any = silem.make_vec(found, 1, seeding.child_seed(seed, "video env"), **drawn)
    with closing(made) as env, seeded(policy, seeding.child_seed(seed, "video policy")):
        env.picture_size = size
        observations: Any = env.reset()
        try:
            frames: list[Any] = [env.render()]
        except (gymnasium.error.Error, ValueError) as error:  # of environments that are not ours
            raise SilemError(f"{found.name} gives no picture: {reason(error)}") from error
        steps = range(1, n_steps + 1)
        for step in tqdm(steps, f"filming {found.name}", unit="step", disable=not progress):
            actions, _ = policy.predict(observations, deterministic=False)
            observations, _, dones, _ = env.step(actions)
            if dones[0]:  # the environment stands at its next start already
                break
            if step % _STEPS_PER_FRAME == 0:
                frames.append(env.render())
    return Clip(np.stack(frames), 1 / frame_s)


def of_runs(
    runs: Mapping[str, RunRecord | None], duration_s: float, size: Size = SIZE
) -> dict[str, Clip]:
    """Film the policies of runs by label, from one seed; blank where there is none.

    Labels now say who fell when, and where there is no run.
    """
    clips = {}
    for label, run in runs.items():
        if run is None:
            clips[f"{label}: no run yet"] = _blank(size)
            continue
        learner, policy = run.run_config.learner, load_policy(run)
        clip = rollout(learner, policy, duration_s=duration_s, size=size)
        fell = len(clip.frames) < round(duration_s * clip.frames_per_s)
        clips[f"{label}, falls at {clip.duration_s:.1f} s" if fell else label] = clip
    return clips


def _blank(size: Size) -> Clip:
    return Clip(np.full((1, *size[::-1], 3), 255, np.uint8), 1)


def motion(
    body: Body | str,
    qpos: np.ndarray,
    rate_hz: float,
    duration_s: float = math.inf,
    size: Size = SIZE,
) -> Clip:
    """Film every other one of a humanoid's poses, (T, nq), in real time; no physics acts."""
    BOUND.check("duration_s", duration_s)
    shown = qpos[np.arange(len(qpos)) / rate_hz <= duration_s][::_STEPS_PER_FRAME]
    with closing(Camera(bodies.of_kind(body, MujocoBody), *size)) as camera:
        pictures = np.stack([camera.picture(pose) for pose in shown])
    return Clip(pictures, rate_hz / _STEPS_PER_FRAME)


@cache
def man() -> MujocoBody:
    """Return the demonstrator, on dm_control's ``humanoid_CMU``, as a body for `motion`."""
    text, assets = humanoid_CMU.get_model_and_assets()
    model = mujoco.MjSpec.from_string(text, include=assets)
    return replace(
        bodies.of_kind("Humanoid", MujocoBody),
        name=demonstrator.BODY,
        description="dm_control's humanoid with the proportions of CMU's subject 8",
        build=model.to_xml,
        motors=(),
        skeleton=demonstrator.SKELETON,
        standing_pose=tuple(model.compile().qpos0.tolist()),
    )


def still(body: Body | str, size: Size = SIZE, span_m: float | None = None) -> np.ndarray:
    """Picture (H, W, 3) a body at rest, fitted to it or, with `span_m`, so many metres of it."""
    found = bodies.get(body) if isinstance(body, str) else body
    with closing(Camera(found, *size, span_m)) as camera:
        return camera.picture()


def gallery(names: Sequence[str], span_m: float, n_columns: int = 3) -> np.ndarray:
    """Picture (H, W, 3) runners at rest on one scale, each with the length that it varies by."""
    blank, stills = bool(why_no_pictures(names[0])), {}
    for name in names:
        label = f"{name}: {bodies.get(name).length[1]:g} m{', not drawn here' if blank else ''}"
        clip = _blank(_GALLERY) if blank else Clip(still(name, _GALLERY, span_m)[None], 1)
        stills[label] = clip
    return grid(stills, n_columns, 2 * _LABEL_SIZE).frames[0]


def why_no_pictures(body: str) -> str:
    """Return why a body cannot be pictured here, "" if it can: that needs OpenGL offscreen."""
    try:
        still(body, (8, 8))
    except SilemError as error:
        return str(error)
    return ""


def grid(clips: Mapping[str, Clip], n_columns: int = 3, label_size: float = _LABEL_SIZE) -> Clip:
    """Lay clips out in rows, each under its label; one that ends early holds its last frame."""
    sizes = {clip.frames.shape[1:] for clip in clips.values()}
    rates = {clip.frames_per_s for clip in clips.values() if len(clip.frames) > 1} or {1.0}
    if len(sizes) != 1 or len(rates) != 1:
        raise SilemError("the clips of a grid need one frame rate and one size, and there is none")
    n_columns, (height, width, _) = min(n_columns, len(clips)), sizes.pop()
    n_rows, n_frames = -(-len(clips) // n_columns), max(len(c.frames) for c in clips.values())
    down, across = height + _GAP, width + _GAP
    frames = np.full((n_frames, n_rows * down - _GAP, n_columns * across - _GAP, 3), 255, np.uint8)
    for index, (label, clip) in enumerate(clips.items()):
        top, left = down * (index // n_columns), across * (index % n_columns)
        shown = np.minimum(np.arange(n_frames), len(clip.frames) - 1)
        panel = frames[:, top : top + height, left : left + width]
        panel[:] = _labelled(clip, label, label_size).frames[shown]
    return Clip(frames, rates.pop())


def _labelled(clip: Clip, label: str, size: float) -> Clip:
    """Write a label, its size a share of the height, into the upper left corner of every frame."""
    height, width = clip.frames.shape[1:3]
    font = ImageFont.truetype(font_manager.findfont("DejaVu Sans"), max(9, round(size * height)))
    plate = Image.new("L", (width, height), 0)
    corner = round(size * height / 2)
    ImageDraw.Draw(plate).text((corner, corner), label, fill=255, font=font)
    ink = (np.asarray(plate, np.float32) / 255)[:, :, None]
    covered = clip.frames[:, ink[:, :, 0] > 0]
    color = _CHALK if covered.size and covered.mean() < _DARK else _INK
    frames = clip.frames * (1 - ink) + np.array(color, np.float32) * ink
    return replace(clip, frames=frames.round().astype(np.uint8))


def strip(clip: Clip, n_frames: int = 5) -> np.ndarray:
    """Lay equally spaced frames of a clip side by side, at most all: a film on paper."""
    chosen = np.linspace(0, len(clip.frames) - 1, min(n_frames, len(clip.frames)))
    whole = Image.fromarray(np.concatenate(list(clip.frames[chosen.round().astype(int)]), axis=1))
    height = max(1, round(whole.height * _STRIP_WIDTH / whole.width))
    return np.asarray(whole.resize((_STRIP_WIDTH, height), Image.Resampling.LANCZOS))


def encode_mp4(clip: Clip) -> bytes:
    """Encode a clip as H.264 (yuv420p, index first: plays while it loads), always the same bytes.

    An encoder that cannot run is a SilemError.
    """
    height, width = (size - size % 2 for size in clip.frames.shape[1:3])  # yuv420p: even sizes
    options = ["-crf", "28", "-preset", "slow", "-threads", "1", "-movflags", "+faststart"]
    options += ["-fflags", "+bitexact", "-flags:v", "+bitexact", "-map_metadata", "-1"]
    try:
        return imageio.imwrite(
            "<bytes>", clip.frames[:, :height, :width], extension=".mp4", plugin="FFMPEG",
            fps=clip.frames_per_s, codec="libx264", pixelformat="yuv420p", quality=None,
            macro_block_size=2, output_params=options, ffmpeg_log_level="error",
        )  # fmt: skip
    except (OSError, RuntimeError) as error:
        raise SilemError(f"the video encoder failed: {error}") from error


def encode_webp(clip: Clip) -> bytes:
    """Encode a clip as an animated WebP picture, small, for places that play no video."""
    height, width = clip.frames.shape[1:3]
    size = (_WEBP_WIDTH, round(_WEBP_WIDTH * height / width))
    pictures = [np.asarray(Image.fromarray(frame).resize(size)) for frame in clip.frames]
    look: dict[str, Any] = {"duration": round(1000 / clip.frames_per_s), "loop": 0, "quality": 40}
    return imageio.imwrite("<bytes>", pictures, extension=".webp", method=6, **look)


encode_png = partial(imageio.imwrite, "<bytes>", extension=".png", optimize=True)
"""Encode a picture (H, W, 3), for instance a clip's middle frame as its poster, as PNG."""

_ENCODERS = {".mp4": encode_mp4, ".webp": encode_webp}


def write(path: Path, clip: Clip) -> None:
    """Write a clip as an mp4 or a webp file, whichever its name ends in, whole or not at all."""
    files.write_bytes(path, _ENCODERS[choose("kind of film", path.suffix, _ENCODERS)](clip))
