"""Records as one checked table: what counts, what is missing, what is refused."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import synthetic_records as synthetic

from silem.report import results
from silem.study.config import TRIAL_SEEDS, RunConfig
from silem.study.verify import check
from silem.util import paths
from silem.util.errors import SilemError


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    return tmp_path


@pytest.fixture(scope="module")
def frame(tmp_path_factory: pytest.TempPathFactory) -> Iterator[pd.DataFrame]:
    """A whole made-up study but for HC2: one SILEM trial, no SILEM-minus."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SILEM_DATA_DIR", str(tmp_path_factory.mktemp("study")))
        synthetic.write_study(without={("silem", "HC2"): 1, ("silem-minus", "HC2"): 0})
        yield results.load_records("halfcheetah", "book")


def test_every_planned_run_is_either_a_row_or_missing(frame: pd.DataFrame) -> None:
    # 13 trained cells of 5 trials and the random policy once per body, less 4 and 5 missing ones.
    assert len(frame) == 13 * len(TRIAL_SEEDS) + 3 - 9
    missing = pd.DataFrame(frame.attrs["missing"])
    assert len(missing) == 9
    assert set(missing["method"]) == {"silem", "silem-minus"}
    assert set(missing["body"]) == {"HC2"}
    command = missing.query("method == 'silem' and seed == 3")["command"].item()
    assert command.startswith("silem run --body HC2 --method silem")
    assert command.endswith("--budget book --seed 3")
    assert not set(missing["run_id"]) & set(frame["run_id"])


def test_scores_are_normalised_by_the_same_bodys_experts(frame: pd.DataFrame) -> None:
    for body in ("HC0", "HC1", "HC2"):
        level = results.scores(frame, "ppo", body, "return_mean").mean()
        row = results.cell(frame, "silem", body).iloc[0]
        assert row["normalised"] == pytest.approx(row["return_mean"] / level)
        assert results.scores(frame, "ppo", body).mean() == pytest.approx(1.0)


def test_scores_leave_out_what_is_unknown(frame: pd.DataFrame) -> None:
    assert len(results.scores(frame, "ppo", "HC0", "disc_reward")) == 0
    assert len(results.scores(frame, "silem", "HC0", "disc_reward")) == 5
    assert len(results.scores(frame, "silem-minus", "HC2")) == 0


@pytest.mark.parametrize("level", [-1300.0, 0.0])
def test_an_expert_that_is_not_above_zero_gives_no_scores(data: Path, level: float) -> None:
    synthetic.write_record(RunConfig.create("HC2", "ppo", budget="book"), return_mean=level - 90)
    synthetic.write_record(RunConfig.create("HC2", "silem", budget="book"), return_mean=-900.0)
    frame = results.load_records("halfcheetah", "book")
    assert len(frame) == 2
    assert frame["normalised"].isna().all()  # -900 / -1300 would look like a good score
    assert frame["expert_return"].notna().all()


def test_without_an_expert_there_are_no_scores(data: Path) -> None:
    synthetic.write_record(RunConfig.create("HC2", "silem", budget="book"))
    frame = results.load_records("halfcheetah", "book")
    assert frame["normalised"].isna().all() and frame["expert_return"].isna().all()


def test_no_records_give_an_empty_table_with_everything_missing(data: Path) -> None:
    frame = results.load_records("halfcheetah", "tiny")
    assert len(frame) == 0 and list(frame.columns) == results.COLUMNS
    assert len(pd.DataFrame(frame.attrs["missing"])) == 16
    assert results.body_names(frame) == ["HC0", "HC1", "HC2"]


def test_runs_of_other_settings_and_seeds_are_set_aside_by_name(data: Path) -> None:
    kept = synthetic.write_record(RunConfig.create("HC1", "silem", budget="book", seed=1))
    other = [
        RunConfig.create("HC1", "silem", budget="book", seed=1, gradient_penalty=7.5),
        RunConfig.create("HC1", "silem", "HC2", budget="book", seed=1),
        RunConfig.create("HC1", "silem", budget="book", seed=77),
    ]
    for config in other:
        synthetic.write_record(config)
    synthetic.write_record(RunConfig.create("HC1", "silem", budget="quick", seed=1))
    frame = results.load_records("halfcheetah", "book")
    assert list(frame["run_id"]) == [kept.run_id]
    assert sorted(frame.attrs["set_aside"]) == sorted(config.run_id for config in other)


def test_small_budgets_read_the_working_folder_and_any_seed(data: Path) -> None:
    config = RunConfig.create("HC2", "silem", budget="tiny", seed=7)
    synthetic.write_record(config, folder=paths.runs_dir() / "halfcheetah" / config.run_id)
    book = RunConfig.create("HC2", "silem", budget="book")
    synthetic.write_record(book, folder=paths.runs_dir() / "halfcheetah" / book.run_id)
    assert list(results.load_records("halfcheetah", "tiny")["run_id"]) == [config.run_id]
    assert len(results.load_records("halfcheetah", "book")) == 0  # not published, no evidence


def test_the_random_policy_counts_once(data: Path) -> None:
    for seed in TRIAL_SEEDS:
        synthetic.write_record(RunConfig.create("HC0", "random", budget="book", seed=seed))
    frame = results.load_records("halfcheetah", "book")
    assert list(frame["seed"]) == [0]
    assert frame.attrs["set_aside"] == []
    assert not [r for r in frame.attrs["missing"] if r["method"] == "random" and r["seed"] > 0]


