"""The demonstrator as a stick figure: walking in a film, and beside the bodies in Figure 3a."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image, ImageDraw

from silem.errors import SilemError
from silem.report import style
from silem.report.video import Clip
from silem.skeleton.features import POINTS

_CHAINS = (
    ("torso", "head"),
    ("torso", "left_shoulder", "left_elbow", "left_hand"),
    ("torso", "right_shoulder", "right_elbow", "right_hand"),
    ("torso", "left_hip", "left_knee", "left_foot"),
    ("torso", "right_hip", "right_knee", "right_foot"),
)
_BONES = [
    (POINTS.index(a), POINTS.index(b)) for chain in _CHAINS for a, b in itertools.pairwise(chain)
]
_COLORS = {"left": "#E07B39", "right": "#0072B2"}
_AZIMUTH_DEG = 25.0  # seen from the right and a little from the front, level with the floor
_METRE = float(np.cos(np.deg2rad(_AZIMUTH_DEG)))  # a metre of the way, as long as it is seen
_MARGIN_M = 0.15
_SUPERSAMPLING = 2  # a film's pictures are drawn this much larger, for smooth edges
_BONE_M, _HEAD_M = 0.03, 0.075  # thickness of a film's bones, radius of its head


def walking(
    points: np.ndarray, pictures: Mapping[str, np.ndarray], rate_hz: float, n_poses: int = 7
) -> Figure:
    """Draw Figure 3a: the man who demonstrates, and the bodies that learn from him.

    Args:
        points: The demonstrator's landmarks in the world in m, (T, P, 3), in the order of
            `silem.skeleton.features.POINTS`.
        pictures: Of each learner, (H, W, 3), by its name.
        rate_hz: States per second of `points`.
        n_poses: How many poses of the walk to show.

    Raises:
        SilemError: The points have another shape, there are fewer than `n_poses` states, or there
            is no picture.
    """
    _check(points)
    if not 1 <= n_poses <= len(points) or not pictures:
        raise SilemError(f"{n_poses} poses of {len(points)} states, {len(pictures)} pictures")
    with style.applied():
        figure = Figure(figsize=(style.WIDTH_IN, 5.9), layout="constrained")
        names = list(pictures)
        rows: list[Any] = [["walk"] * len(names), names]
        panels = figure.subplot_mosaic(rows, height_ratios=[1, 1.2])
        shown = np.linspace(0, len(points) - 1, n_poses).round().astype(int)
        for rank, state in enumerate(shown, start=1):
            _draw(panels["walk"], points[state], alpha=0.35 + 0.65 * rank / n_poses)
        _frame(panels["walk"], points)
        way_m = float(np.linalg.norm(np.diff(points[[0, -1], 0, :2], axis=0)))
        duration_s = (len(points) - 1) / rate_hz
        panels["walk"].set_title(f"The demonstrator: {way_m:.1f} m in {duration_s:.1f} s")
        for name, picture in pictures.items():
            panels[name].imshow(picture, interpolation="none")
            panels[name].set(xticks=[], yticks=[], title=name)
            panels[name].spines[:].set(visible=True, color=style.FAINT)
    return figure


def film(points: np.ndarray, rate_hz: float, width: int = 640, height: int = 480) -> Clip:
    """Film the demonstrator's walk as a stick figure; the view moves along with the torso.

    Strokes on the floor are a metre apart along x, the way that he walks.

    Args:
        points: The demonstrator's landmarks in the world in m, (T, P, 3).
        rate_hz: States per second, which is the clip's frame rate.
        width: Of the pictures, pixels.
        height: Of the pictures, pixels.

    Raises:
        SilemError: The points have another shape.
    """
    _check(points)
    flat = _project(points)
    low = flat[..., 1].min() - _MARGIN_M
    scale = _SUPERSAMPLING * height / (flat[..., 1].max() + _MARGIN_M - low)  # pixels per metre
    frames = []
    for pose in flat:
        left = pose[0, 0] - _SUPERSAMPLING * width / scale / 2
        pixels = (pose - [left, low]) * scale * [1, -1] + [0, _SUPERSAMPLING * height]
        floor_y = _SUPERSAMPLING * height + low * scale
        strokes = _metres(left, left + _SUPERSAMPLING * width / scale)
        picture = _picture(pixels, floor_y, (strokes - left) * scale, scale, width, height)
        frames.append(picture)
    return Clip(np.stack(frames), rate_hz)


def _picture(
    pixels: np.ndarray, floor_y: float, strokes: np.ndarray, scale: float, width: int, height: int
) -> np.ndarray:
    """Draw one pose at pixels (P, 2) over a floor with strokes."""
    size = _SUPERSAMPLING * width, _SUPERSAMPLING * height
    image = Image.new("RGB", size, "white")
    draw = ImageDraw.Draw(image)
    thick = round(_BONE_M * scale)
    draw.line([(0, floor_y), (size[0], floor_y)], fill=style.FAINT, width=thick // 2)
    for x in strokes:
        draw.line([(x, floor_y), (x, floor_y + 2 * thick)], fill=style.MUTED, width=thick // 2)
    for (a, b), color in _back_to_front():
        draw.line([tuple(pixels[a]), tuple(pixels[b])], fill=color, width=thick)
        for x, y in pixels[[a, b]]:  # round ends
            draw.circle((x, y), thick / 2, fill=color)
    draw.circle(tuple(pixels[POINTS.index("head")]), _HEAD_M * scale, fill=style.INK)
    return np.asarray(image.reduce(_SUPERSAMPLING))


def _check(points: np.ndarray) -> None:
    if points.ndim != 3 or points.shape[1:] != (len(POINTS), 3) or len(points) == 0:
        raise SilemError(f"points of shape {points.shape}; allowed: (T, {len(POINTS)}, 3)")


def _project(points: np.ndarray) -> np.ndarray:
    """Project points (..., 3) onto the picture, in m: to the right and up, (..., 2)."""
    azimuth = np.deg2rad(_AZIMUTH_DEG)
    right = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    return points @ np.stack([right, [0.0, 0.0, 1.0]], axis=1)


def _metres(low: float, high: float) -> np.ndarray:
    """Return where between two places of the picture a whole metre of the way is reached."""
    return np.arange(np.ceil(low / _METRE), np.floor(high / _METRE) + 1) * _METRE


def _back_to_front() -> list[tuple[tuple[int, int], str]]:
    """Return the bones with their colours, the left side, which is the far one, first."""
    sides = [POINTS[b].partition("_")[0] for _, b in _BONES]
    bones = [(bone, _COLORS.get(side, style.INK)) for bone, side in zip(_BONES, sides, strict=True)]
    return sorted(bones, key=lambda bone: bone[1] != _COLORS["left"])


def _draw(axes: Axes, points: np.ndarray, alpha: float) -> None:
    """Draw one pose (P, 3): bones, left and right in their colours, and the head."""
    flat = _project(points)
    bones = _back_to_front()
    axes.add_collection(
        LineCollection(
            [flat[list(bone)] for bone, _ in bones], colors=[color for _, color in bones],
            linewidths=2.6, alpha=alpha, capstyle="round",
        )
    )  # fmt: skip
    axes.plot(*flat[POINTS.index("head")], "o", ms=8, color=style.INK, mec="none", alpha=alpha)


def _frame(axes: Axes, points: np.ndarray) -> None:
    """Set the limits so that the whole walk is seen, undistorted, on a floor with metres."""
    flat = _project(points)
    low, high = flat.min(axis=(0, 1)) - _MARGIN_M, flat.max(axis=(0, 1)) + _MARGIN_M
    axes.set(xlim=(low[0], high[0]), ylim=(min(low[1], -_MARGIN_M), high[1]), aspect="equal")
    axes.axhline(0.0, color=style.FAINT, lw=1.5, zorder=0)
    strokes = _metres(low[0], high[0])
    axes.plot(strokes, np.zeros(len(strokes)), "|", ms=9, color=style.MUTED, zorder=0)
    axes.set_axis_off()
    lines = [Line2D([], [], color=c, lw=2.6, label=f"{side} side") for side, c in _COLORS.items()]
    axes.legend(handles=lines, loc="upper right", bbox_to_anchor=(1, 1.12), ncols=2, fontsize=8)
