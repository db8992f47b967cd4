"""What walks and what does not, in numbers, in words, in curves and on film, from made-up runs."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import synthetic_records as synthetic
from drawn import assert_readable, footer, texts

from silem.report import results, style
from silem.report.claims import MARGIN
from silem.report.curves import compared_curves
from silem.report.pages import walking
from silem.study.config import RunConfig
from silem.study.studies import cells

SHORT = 250


def planned(method: str, body: str, seed: int = 0) -> RunConfig:
    (cell,) = [c for c in cells("humanoids") if (c.method, c.body) == (method, body)]
    return cell.config("book", seed)


def shortened(config: RunConfig) -> RunConfig:
    return dataclasses.replace(config, budget=config.budget.with_iterations(SHORT))


@pytest.fixture(scope="module")
def frame(tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    """Two trials of SILEM on Humanoid that walk, a short one on Atlas that falls, PPO, random."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SILEM_DATA_DIR", str(tmp_path_factory.mktemp("data")))
        for seed, level in enumerate((840.0, 870.0)):
            synthetic.write_record(planned("silem", "Humanoid", seed), level)
        synthetic.write_record(shortened(planned("silem", "Atlas")), 60.0)
        synthetic.write_record(shortened(planned("ppo", "Humanoid")), 300.0)
        synthetic.write_record(planned("random", "Humanoid"), 4.0)
        loaded = results.load_records("humanoids", "book")
        # what reads the runs' files later still has to find them
        loaded.attrs["folder"] = str(Path(loaded["folder"].iloc[0]).parents[2])
        return loaded


