"""Clips, their cutting and their files; films of real bodies."""

from __future__ import annotations

import base64
import dataclasses
import subprocess
from contextlib import closing
from pathlib import Path
from typing import ClassVar

import gymnasium
import imageio_ffmpeg
import numpy as np
import pytest
import synthetic_records as synthetic
import torch
from IPython.core.formatters import DisplayFormatter
from PIL import Image

import silem
from silem import bodies
from silem.report import film, notebook
from silem.report.film import Clip
from silem.study.config import RunConfig
from silem.util.errors import SilemError

SMALL = 160, 120

needs_pictures = pytest.mark.skipif(
    bool(film.why_no_pictures("Humanoid")), reason="nothing can be drawn offscreen here"
)


def gradient_clip(n_frames: int = 12, height: int = 90, width: int = 120) -> Clip:
    """A clip whose frames brighten from left to right and from first to last."""
    ramp = np.linspace(60, 160, width)[None, None, :, None]
    light = np.linspace(0, 80, n_frames)[:, None, None, None]
    frames = np.broadcast_to(ramp + light, (n_frames, height, width, 3))
    return Clip(frames.round().astype(np.uint8), 30.0)


# ---------------------------------------------------------------- files


def decode(path: Path) -> tuple[dict, np.ndarray]:
    with closing(imageio_ffmpeg.read_frames(str(path))) as reader:
        meta = next(reader)
        width, height = meta["size"]
        frames = [np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in reader]
    return meta, np.stack(frames)


def test_mp4_is_what_browsers_play_and_shows_the_frames(tmp_path: Path) -> None:
    clip = gradient_clip(height=91, width=121)  # of odd sizes a row and a column are lost
    film.write(tmp_path / "clip.mp4", clip)
    meta, frames = decode(tmp_path / "clip.mp4")
    assert meta["codec"] == "h264"
    assert meta["pix_fmt"].startswith("yuv420p")
    assert meta["fps"] == pytest.approx(clip.frames_per_s, rel=1e-3)
    assert frames.shape == (12, 90, 120, 3)
    assert np.abs(frames.astype(int) - clip.frames[:, :90, :120]).mean() < 4
    data = (tmp_path / "clip.mp4").read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")  # plays before it is wholly loaded


def test_mp4_bytes_depend_on_the_clip_alone() -> None:
    first, again = film.encode_mp4(gradient_clip()), film.encode_mp4(gradient_clip())
    assert first == again
    assert first != film.encode_mp4(gradient_clip(n_frames=13))


def test_failed_write_keeps_the_file_that_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "clip.mp4"
    path.write_bytes(b"before")
    monkeypatch.setattr(imageio_ffmpeg._io, "get_ffmpeg_exe", lambda: str(tmp_path / "nowhere"))
    with pytest.raises(SilemError, match="video encoder"):
        film.write(path, gradient_clip())
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


def test_a_film_is_written_as_its_name_says(tmp_path: Path) -> None:
    clip = gradient_clip()
    film.write(tmp_path / "clip.webp", clip)
    with Image.open(tmp_path / "clip.webp") as picture:
        assert (picture.format, picture.width) == ("WEBP", 320)
        assert picture.n_frames > 1  # frames that look the same become one
    with pytest.raises(SilemError, match="unknown kind of film"):
        film.write(tmp_path / "clip.gif", clip)


def test_png_round_trips() -> None:
    picture = gradient_clip().frames[3]
    decoded = subprocess.run(
        [imageio_ffmpeg.get_ffmpeg_exe(), "-loglevel", "error", "-i", "-", "-f", "rawvideo",
         "-pix_fmt", "rgb24", "-"],
        input=film.encode_png(picture), capture_output=True, check=True,
    ).stdout  # fmt: skip
    assert np.array_equal(np.frombuffer(decoded, np.uint8).reshape(picture.shape), picture)


# ---------------------------------------------------------------- cutting


def test_strip_takes_first_and_last_and_equal_steps_between() -> None:
    clip = gradient_clip(n_frames=13, width=375)  # four of them are as wide as a strip
    picture = film.strip(clip, 4)
    assert picture.shape == (90, 1500, 3)
    for part, index in zip(np.split(picture, 4, axis=1), (0, 4, 8, 12), strict=True):
        assert np.array_equal(part, clip.frames[index])
    assert np.array_equal(film.strip(clip, 40), film.strip(clip, 13))  # all there are