def test_unknown_names_are_refused(data: Path) -> None:
    with pytest.raises(SilemError, match="allowed: tiny, quick, book, paper"):
        results.load_records("halfcheetah", "huge")
    with pytest.raises(SilemError, match="unknown study"):
        results.load_records("cats", "book")
    with pytest.raises(SilemError, match="no finished run 'x'"):
        results.load_curve("x")


def test_tables_of_several_budgets_are_refused(data: Path) -> None:
    for budget in ("tiny", "book"):
        synthetic.write_record(RunConfig.create("HC0", "ppo", budget=budget))
    tiny, book = (results.load_records("halfcheetah", name) for name in ("tiny", "book"))
    with pytest.raises(SilemError, match="load_records"):
        results.context(pd.concat([tiny, book]))


def test_selecting_narrows_runs_and_missing_runs_alike(frame: pd.DataFrame) -> None:
    narrowed = results.select(frame, ("ppo", "silem"), ("HC2",))
    assert sorted(set(narrowed["method"])) == ["ppo", "silem"]
    assert set(narrowed["body"]) == {"HC2"}
    assert len(narrowed) == 6 and len(narrowed.attrs["missing"]) == 4
    assert results.body_names(narrowed) == ["HC2"]
    assert results.original_body(narrowed) == "HC0"
    assert results.body_names(frame) == ["HC0", "HC1", "HC2"]
    assert len(frame.attrs["missing"]) == 9  # the whole table is untouched
    assert "6 runs, 4 of the planned runs not made yet" in results.describe(narrowed)


def test_what_a_table_carries_along_is_not_copied_by_pandas(frame: pd.DataFrame) -> None:
    assert frame[frame["seed"] > 0].attrs["missing"] is frame.attrs["missing"]
    assert results.select(frame, ("ppo",)).attrs["set_aside"] is frame.attrs["set_aside"]


def test_curves_and_transforms_load_by_run_id(data: Path) -> None:
    record = synthetic.write_record(RunConfig.create("HC1", "silem", budget="book"))
    curve = results.load_curve(record.run_id)
    assert curve["timesteps"].is_monotonic_increasing and curve["return_mean"].notna().any()
    arrays = results.load_transform(record.run_id)
    assert arrays["A"].shape == arrays["b"].shape == (26,)
    expert = synthetic.write_record(RunConfig.create("HC1", "ppo", budget="book"))
    with pytest.raises(SilemError, match=r"transform\.npz"):
        results.load_transform(expert.run_id)


# ---------------------------------------------------------------- records that are refused


def _set(*keys: str | int, to: Any) -> Callable[[dict[str, Any]], None]:
    def change(content: dict[str, Any]) -> None:
        for key in keys[:-1]:
            content = content[key]
        content[keys[-1]] = to

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_set("evaluation", "speed_m_s", to=float("nan")), "it holds NaN"),
        (_set("evaluation", "returns", 1, to=float("inf")), "it holds Infinity"),
        (_set("evaluation", "return_mean", to=0.0), "not the mean"),
        (_set("evaluation", "n_episodes", to=3), "2 returns of 3 episodes"),
        (_set("config", "seed", to=3), "its configuration's is"),
        (_set("config", "body", to="HC9"), "unknown body 'HC9'"),
        (_set("run_id", to="mine"), "run id 'mine'"),
        (_set("evaluation", to={}), "lacks or misstates"),
        (_set("surprise", to=1), "no run record"),
        (_set("files", "curve.csv", to="0" * 64), "SHA-256 differs"),
    ],
)
def test_a_record_that_contradicts_itself_is_refused(
    data: Path, change: Callable[[dict[str, Any]], None], message: str
) -> None:
    record = synthetic.write_record(RunConfig.create("HC1", "silem", budget="tiny"))
    assert check(record.folder) == record  # as written it is sound
    path = record.folder / "record.json"
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    with pytest.raises(SilemError, match=message):
        check(record.folder)
    with pytest.raises(SilemError, match=message):
        if "SHA" in message:  # a file is checked by whoever reads it
            results.load_curve(results.load_records("halfcheetah", "tiny")["run_id"][0])
        results.load_records("halfcheetah", "tiny")


def test_a_record_in_another_runs_folder_is_refused(data: Path) -> None:
    record = synthetic.write_record(RunConfig.create("HC1", "silem", budget="tiny"))
    moved = record.folder.rename(record.folder.with_name("another"))
    with pytest.raises(SilemError, match="run id"):
        check(moved)


def test_a_curve_that_was_changed_or_lost_is_refused(data: Path) -> None:
    record = synthetic.write_record(RunConfig.create("HC1", "silem", budget="tiny"))
    curve = record.folder / "curve.csv"
    curve.write_text(curve.read_text().replace("1,", "2,", 1))
    with pytest.raises(SilemError, match="SHA-256 differs"):
        check(record.folder)
    curve.unlink()
    with pytest.raises(SilemError, match="cannot read"):
        check(record.folder)


def test_single_returns_agree_with_their_mean_to_their_rounding(data: Path) -> None:
    record = synthetic.write_record(RunConfig.create("HC1", "ppo", budget="book"))
    assert np.mean(record.evaluation["returns"]) != record.evaluation["return_mean"]
    check(record.folder)
