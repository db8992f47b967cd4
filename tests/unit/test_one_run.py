"""Figures of one trajectory and of one run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import synthetic_records as synthetic
from matplotlib.figure import Figure

from silem.bodies import BulletBody
from silem.motion.demonstrations import Demonstrations
from silem.report import curves, transforms
from silem.report.pages import gaits
from silem.report.transforms import feature_names
from silem.study.config import RunConfig
from silem.util.errors import SilemError


def demonstrations(body: str, n_states: int = 40) -> Demonstrations:
    values = np.zeros((n_states, len(feature_names(body))), np.float32)
    return Demonstrations((values,), (0.0,), body, "made up")


def labels(figure: Figure) -> list[list[str]]:
    return [[str(line.get_label()) for line in axes.lines] for axes in figure.axes]


def test_every_feature_is_drawn_once_whatever_the_body() -> None:
    for body, n_joints, n_feet in (("HC0", 6, 6), ("Ant0", 8, 4)):
        torso, angles, velocities, _ = labels(gaits.trajectory(demonstrations(body)))
        contacts = gaits.trajectory(demonstrations(body)).axes[3].get_yticklabels()
        assert "forward velocity" in torso
        assert angles == velocities
        assert (len(torso), len(angles), len(contacts)) == (8, n_joints, n_feet)


def test_contacts_become_one_bar_per_touch() -> None:
    shown = demonstrations("HC0")
    foot = feature_names("HC0").index("back foot contact")
    shown.features[0][[3, 4, 5, 9], foot] = 1
    axes = gaits.trajectory(shown).axes[3]
    row = [tick.get_text() for tick in axes.get_yticklabels()].index("back foot")
    boxes = [path.get_extents() for path in axes.collections[row].get_paths()]
    spans = [
        (box.x0 / BulletBody.control_step_s, box.x1 / BulletBody.control_step_s) for box in boxes
    ]
    assert np.allclose(spans, [(3, 6), (9, 10)])
    assert all(
        len(collection.get_paths()) == 0
        for index, collection in enumerate(axes.collections)
        if index != row
    )


def test_trajectory_shows_the_seconds_asked_for() -> None:
    figure = gaits.trajectory(demonstrations("HC0"), duration_s=10 * BulletBody.control_step_s)
    assert len(figure.axes[0].lines[0].get_xdata()) == 10


@pytest.fixture
def record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    return synthetic.write_record


def test_curve_shows_what_the_run_knows(record) -> None:
    expert = curves.of_run(record(RunConfig.create("HC0", "ppo")))
    assert [axes.get_title(loc="left") for axes in expert.axes] == [
        "return", "speed (m/s)", "policy's standard deviation",
    ]  # fmt: skip
    imitator = curves.of_run(record(RunConfig.create("HC0", "silem")))
    titles = [axes.get_title(loc="left") for axes in imitator.axes]
    assert "discriminator reward" in titles


def test_transform_is_drawn_feature_by_feature(record) -> None:
    figure = transforms.of_run(record(RunConfig.create("HC2", "silem")))
    left, right = figure.axes
    assert [tick.get_text() for tick in left.get_yticklabels()] == feature_names("HC2")
    marks = [axes.lines[-1].get_xdata() for axes in (left, right)]
    assert [len(values) for values in marks] == [26, 26]
    assert abs(np.mean(marks[0]) - 1) < 0.2 < abs(np.mean(marks[0]) - np.mean(marks[1]))


def test_transform_of_a_run_without_one_is_an_error(record) -> None:
    with pytest.raises(SilemError, match=r"transform\.npz"):
        transforms.of_run(record(RunConfig.create("HC0", "silem-minus")))


def test_one_run_of_a_humanoid(record) -> None:
    run = record(RunConfig.create("HumanoidR", "silem"))
    titles = [axes.get_title(loc="left") for axes in curves.of_run(run).axes]
    assert titles[:2] == ["return", "steps before a fall"]
    left, _ = transforms.of_run(run).axes
    assert [tick.get_text() for tick in left.get_yticklabels()] == feature_names("HumanoidR")


def test_a_trajectory_of_a_humanoid_is_refused() -> None:
    motion = Demonstrations((np.zeros((5, 23), np.float32),), (), "humanoid_CMU", "")
    with pytest.raises(SilemError, match="unknown runner 'humanoid_CMU'; allowed: HC0"):
        gaits.trajectory(motion)
