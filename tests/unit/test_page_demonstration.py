"""The demonstration's figures, its table of clips, and its film."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import mujoco
import numpy as np
import pytest
from drawn import assert_readable, texts
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle

from silem import paper
from silem.motion import clips, demonstrator
from silem.motion.demonstrator import CLIPS, Motion, published_motion
from silem.motion.features import FEATURES, POINTS, Landmarks
from silem.motion.kinematics import SIDES
from silem.motion.retargeting import standing_feet
from silem.report import film, style
from silem.report.pages import demonstration as page
from silem.report.pages.demonstration import SIDE_COLORS
from silem.report.pages.humanoids import limb_distances_m


@pytest.fixture(autouse=True)
def no_raw_clips(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is shown comes from what is committed."""
    monkeypatch.setenv(clips.ENV, str(tmp_path))


@pytest.fixture
def motion() -> Motion:
    return published_motion("08_01")


def spans(figure: Figure, side: str) -> list[tuple[float, float]]:
    """The shaded stretches of time of one side in the first panel."""
    color = SIDE_COLORS[side]
    patches = [p for p in figure.axes[0].patches if isinstance(p, Rectangle | Polygon)]
    shown = [p.get_extents().transformed(figure.axes[0].transData.inverted()) for p in patches]
    colors = [to_hex(patch.get_facecolor()).upper() for patch in patches]
    return [(box.x0, box.x1) for box, own in zip(shown, colors, strict=True) if own == color]


def test_every_feature_is_drawn_once_with_its_unit_and_side(motion: Motion) -> None:
    figure = page.features(motion)
    drawn = [line for axes in figure.axes for line in axes.lines]
    assert len(figure.axes) == 15
    assert len(drawn) == len(FEATURES)
    for column, feature in enumerate(FEATURES):
        (line,) = [
            own for own in drawn if np.array_equal(own.get_ydata(), motion.features[:, column])
        ]
        title = line.axes.get_title(loc="left")
        assert f"({feature.unit})" in title if feature.unit else "(" not in title, feature.name
        side = feature.name.partition("_")[0]
        assert line.get_color() == SIDE_COLORS.get(side, style.INK), feature.name
        assert line.get_xdata()[-1] == pytest.approx(motion.duration_s)
    assert_readable(figure)


def test_panels_are_shaded_while_a_foot_stands(motion: Motion) -> None:
    figure = page.features(motion)
    for side, stands in zip(SIDES, standing_feet(motion).T, strict=True):
        shaded = spans(figure, side)
        times = np.flatnonzero(stands) / motion.rate_hz
        inside = [any(a - 1e-9 <= t <= b + 1e-9 for a, b in shaded) for t in times]
        assert len(shaded) >= 2 and all(inside)
        covered = sum(round((b - a) * motion.rate_hz) + 1 for a, b in shaded)
        assert covered == stands.sum()
    # negative control: feet that glide never stand
    glide = np.arange(len(motion.points))[:, None, None] * np.array([0.02, 0.0, 0.0])
    gliding = dataclasses.replace(motion, points=motion.points[:1] + glide)
    assert not any(spans(page.features(gliding), side) for side in SIDES)


def test_poses_join_the_landmarks_and_keep_proportions(motion: Motion) -> None:
    figure = page.poses({"the man": motion.points}, motion.rate_hz)
    (axes,) = figure.axes
    assert axes.get_aspect() == 1
    bones = [c for c in axes.collections if isinstance(c, LineCollection)]
    shown = np.concatenate([collection.get_segments() for collection in bones])
    assert len(shown) == 5 * 13  # a tree over 14 landmarks
    last = motion.points[-1][:, [0, 2]]
    knee, foot = last[POINTS.index("left_knee")], last[POINTS.index("left_foot")]
    assert any(np.allclose(segment, [knee, foot]) for segment in shown)
    times = [float(text[:-2]) for text in texts(figure) if text.endswith(" s")]
    assert times == pytest.approx([0.0, 0.575, 1.15, 1.725, 2.3], abs=0.006)
    assert_readable(figure)


def test_the_table_has_every_clip_as_it_was_published() -> None:
    table = page.clips().set_index("clip")
    assert list(table.index) == list(CLIPS)
    for clip in ("08_01", "08_04"):
        qpos, row = published_motion(clip).qpos, table.loc[clip]
        assert row["states"] == len(qpos)
        way_m = np.linalg.norm(qpos[-1, :2] - qpos[0, :2])
        assert row["distance (m)"] == pytest.approx(way_m, abs=1e-5)
        assert row["distance (m)"] / row["duration (s)"] == row["mean speed (m/s)"]
    assert table.loc["08_01", "distance (m)"] == pytest.approx(3.679, abs=5e-4)
    repaired = table.index[table["repairs"] != "none"]
    assert list(repaired) == ["08_07"]
    assert "frames 2, 3, 4, 5, 6" in table.loc["08_07", "repairs"]


def test_the_model_is_the_one_whose_distances_the_paper_gives() -> None:
    distances = limb_distances_m(film.man())
    assert round(distances["left_foot"], 2) == paper.number("feet_distances")[0]
    assert round(distances["left_hand"], 2) == paper.number("hand_distances")[0]


def test_the_film_shows_the_landmarks_of_the_published_motion(motion: Motion) -> None:
    model = mujoco.MjModel.from_xml_string(film.man().model_xml())
    data, landmarks = mujoco.MjData(model), Landmarks(model, demonstrator.SKELETON)
    for state in (0, 40, 92):
        data.qpos[:] = motion.qpos[state]
        mujoco.mj_kinematics(model, data)
        assert np.allclose(data.xpos[landmarks.ids], motion.points[state], atol=1e-5)


def test_the_film_has_the_speed_of_the_walk(motion: Motion) -> None:
    if why := film.why_no_pictures("Humanoid"):
        pytest.skip(why)
    clip = film.motion(film.man(), motion.qpos[:5], motion.rate_hz, size=(160, 120))
    assert clip.duration_s == pytest.approx(3 / 20)
    assert np.abs(np.diff(clip.frames.astype(int), axis=0)).max(axis=(1, 2, 3)).min() > 1
