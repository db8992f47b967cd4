"""The benchmark of the environments measures what its table says."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import bullet, humanoids, measurement
from silem.envs import BatchedEnv


@pytest.fixture(autouse=True)
def few_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measurement, "STEPS", 60)


def test_rows_are_filled_and_compared():
    measured = bullet.measurement("HC0", [1, 2])
    for seed in range(3):
        measured.repeat(seed)
    assert [row.n_envs for row in measured.rows] == [1, 1, 2, 2, 1, 1]
    assert all(len(row.rates) == 3 and min(row.rates) > 0 for row in measured.rows)
    table = measured.table().splitlines()
    assert len(table) == 6
    assert table[0].split()[-2] == "100.0%"
    assert "of raw with" in measured.verdict()


def test_humanoids_are_compared_with_raw_mujoco_and_dm_control():
    measured = humanoids.measurement("Humanoid", [1, 4])
    for seed in range(3):
        measured.repeat(seed)
    assert [row.n_envs for row in measured.rows] == [1, 1, 4, 4, 4, 4, 1, 1]
    assert "times dm_control humanoid walk with 4" in measured.verdict()


def test_without_a_peer_there_is_only_the_share_of_raw():
    measured = humanoids.measurement("Atlas", [1])
    measured.repeat(0)
    assert measured.peer is None
    assert measured.verdict().startswith("Atlas: ")
    assert "times" not in measured.verdict()


def test_raw_mujoco_simulates_what_our_environment_does_until_a_fall():
    raw, lean = (humanoids.Raw("Humanoid", 2, is_lean) for is_lean in (False, True))
    ours = BatchedEnv("Humanoid", 2)
    raw.reset(seed=3)
    lean.reset(seed=3)
    ours.seed(3)
    ours.reset()
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1, 1, (10, 2, 21)).astype(np.float32)
    raw.run(actions)
    lean.run(actions)
    for action in actions:
        *_, dones, _ = ours.step(action)
        assert not dones.any()
    for mine, theirs, lighter in zip(ours.simulation.qpos, raw.states, lean.states, strict=True):
        np.testing.assert_array_equal(mine, theirs.qpos)
        np.testing.assert_array_equal(mine, lighter.qpos)
    raw.run(np.tile(actions, (20, 1, 1)))  # long enough to fall, often
    heads_m = [data.body("head").xpos[2] for data in raw.states]
    assert min(heads_m) >= 1.0  # they were put back on their feet