@pytest.fixture(autouse=True)
def data_dir(frame: pd.DataFrame, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SILEM_DATA_DIR", frame.attrs["folder"])


@pytest.fixture
def empty() -> pd.DataFrame:
    return results.load_records("humanoids", "paper")


@pytest.mark.parametrize(
    ("survived", "speed_m_s", "expected"),
    [
        (1.0, 1.6, walking.WALKS),
        (1 - MARGIN, 1.6 * (1 - MARGIN) + 1e-9, walking.WALKS),
        (1.0, 1.0, walking.SLOWER),
        (1.0, 0.5, walking.CREEPS),
        (1.0, 0.1, walking.STANDS),
        (0.89, 1.6, walking.FALLS),  # however fast it was until then
        (0.05, 0.0, walking.FALLS),
    ],
)
def test_a_gait_is_survival_first_and_then_speed(
    survived: float, speed_m_s: float, expected: str
) -> None:
    assert walking.gait(survived, speed_m_s) == expected


def test_gaits_are_means_over_trials_and_keep_lengths_apart(frame: pd.DataFrame) -> None:
    found = walking.gaits(frame).set_index(["body", "method"])
    assert set(found.index) == {("Humanoid", "silem"), ("Humanoid", "ppo"), ("Atlas", "silem")}
    walker = found.loc["Humanoid", "silem"]
    trials = results.scores(frame, "silem", "Humanoid", "speed_m_s")
    assert walker["trials"] == len(trials) == 2
    assert walker["speed_m_s"] == pytest.approx(trials.mean())
    assert walker["speed_share"] == pytest.approx(trials.mean() / 1.6)
    assert walker["gait"] == walking.WALKS
    assert walker["survived_s"] == pytest.approx(25 * walker["survived"])  # 1000 steps of 0.025 s
    faller = found.loc["Atlas", "silem"]
    assert (faller["n_iterations"], faller["stand_in"], faller["gait"]) == (SHORT, True, "falls")


def test_the_table_names_its_groups_only_where_there_are_two(frame: pd.DataFrame) -> None:
    one, two = walking.gait_table({"": frame}), walking.gait_table({"here": frame, "there": frame})
    assert "runs" not in one
    assert list(two["runs"]) == ["here"] * len(one) + ["there"] * len(one)
    row = one[(one["body"] == "Humanoid") & (one["method"] == "SILEM")].iloc[0]
    seconds, speed = float(row["seconds"]), float(row["speed (m/s)"])
    assert float(row["ground covered, about (m)"]) == pytest.approx(seconds * speed, rel=0.01)


def test_sentences_count_gaits_and_name_the_longest(frame: pd.DataFrame) -> None:
    said = walking.sentences(frame)
    assert [said[f"n_{name}"] for name in ("cells", "walk", "fall")] == [3, 1, 2]
    assert said["longest"] == "SILEM on Humanoid"
    assert said["n_curves"] == 4  # every run but the random policy's
    atlas = walking.sentences(results.select(frame, ["silem"], ["Atlas"]))
    assert atlas["longest"] == f"SILEM on Atlas ({SHORT} iterations)"


def test_a_cell_speaks_through_its_stand_ins_only_without_planned_runs(frame: pd.DataFrame) -> None:
    said = walking.cell_sentences(frame, "x", "ppo", "Humanoid")
    assert said["x_iterations"] == SHORT
    both = frame.copy()
    both.attrs = frame.attrs
    extra = frame[(frame["body"] == "Atlas")].assign(body="Humanoid", upright=0.0)
    both = pd.concat([both, extra], ignore_index=True)
    assert walking.cell_sentences(both, "x", "silem", "Humanoid") == walking.cell_sentences(
        frame, "x", "silem", "Humanoid"
    )


def test_without_runs_everything_says_so(empty: pd.DataFrame) -> None:
    said = walking.sentences(empty)
    assert (said["n_cells"], said["longest"]) == (0, style.DASH)
    assert np.isnan(walking.cell_sentences(empty, "x", "silem", "Atlas")["x_steps"])
    assert list(walking.gait_table({"": empty})["body"]) == ["no run"]
    assert walking.longest_run(empty, "silem", "Humanoid") == ""
    assert list(walking.milestones(empty, "silem", "Humanoid")["iterations"]) == ["no run"]
    figure = compared_curves({"these": empty, "those": empty})
    assert "no run" in texts(figure)
    assert_readable(figure)


def test_a_long_run_is_read_where_the_short_ones_ended(frame: pd.DataFrame) -> None:
    said = walking.early_sentences(frame, "silem", "Humanoid")
    assert said["short_iterations"] == SHORT
    curve = results.load_curve(walking.longest_run(frame, "silem", "Humanoid"))
    at_short = curve.loc[curve["iteration"] == SHORT, "episode_length"].iloc[0]
    assert said["early_steps"] == pytest.approx(at_short, rel=0.1)
    assert said["late_steps"] > 1.5 * said["early_steps"]
    assert np.isnan(walking.early_sentences(frame, "tpil", "Humanoid")["late_steps"])


def test_milestones_follow_one_run_to_its_end(frame: pd.DataFrame) -> None:
    run_id = walking.longest_run(frame, "silem", "Humanoid")
    runs = results.cell(frame, "silem", "Humanoid")
    assert run_id == runs.sort_values("return_mean")["run_id"].iloc[-1]
    table = walking.milestones(frame, "silem", "Humanoid")
    total = planned("silem", "Humanoid").budget.n_iterations
    assert table["iterations"].iloc[-1] == style.number(total)
    lengths = table["steps before a fall"].str.replace(",", "").astype(int)
    assert lengths.is_monotonic_increasing  # as the made-up curves are
    last = results.load_curve(run_id).iloc[-4:]
    ratio = (last["disc_reward"].mean()) / last["episode_length"].mean()
    assert float(table["reward of D per step"].iloc[-1]) == pytest.approx(ratio, abs=0.02)


def test_compared_curves_have_a_line_per_run(frame: pd.DataFrame) -> None:
    groups = {
        "silem": results.select(frame, ["silem"], ["Humanoid"]),
        "ppo": results.select(frame, ["ppo"], ["Humanoid"]),
    }
    figure = compared_curves(groups)
    assert [len(axes.lines) for axes in figure.axes[:3]] == [3, 3, 2]  # PPO has no discriminator
    dashes = {line.get_linestyle() for line in figure.axes[0].lines}
    assert len(dashes) == 2
    assert "silem: 2 trials" in texts(figure)
    assert "budget book" in footer(figure)
    assert_readable(figure)
