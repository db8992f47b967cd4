"""Films of runs while they learn."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from silem import bodies
from silem.report import film
from silem.report.pages import slider
from silem.study.config import RunConfig
from silem.study.evaluate import Policy, load_policy
from silem.study.runs import TRANSFORM, run
from silem.study.settings import BUDGETS
from silem.util import files, paths
from silem.util.errors import SilemError


def test_a_repeated_run_is_filmed_only_if_it_is_the_recorded_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    demonstrations = paths.demonstrations_dir()
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    paths.demonstrations_dir().symlink_to(demonstrations)
    budget = BUDGETS["tiny"].with_iterations(2)
    budget = dataclasses.replace(budget, name="small", checkpoint_every=1, n_eval_episodes=1)
    record = run(RunConfig.create("HC1", "silem", budget=budget), progress=False)
    filmed, real = [], film.rollout

    def short(learner: bodies.Body, policy: Policy, **_: object) -> film.Clip:
        filmed.append(real(learner, policy, duration_s=0.2, size=(160, 120), progress=False))
        return filmed[-1]

    monkeypatch.setattr(film, "rollout", short)
    slider.of_training(record.run_id, 2, tmp_path / "films")
    made = tmp_path / "films" / record.run_id
    assert {path.name for path in made.iterdir()} == {"0.mp4", "2.mp4", "transforms.npz"}
    learned, last = files.read_npz(made / "transforms.npz"), files.read_npz(record.file(TRANSFORM))
    assert learned["iteration"].tolist() == [0, 1, 2]
    for name, identity in (("A", 1), ("b", 0)):
        assert (learned[name][0] == identity).all() and (learned[name][1] != identity).any()
        np.testing.assert_array_equal(learned[name][-1], last[name])
    # what is filmed last is the recorded policy, at first another
    recorded = short(record.run_config.learner, load_policy(record))
    assert np.array_equal(filmed[1].frames, recorded.frames)
    assert not np.array_equal(filmed[0].frames, recorded.frames)

    monkeypatch.setattr(slider, "curve_csv", lambda curve: "another")
    with pytest.raises(SilemError, match="another curve"):
        slider.of_training(record.run_id, 2, tmp_path / "none")
    assert not (tmp_path / "none").exists()
    with pytest.raises(SilemError, match="no finished run 'nobody'"):
        slider.of_training("nobody")
