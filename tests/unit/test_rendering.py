"""Clips, labels and video files; films of real bodies."""

from __future__ import annotations

import itertools
import subprocess
from contextlib import closing
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

import silem
from silem import bodies
from silem.report import rendering, video
from silem.report.video import Clip
from silem.util.errors import SilemError


def gradient_clip(n_frames: int = 12, height: int = 90, width: int = 120) -> Clip:
    """A clip whose frames brighten from left to right and from first to last."""
    ramp = np.linspace(60, 160, width)[None, None, :, None]
    light = np.linspace(0, 80, n_frames)[:, None, None, None]
    frames = np.broadcast_to(ramp + light, (n_frames, height, width, 3))
    return Clip(frames.round().astype(np.uint8), 30.0)


def decode(path: Path) -> tuple[dict, np.ndarray]:
    with closing(imageio_ffmpeg.read_frames(str(path))) as reader:
        meta = next(reader)
        width, height = meta["size"]
        frames = [np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in reader]
    return meta, np.stack(frames)


def test_mp4_is_what_browsers_play_and_shows_the_frames(tmp_path: Path) -> None:
    clip = gradient_clip()
    video.write(tmp_path / "clip.mp4", clip)
    meta, frames = decode(tmp_path / "clip.mp4")
    assert meta["codec"] == "h264"
    assert meta["pix_fmt"].startswith("yuv420p")
    assert meta["fps"] == pytest.approx(clip.frames_per_s, rel=1e-3)
    assert frames.shape == clip.frames.shape
    assert np.abs(frames.astype(int) - clip.frames).mean() < 4
    data = (tmp_path / "clip.mp4").read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")  # plays before it is wholly loaded


def test_mp4_of_odd_size_loses_one_row_and_column(tmp_path: Path) -> None:
    video.write(tmp_path / "clip.mp4", gradient_clip(height=91, width=121))
    _, frames = decode(tmp_path / "clip.mp4")
    assert frames.shape[1:3] == (90, 120)


def test_mp4_bytes_depend_on_the_clip_alone() -> None:
    first, again = video.encode_mp4(gradient_clip()), video.encode_mp4(gradient_clip())
    assert first == again
    assert first != video.encode_mp4(gradient_clip(n_frames=13))


def test_failed_write_keeps_the_file_that_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "clip.mp4"
    path.write_bytes(b"before")
    monkeypatch.setattr(imageio_ffmpeg._io, "get_ffmpeg_exe", lambda: str(tmp_path / "nowhere"))
    with pytest.raises(SilemError, match="video encoder"):
        video.write(path, gradient_clip())
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


def test_png_round_trips() -> None:
    picture = gradient_clip().frames[3]
    png = video.encode_png(picture)
    decoded = subprocess.run(
        [imageio_ffmpeg.get_ffmpeg_exe(), "-loglevel", "error", "-i", "-", "-f", "rawvideo",
         "-pix_fmt", "rgb24", "-"],
        input=png, capture_output=True, check=True,
    ).stdout  # fmt: skip
    assert np.array_equal(np.frombuffer(decoded, np.uint8).reshape(picture.shape), picture)


def test_strip_takes_first_and_last_and_equal_steps_between() -> None:
    clip = gradient_clip(n_frames=13)
    picture = video.strip(clip, 4, width=4 * 120)
    assert picture.shape == (90, 4 * 120, 3)
    parts = np.split(picture, 4, axis=1)
    for part, index in zip(parts, (0, 4, 8, 12), strict=True):
        assert np.array_equal(part, clip.frames[index])


def test_strip_is_as_wide_as_asked_for() -> None:
    assert video.strip(gradient_clip(), 4, width=240).shape == (45, 240, 3)


@pytest.mark.parametrize("n_frames", [0, 13])
def test_strip_refuses_more_frames_than_there_are(n_frames: int) -> None:
    with pytest.raises(SilemError, match=rf"{n_frames} frames from a clip of 12"):
        video.strip(gradient_clip(), n_frames)


