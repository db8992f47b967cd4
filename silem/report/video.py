"""Pictures in motion: clips, labels, clips side by side, and H.264 files of them.

A picture is a uint8 array (H, W, 3). A :class:`Clip` is a sequence of them with its frame rate;
it becomes an H.264 video that every browser plays, without a video library on the machine: the
encoder comes with imageio-ffmpeg.
"""

from __future__ import annotations

import io
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import imageio_ffmpeg  # type: ignore[import-untyped]
import numpy as np
from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont

from silem.util import files
from silem.util.errors import SilemError, choose

_INK, _CHALK = (32, 32, 32), (245, 245, 245)
_DARK = 96  # a background of less light than this gets a label in chalk
_LABEL_SIZE = 0.055  # of the picture's height
_WEBP_WIDTH = 320
_GAP = 8  # pixels between two clips; even, as the video's width has to be


@dataclass(frozen=True)
class Clip:
    """A body in motion.

    Attributes:
        frames: Pictures (T, H, W, 3), uint8.
        frames_per_s: Pictures per second of simulated time, so that it plays at real speed.
    """

    frames: np.ndarray
    frames_per_s: float

    @property
    def duration_s(self) -> float:
        """Length in seconds."""
        return len(self.frames) / self.frames_per_s


def strip(clip: Clip, n_frames: int = 5, width: int = 1500) -> np.ndarray:
    """Lay equally spaced frames of a clip side by side, from first to last: a video on paper.

    Args:
        clip: The clip.
        n_frames: How many frames.
        width: Of the whole picture, in pixels; the height follows.

    Returns:
        The picture (H, width, 3).

    Raises:
        SilemError: The clip has fewer frames than asked for, or none are asked for.
    """
    if not 1 <= n_frames <= len(clip.frames):
        raise SilemError(f"a strip of {n_frames} frames from a clip of {len(clip.frames)}")
    chosen = np.linspace(0, len(clip.frames) - 1, n_frames).round().astype(int)
    whole = Image.fromarray(np.concatenate(list(clip.frames[chosen]), axis=1))
    height = max(1, round(whole.height * width / whole.width))
    return np.asarray(whole.resize((width, height), Image.Resampling.LANCZOS))


def side_by_side(clips: Sequence[Clip], labels: Sequence[str]) -> Clip:
    """Join clips into one, each under its label; a clip that ends early holds its last frame.

    Raises:
        SilemError: Clips and labels differ in number, or the clips in frame rate or height.
    """
    if len(clips) != len(labels) or not clips:
        raise SilemError(f"{len(clips)} clips and {len(labels)} labels; give one label per clip")
    if len({(clip.frames_per_s, clip.frames.shape[1]) for clip in clips}) > 1:
        raise SilemError("clips side by side need the same frame rate and picture height")
    n_frames = max(len(clip.frames) for clip in clips)
    gap = np.full((n_frames, clips[0].frames.shape[1], _GAP, 3), 255, np.uint8)
    columns: list[np.ndarray] = []
    for clip, label in zip(clips, labels, strict=True):
        held = [(0, n_frames - len(clip.frames)), (0, 0), (0, 0), (0, 0)]
        columns += [gap, np.pad(labelled(clip, label).frames, held, mode="edge")]
    return Clip(np.concatenate(columns[1:], axis=2), clips[0].frames_per_s)


def labelled(clip: Clip, label: str) -> Clip:
    """Write a label into the upper left corner of every frame of a clip."""
    height, width = clip.frames.shape[1:3]
    font = ImageFont.truetype(
        font_manager.findfont("DejaVu Sans"), size=max(9, round(_LABEL_SIZE * height))
    )
    plate = Image.new("L", (width, height), 0)
    corner = round(_LABEL_SIZE * height / 2)
    ImageDraw.Draw(plate).text((corner, corner), label, fill=255, font=font)
    ink = (np.asarray(plate, np.float32) / 255)[:, :, None]
    covered = clip.frames[:, ink[:, :, 0] > 0]
    color = _CHALK if covered.size and covered.mean() < _DARK else _INK
    frames = clip.frames * (1 - ink) + np.array(color, np.float32) * ink
    return replace(clip, frames=frames.round().astype(np.uint8))


def encode_mp4(clip: Clip) -> bytes:
    """Encode a clip as H.264 in an mp4 file (yuv420p, index first: plays while it loads).

    The same clip always gives the same bytes.

    Raises:
        SilemError: The encoder cannot run, or has no room for its temporary file.
    """
    height, width = (size - size % 2 for size in clip.frames.shape[1:3])  # yuv420p: even sizes
    frames = np.ascontiguousarray(clip.frames[:, :height, :width])
    options = ["-crf", "28", "-preset", "slow", "-threads", "1", "-movflags", "+faststart"]
    options += ["-fflags", "+bitexact", "-flags:v", "+bitexact", "-map_metadata", "-1"]
    try:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "clip.mp4"
            writer = imageio_ffmpeg.write_frames(
                str(path),
                (width, height),
                fps=clip.frames_per_s,
                codec="libx264",
                pix_fmt_out="yuv420p",
                quality=None,
                macro_block_size=2,
                output_params=options,
                ffmpeg_log_level="error",
            )
            writer.send(None)
            for frame in frames:
                writer.send(frame)
            writer.close()
            return path.read_bytes()
    except (OSError, RuntimeError) as error:
        raise SilemError(f"the video encoder failed: {error}") from error


def encode_webp(clip: Clip) -> bytes:
    """Encode a clip as an animated WebP picture, small, for places that play no video."""
    height, width = clip.frames.shape[1:3]
    size = (_WEBP_WIDTH, round(_WEBP_WIDTH * height / width))
    pictures = [Image.fromarray(frame).resize(size) for frame in clip.frames]
    memory = io.BytesIO()
    pictures[0].save(
        memory, "WEBP", save_all=True, append_images=pictures[1:], loop=0, quality=40, method=6,
        duration=round(1000 / clip.frames_per_s),
    )  # fmt: skip
    return memory.getvalue()


_ENCODERS = {".mp4": encode_mp4, ".webp": encode_webp}


def write(path: Path, clip: Clip) -> None:
    """Write a clip as an mp4 or a webp file, whichever its name ends in, atomically.

    Raises:
        SilemError: The name ends in anything else, or the file cannot be written; one that was
            there before is untouched.
    """
    files.write_bytes(path, _ENCODERS[choose("kind of film", path.suffix, _ENCODERS)](clip))


def encode_png(picture: np.ndarray) -> bytes:
    """Encode a picture (H, W, 3), for instance a clip's first frame as its poster, as PNG."""
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, "PNG", optimize=True)
    return buffer.getvalue()