def test_a_grid_labels_each_clip_and_holds_its_last_frame() -> None:
    clips = {name: gradient_clip(n) for name, n in (("a", 12), ("b", 5), ("c", 7))}
    made = film.grid(clips, n_columns=2)
    assert made.frames.shape == (12, 90 + 8 + 90, 120 + 8 + 120, 3)
    assert made.frames_per_s == 30.0
    assert (made.frames[:, :, 120:128] == 255).all() and (made.frames[:, 98:, 128:] == 255).all()
    for (top, left), clip in zip(((0, 0), (0, 128), (98, 0)), clips.values(), strict=True):
        panel = made.frames[:, top : top + 90, left : left + 120]
        shown = [*clip.frames, *[clip.frames[-1]] * (12 - len(clip.frames))]
        changed = (panel != shown).any(axis=-1)
        assert changed.any(axis=(1, 2)).all()  # the label
        assert not changed[:, 30:].any() and not changed[:, :, 90:].any()  # in its corner
        assert (panel[changed] < np.stack(shown)[changed]).all()  # in dark ink
    night = Clip(clips["a"].frames // 3, 30.0)
    lit = film.grid({"a": night}).frames
    assert (lit >= night.frames).all() and (lit > night.frames).any()


@pytest.mark.parametrize("other", [Clip(gradient_clip().frames, 25.0), gradient_clip(height=80)])
def test_a_grid_refuses_what_does_not_fit(other: Clip) -> None:
    for clips in ({"a": gradient_clip(), "b": other}, {}):
        with pytest.raises(SilemError, match="one frame rate and one size"):
            film.grid(clips)


# ---------------------------------------------------------------- runners


class Recorder:
    """A policy that stands still and remembers how it was called."""

    def __init__(self) -> None:
        self.calls: list[object] = []

    def reseed(self, seed: int) -> None:
        self.calls.append(seed)

    def predict(self, observation: np.ndarray, *, deterministic: bool = False) -> tuple:
        self.calls.append("mean" if deterministic else "sampled")
        return np.zeros((len(observation), 6), np.float32), None


def rollout(body: str, duration_s: float, **options: object) -> Clip:
    return film.rollout(body, duration_s=duration_s, size=SMALL, **options)


def test_rollout_plays_at_real_speed_and_depends_on_its_seed_alone() -> None:
    clip, again, other = (rollout("HC0", 0.2, seed=seed) for seed in (3, 3, 4))
    assert clip.frames.shape == (6, 120, 160, 3) and clip.frames.dtype == np.uint8
    assert clip.duration_s == pytest.approx(0.2, abs=0.01)
    assert (clip.frames[1:] != clip.frames[:-1]).any(axis=(1, 2, 3)).all()
    assert np.array_equal(clip.frames, again.frames)
    assert not np.array_equal(clip.frames, other.frames)


class Painted(gymnasium.Env):
    """Draws a grey that is lighter with each step, or nothing."""

    metadata: ClassVar = {"render_modes": ["rgb_array"]}
    observation_space = action_space = gymnasium.spaces.Box(-1, 1, (2,))

    def __init__(self, render_mode: str | None = None, paints: bool = True) -> None:
        self.render_mode, self.paints = render_mode, paints

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple:
        super().reset(seed=seed)
        self.steps = 0
        return np.zeros(2, np.float32), {}

    def step(self, action: np.ndarray) -> tuple:
        self.steps += 1
        return np.zeros(2, np.float32), 0.0, False, False, {}

    def render(self) -> np.ndarray | None:
        if not self.paints:
            raise gymnasium.error.DependencyNotInstalled("pygame is not installed")
        return np.full((12, 16, 3), self.steps, np.uint8)


def test_any_environment_that_draws_is_filmed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gymnasium.envs.registration, "registry", dict(gymnasium.registry))
    for name, paints in (("Painted-v0", True), ("Blank-v0", False)):
        options = {"paints": paints}
        gymnasium.register(name, entry_point=Painted, max_episode_steps=30, kwargs=options)
    frames = rollout("Painted-v0", 0.2).frames
    assert frames[:, 0, 0, 0].tolist() == list(range(0, 2 * len(frames), 2))
    with pytest.raises(SilemError, match=r"Blank-v0 gives no picture: pygame is not installed"):
        rollout("Blank-v0", 0.2)


