"""The whole run as the page "One run of SILEM" writes it, against what a run trains."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import nbformat
import numpy as np
import pytest
from conftest import NOTEBOOKS, random_demonstrations

import silem
from silem.motion import demonstrations
from silem.study import training
from silem.study.config import RunConfig


def printed() -> str:
    """The code that the page prints."""
    (path,) = [path for path in NOTEBOOKS if path.stem == "04_imitate"]
    text = "\n".join(cell.source for cell in nbformat.read(path, as_version=4).cells)
    (code,) = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    return code


def test_it_trains_what_a_run_of_this_cell_trains(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    monkeypatch.setattr(silem, "settings", training.settings, raising=False)
    shown = random_demonstrations("HC0")
    demonstrations.publish("HC0", shown)
    config = RunConfig.create("HC2", "silem", budget="book")
    budget = config.budget
    assert f"learn({budget.n_iterations} * {budget.steps_per_iteration}," in printed()
    assert f"n_envs={budget.n_envs}," in printed()
    assert f"first({config.hyper.n_trajectories})" in printed()

    def steps(n: int, n_per_iteration: int) -> str:  # one iteration instead of all of them
        return printed().replace(
            f"{n} * {n_per_iteration}, progress_bar=True", f"{n_per_iteration}"
        )

    scope: dict[str, Any] = {"silem": silem}
    exec(steps(budget.n_iterations, budget.steps_per_iteration), scope)
    env = silem.make_vec("HC2", n_envs=8, seed=0)
    expected = training.make_model(config, env, shown)
    expected.learn(budget.steps_per_iteration)
    env.close()
    scope["env"].close()
    page, run = scope["model"].state_arrays(), expected.state_arrays()
    assert {name.partition("/")[0] for name in page} >= {"discriminator", "transform"}
    for name, array in run.items():
        np.testing.assert_array_equal(page[name], array, err_msg=name)
