"""The humanoids in pictures: Figure 3a, films, limb distances, figures of one run."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import synthetic_records as synthetic
from drawn import assert_readable, texts

from silem import bodies
from silem.motion.demonstrations import Demonstrations
from silem.motion.features import POINTS
from silem.report import limbs, notebook, one_run, rendering, skeleton
from silem.report.features import feature_names
from silem.report.video import Clip
from silem.study.config import RunConfig
from silem.util.errors import SilemError

needs_pictures = pytest.mark.skipif(
    bool(rendering.why_no_pictures("Humanoid")), reason="nothing can be drawn offscreen here"
)


def walk(n_states: int = 20) -> np.ndarray:
    """Landmarks of somebody who slides forward, at the places of a standing body."""
    pose = np.zeros((len(POINTS), 3))
    heights = {"head": 1.6, "shoulder": 1.4, "elbow": 1.1, "hand": 0.9, "hip": 0.9, "knee": 0.5}
    for index, name in enumerate(POINTS):
        side, _, part = name.rpartition("_")
        pose[index, 1] = {"left": 0.2, "right": -0.2}.get(side, 0.0)
        pose[index, 2] = {**heights, "torso": 1.3}.get(part, 0.05)
    way = np.linspace(0, 3, n_states)[:, None, None] * np.array([1.0, 0.0, 0.0])
    return pose + way


def test_figure_3a_shows_the_walk_above_the_bodies() -> None:
    pictures = {name: np.zeros((40, 30, 3), np.uint8) for name in bodies.names("humanoid")}
    figure = skeleton.humanoids(walk(), pictures, rate_hz=10.0, n_poses=5)
    assert_readable(figure)
    words = texts(figure)
    assert "The demonstrator: 3.0 m in 1.9 s" in words and set(pictures) <= set(words)
    heads = [line for line in figure.axes[0].lines if line.get_marker() == "o"]
    assert len(heads) == 5
    assert [len(axes.images) for axes in figure.axes[1:]] == [1, 1, 1]


def test_figure_3a_refuses_what_it_cannot_draw() -> None:
    picture = {"Humanoid": np.zeros((4, 3, 3), np.uint8)}
    with pytest.raises(SilemError, match=r"allowed: \(T, 14, 3\)"):
        skeleton.humanoids(walk()[:, :5], picture, 40.0)
    with pytest.raises(SilemError, match="30 poses of 20 states"):
        skeleton.humanoids(walk(), picture, 40.0, n_poses=30)
    with pytest.raises(SilemError, match="0 pictures"):
        skeleton.humanoids(walk(), {}, 40.0)


# ---------------------------------------------------------------- limb distances


def test_distances_of_demonstrator_and_humanoid_are_the_papers() -> None:
    found = limbs.measured()
    printed = {"demonstrator": (1.13, 0.74), "Humanoid": (1.26, 0.40)}
    for name, (foot_m, hand_m) in printed.items():
        assert found[name]["left_foot"] == pytest.approx(foot_m, abs=0.005)
        assert found[name]["right_hand"] == pytest.approx(hand_m, abs=0.005)
    uneven = found["HumanoidR"]
    assert uneven["left_hand"] < found["Humanoid"]["left_hand"] < uneven["right_hand"]
    assert uneven["left_foot"] == found["Humanoid"]["left_foot"]


def test_limb_table_puts_ours_beside_the_papers() -> None:
    even = {"left_foot": 1.20, "right_foot": 1.20, "left_hand": 0.40, "right_hand": 0.40}
    uneven = even | {"left_hand": 0.25, "right_hand": 0.57}
    rows = limbs.table({"Humanoid": even, "HumanoidR": uneven}).data.to_numpy().tolist()
    assert rows[0] == ["Humanoid", "1.26", "1.20", "−0.06", "0.40", "0.40", "0.00"]
    assert rows[1] == ["HumanoidR", "–", "1.20", "–", "–", "0.25 left, 0.57 right", "–"]
    with pytest.raises(SilemError, match="no distance of right_hand on Atlas"):
        limbs.table({"Atlas": {k: v for k, v in even.items() if k != "right_hand"}})


# ---------------------------------------------------------------- films


@needs_pictures
def test_humanoids_are_pictured_standing() -> None:
    uneven, even = (rendering.still(name, 120, 160) for name in ("HumanoidR", "Humanoid"))
    assert uneven.shape == (160, 120, 3) and (uneven != even).any()
    weak = dataclasses.replace(bodies.get("Humanoid"), varied=("left_hand",))
    assert (rendering.still(weak, 120, 160) != even).any()  # a body that is not registered


@needs_pictures
def test_a_motion_is_filmed_state_by_state() -> None:
    pose = np.array(bodies.get("Humanoid").standing_pose)
    lifted = pose + np.eye(len(pose))[2] * 0.3
    clip = rendering.motion("Humanoid", np.stack([pose, lifted, pose]), 40.0, 120, 160)
    assert clip.frames.shape == (3, 160, 120, 3) and clip.frames_per_s == 40.0
    assert np.array_equal(clip.frames[0], clip.frames[2])
    assert (clip.frames[0] != clip.frames[1]).any()


@needs_pictures
def test_rollouts_of_humanoids_play_at_their_control_rate() -> None:
    clip = rendering.rollout("Humanoid", duration_s=0.1, progress=False)
    assert (len(clip.frames), clip.frames_per_s) == (4, 40.0)


def test_motions_that_do_not_fit_are_refused() -> None:
    with pytest.raises(SilemError, match=r"Humanoid needs \(T, 28\)"):
        rendering.motion("Humanoid", np.zeros((3, 5)), 40.0)
    with pytest.raises(SilemError, match="not by mujoco"):
        rendering.motion("HC0", np.zeros((3, 9)), 40.0)
    with pytest.raises(SilemError, match="span_m is for runners"):
        rendering.still("Atlas", span_m=3.0)


def test_without_offscreen_rendering_the_page_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise SilemError("no offscreen rendering")

    shown: list[str] = []
    monkeypatch.setattr(notebook, "_display_html", shown.append)
    monkeypatch.setattr(rendering, "MujocoCamera", refuse)
    assert rendering.why_no_pictures("HC0") == ""  # drawn without OpenGL
    notebook.film(lambda: pytest.fail("filmed"), "Atlas & friends")
    assert shown == ["<p><em>No video (Atlas &amp; friends): no offscreen rendering</em></p>"]


def test_a_film_is_played_where_pictures_can_be_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[str] = []
    monkeypatch.setattr(notebook, "_display_html", shown.append)
    monkeypatch.setattr(notebook, "why_no_pictures", lambda body: "")
    notebook.film(lambda: Clip(np.zeros((2, 16, 16, 3), np.uint8), 40.0), "a walk")
    assert "<video" in shown[0] and "a walk" in shown[0]


# ---------------------------------------------------------------- figures of one run


def test_one_run_of_a_humanoid(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    record = synthetic.write_record(RunConfig.create("HumanoidR", "silem"))
    titles = [axes.get_title(loc="left") for axes in one_run.curve(record).axes]
    assert titles[:2] == ["return of an episode", "steps before a fall"]
    left, _ = one_run.transform(record).axes
    assert [tick.get_text() for tick in left.get_yticklabels()] == feature_names("HumanoidR")


def test_a_trajectory_of_a_humanoid_is_refused() -> None:
    motion = Demonstrations((np.zeros((5, 23), np.float32),), (), "humanoid_CMU", "")
    with pytest.raises(SilemError, match="unknown runner 'humanoid_CMU'; allowed: HC0"):
        one_run.trajectory(motion)