def test_rollout_samples_actions_and_restarts_the_policy() -> None:
    policy = Recorder()
    for _ in range(2):
        rollout("HC0", 0.1, policy=policy, seed=5)
    once, again = policy.calls[: len(policy.calls) // 2], policy.calls[len(policy.calls) // 2 :]
    assert once == again
    assert isinstance(once[0], int)
    assert once[1:] == ["sampled"] * 4


def test_films_of_policies_that_sample_from_torch_depend_on_the_seed_alone() -> None:
    class Sampled:
        def predict(self, observation: np.ndarray, *, deterministic: bool = False) -> tuple:
            return torch.randn(len(observation), 6).clamp(-1, 1).numpy(), None

    policy, clips = Sampled(), []
    for state in (1, 2):
        torch.manual_seed(state)
        clips.append(rollout("HC0", 0.2, policy=policy, seed=5))
    assert np.array_equal(clips[0].frames, clips[1].frames)
    assert not np.array_equal(clips[0].frames, rollout("HC0", 0.2, policy=policy).frames)


def test_rollout_ends_with_the_episode_and_the_label_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    monkeypatch.setattr(film, "load_policy", lambda run: None)
    runs = {"PPO": synthetic.write_record(RunConfig.create("HC0", "ppo"))}
    (label, whole), none = film.of_runs(runs | {"TPIL": None}, 0.21, SMALL).items()
    assert (label, len(whole.frames)) == ("PPO", 6)
    assert none[0] == "TPIL: no run yet" and (none[1].frames == 255).all()
    assert film.grid({label: whole, none[0]: none[1]}).frames_per_s == whole.frames_per_s
    make_vec = silem.make_vec
    monkeypatch.setattr(silem, "make_vec", lambda *a, **k: make_vec(*a, **k, max_steps=5))
    ((label, cut),) = film.of_runs(runs, 0.21, SMALL).items()
    assert label == "PPO, falls at 0.1 s"
    # after 0, 2 and 4 steps; the fifth ends the episode
    assert np.array_equal(cut.frames, whole.frames[:3])


@pytest.mark.parametrize("duration_s", [0.0, -1.0, float("nan"), float("inf")])
def test_rollout_refuses_a_duration_that_is_none(duration_s: float) -> None:
    with pytest.raises(SilemError, match="duration_s must be a finite number above 0"):
        rollout("HC0", duration_s)


def test_rollout_refuses_an_unknown_body() -> None:
    with pytest.raises(SilemError, match="unknown body 'HC9'"):
        rollout("HC9", 0.1)


def orange_width(picture: np.ndarray) -> int:
    """How many columns show the link that sets the body apart."""
    red, green, blue = (picture[:, :, i].astype(int) for i in range(3))
    return int(((red - blue > 80) & (red > green + 40)).any(axis=0).sum())


def test_stills_at_one_span_are_to_scale() -> None:
    widths = [orange_width(film.still(name, (300, 200), 4.5)) for name in ("HC0", "HC1", "HC2")]
    steps = np.diff(widths)
    assert steps[0] > 30
    assert steps[0] == pytest.approx(steps[1], abs=3)  # each torso is a metre longer


def test_gallery_has_a_picture_for_every_body() -> None:
    picture = film.gallery(bodies.names("halfcheetah"), span_m=4.5, n_columns=2)
    (top, bottom), width = np.split(picture[: 2 * 304], 2), picture.shape[1]
    assert (top[:300, -480:] != bottom[:300, :480]).any()  # HC1 and HC2
    assert (top[:300, :480] != bottom[:300, :480]).any()  # HC0 and HC2
    assert (bottom[10:, width // 2 + 4 :] == 255).all()  # no fourth body


# ---------------------------------------------------------------- humanoids


@needs_pictures
def test_humanoids_are_pictured_standing() -> None:
    uneven, even = (film.still(name, SMALL) for name in ("HumanoidR", "Humanoid"))
    assert uneven.shape == (120, 160, 3) and (uneven != even).any()
    weak = dataclasses.replace(bodies.get("Humanoid"), varied=("left_hand",))
    assert (film.still(weak, SMALL) != even).any()  # a body that is not registered


@needs_pictures
def test_every_other_state_of_a_motion_is_filmed() -> None:
    pose = np.array(bodies.get("Humanoid").standing_pose)
    lifted = pose + np.eye(len(pose))[2] * 0.3
    clip = film.motion("Humanoid", np.stack([pose, pose, lifted, lifted, pose]), 40.0, size=SMALL)
    assert clip.frames.shape == (3, 120, 160, 3) and clip.frames_per_s == 20.0
    assert np.array_equal(clip.frames[0], clip.frames[2])
    assert (clip.frames[0] != clip.frames[1]).any()
    short = film.motion("Humanoid", np.stack([pose] * 5), 40.0, 0.06, SMALL)
    assert len(short.frames) == 2  # at 0 and 0.05 s


@needs_pictures
def test_rollouts_of_humanoids_play_at_half_their_control_rate() -> None:
    clip = rollout("Humanoid", 0.1)
    assert (len(clip.frames), clip.frames_per_s) == (2, 20.0)


def test_what_is_no_humanoid_has_no_motion() -> None:
    with pytest.raises(SilemError, match="not by mujoco"):
        film.motion("HC0", np.zeros((3, 9)), 40.0)


def test_without_offscreen_rendering_the_page_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise SilemError("no offscreen rendering")

    shown: list[str] = []
    monkeypatch.setattr(notebook, "display", lambda page: shown.append(page.data))
    monkeypatch.setattr(film, "Camera", refuse)
    assert film.why_no_pictures("HC0") == "no offscreen rendering"
    notebook.film(lambda: pytest.fail("filmed"), "Atlas & friends")
    assert shown == ["<p><em>No video (Atlas &amp; friends): no offscreen rendering</em></p>"]


def test_a_clip_at_the_end_of_a_cell_prints_nothing() -> None:
    made = DisplayFormatter().format(gradient_clip())
    assert made == ({}, {})


def test_a_film_is_played_with_controls_poster_and_words(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[str] = []
    monkeypatch.setattr(notebook, "display", lambda page: shown.append(page.data))
    monkeypatch.setattr(film, "why_no_pictures", lambda body: "")
    frames = np.zeros((5, 16, 16, 3), np.uint8)
    frames[2] = 200
    notebook.film(lambda: Clip(frames, 40.0), "a walk")
    poster = base64.b64encode(film.encode_png(frames[2])).decode()
    assert f"data:image/png;base64,{poster}" in shown[0]  # the middle, not the start pose
    for part in ("<video controls", 'aria-label="a walk"', 'poster="data:image/png', "data:video"):
        assert part in shown[0]