def test_label_marks_every_frame_and_only_its_corner() -> None:
    clip = gradient_clip()
    marked = video.labelled(clip, "SILEM").frames
    changed = (marked != clip.frames).any(axis=-1)
    assert changed.any(axis=(1, 2)).all()
    assert not changed[:, 30:].any()
    assert not changed[:, :, 90:].any()
    assert (marked[changed] < clip.frames[changed]).all()  # dark ink
    night = Clip(clip.frames // 3, clip.frames_per_s)
    lit = video.labelled(night, "SILEM").frames
    assert (lit[changed] > night.frames[changed]).all()


def test_side_by_side_holds_the_last_frame_of_the_shorter() -> None:
    long, short = gradient_clip(n_frames=12), gradient_clip(n_frames=5)
    joined = video.side_by_side([long, short], ["a", "b"])
    assert joined.frames.shape == (12, 90, 248, 3)
    assert (joined.frames[:, :, 120:128] == 255).all()
    assert np.array_equal(joined.frames[:, 45:, :120], long.frames[:, 45:])
    right = joined.frames[:, 45:, 128:]
    assert np.array_equal(right[4], short.frames[4, 45:])
    assert all(np.array_equal(frame, right[4]) for frame in right[4:])


def test_side_by_side_refuses_what_does_not_fit() -> None:
    clip = gradient_clip()
    with pytest.raises(SilemError, match="one label per clip"):
        video.side_by_side([clip], [])
    with pytest.raises(SilemError, match="same frame rate"):
        video.side_by_side([clip, Clip(clip.frames, 25.0)], ["a", "b"])
    with pytest.raises(SilemError, match="picture height"):
        video.side_by_side([clip, gradient_clip(height=80)], ["a", "b"])


class Recorder:
    """A policy that stands still and remembers how it was called."""

    def __init__(self) -> None:
        self.calls: list[object] = []

    def reseed(self, seed: int) -> None:
        self.calls.append(seed)

    def predict(self, observation: np.ndarray, *, deterministic: bool = False) -> tuple:
        self.calls.append("mean" if deterministic else "sampled")
        return np.zeros((len(observation), 6), np.float32), None


def film(body: str, duration_s: float, **options: object) -> Clip:
    return rendering.rollout(body, duration_s=duration_s, progress=False, **options)


def test_rollout_plays_at_real_speed() -> None:
    clip = film("HC0", 0.2)
    assert clip.frames.shape == (6, 480, 640, 3)
    assert clip.frames.dtype == np.uint8
    assert clip.duration_s == pytest.approx(0.2, abs=0.01)
    assert all((a != b).any() for a, b in itertools.pairwise(clip.frames))


def test_rollout_depends_on_its_seed_alone() -> None:
    first, again, other = (film("HC0", 0.1, seed=seed).frames for seed in (3, 3, 4))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_rollout_samples_actions_and_restarts_the_policy() -> None:
    policy = Recorder()
    film("HC0", 0.1, policy=policy, seed=5)
    film("HC0", 0.1, policy=policy, seed=5)
    once, again = policy.calls[: len(policy.calls) // 2], policy.calls[len(policy.calls) // 2 :]
    assert once == again
    assert isinstance(once[0], int)
    assert once[1:] == ["sampled"] * 4


def test_rollout_ends_with_the_episode(monkeypatch: pytest.MonkeyPatch) -> None:
    make_vec = silem.make_vec
    whole = film("HC0", 0.2).frames
    monkeypatch.setattr(silem, "make_vec", lambda *a, **k: make_vec(*a, **k, max_steps=5))
    cut = film("HC0", 0.2).frames
    assert np.array_equal(cut, whole[:3])  # after 0, 2 and 4 steps; the fifth ends the episode


@pytest.mark.parametrize("duration_s", [0.0, -1.0, float("nan"), float("inf")])
def test_rollout_refuses_a_duration_that_is_none(duration_s: float) -> None:
    with pytest.raises(SilemError, match="positive number of seconds"):
        film("HC0", duration_s)


def test_rollout_refuses_an_unknown_body() -> None:
    with pytest.raises(SilemError, match="unknown body 'HC9'"):
        film("HC9", 0.1)


def orange_width(picture: np.ndarray) -> int:
    """How many columns show the link that sets the body apart."""
    red, green, blue = (picture[:, :, i].astype(int) for i in range(3))
    return int(((red - blue > 80) & (red > green + 40)).any(axis=0).sum())


def test_stills_at_one_span_are_to_scale() -> None:
    widths = [orange_width(rendering.still(name, 300, 200, 4.5)) for name in ("HC0", "HC1", "HC2")]
    steps = np.diff(widths)
    assert steps[0] > 30
    assert steps[0] == pytest.approx(steps[1], abs=3)  # each torso is a metre longer


def test_gallery_has_a_picture_for_every_body() -> None:
    names = bodies.names("halfcheetah")
    figure = rendering.gallery(names, span_m=4.5, n_columns=2)
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles == ["HC0: 1 m", "HC1: 2 m", "HC2: 3 m", ""]
    assert [len(axes.images) for axes in figure.axes] == [1, 1, 1, 0]


def test_a_film_is_written_as_its_name_says(tmp_path: Path) -> None:
    clip = gradient_clip()
    video.write(tmp_path / "clip.webp", clip)
    with Image.open(tmp_path / "clip.webp") as picture:
        assert (picture.format, picture.width) == ("WEBP", 320)
        assert picture.n_frames > 1  # frames that look the same become one
    with pytest.raises(SilemError, match="unknown kind of film"):
        video.write(tmp_path / "clip.gif", clip)
