"""What the pages "What this book cost" and "For reviewers" count and draw."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
import synthetic_records as synthetic

from silem.report import results, style
from silem.report.pages import cost, reviewers
from silem.study.config import RunConfig
from silem.study.studies import STUDIES, study_configs

PLANNED = [name for name, study in STUDIES.items() if study.cells]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))


def test_costs_are_those_of_the_records_and_missing_runs_are_counted() -> None:
    for seed in (0, 1):
        synthetic.write_record(RunConfig.create("HC0", "ppo", budget="book", seed=seed))
    found = cost.runs()
    assert found["steps"].iloc[0] == pytest.approx(800 * 2048 / 1e6)
    rows = {row["study"]: row for row in cost.by_study(found).data.to_dict("records")}
    n_planned = len(study_configs("halfcheetah", "book"))
    cheetahs = rows["halfcheetah"]
    assert (cheetahs["runs"], cheetahs["missing"]) == (2, n_planned - 2)
    assert cheetahs["trials of a cell"] == "2" and rows["humanoids"]["trials of a cell"] == "–"
    assert list(rows) == [*PLANNED, "all"]
    counted = cost.counts(found)
    assert (counted["runs"], counted["missing"]) == (2, len(found) - 2)
    assert counted["hours"] == pytest.approx(2 * 420 / 3600)
    (method,) = cost.by_method(found).data.to_dict("records")
    assert (method["method"], method["runs"]) == ("PPO, true reward", 2)
    assert cost.by_processor(found).data["runs"].tolist() == [2]


def test_a_run_that_no_study_plans_is_counted_after_them() -> None:
    synthetic.write_record(RunConfig.create("HC0", "ppo", budget="quick", study="aside"))
    rows = cost.by_study(cost.runs()).data
    assert rows["study"].tolist() == [*PLANNED, "aside", "all"]
    assert rows["runs"].tolist() == [0] * len(PLANNED) + [1, 1]


def test_hours_left_are_the_missing_steps_at_the_speed_of_the_like() -> None:
    none = cost.runs()
    assert pd.isna(cost.counts(none)["hours_left"])
    assert all("no run" in page(none).to_html() for page in (cost.by_method, cost.by_processor))
    synthetic.write_record(RunConfig.create("HC0", "ppo", budget="book", seed=0))
    runs = cost.runs()
    made, left = runs[runs["wall_time_s"].notna()], runs[runs["wall_time_s"].isna()]
    hours = made["wall_time_s"].iloc[0] / 3600
    ppo = left[(left["study"] == "halfcheetah") & (left["method"] == "ppo")]
    assert cost.hours_left(ppo, made) == pytest.approx(hours * len(ppo))
    assert cost.hours_left(ppo[:0], made) == 0
    walkers = left[(left["study"] == "humanoids") & (left["method"] == "ppo")]
    # nothing of the kind was made: the steps at the speed of all runs
    per_step = hours / made["steps"].iloc[0]
    assert cost.hours_left(walkers, made) == pytest.approx(per_step * walkers["steps"].sum())


def test_every_claim_is_in_the_reviewers_table() -> None:
    synthetic.write_record(RunConfig.create("HC0", "ppo", budget="book", seed=0), 2000.0)
    judged = reviewers.judged()
    rows = {row.claim: row for row in reviewers.verdicts(judged).data.itertuples()}
    expert = rows.pop("The expert's return is the paper's")
    assert expert.here.startswith("<div><b>HC0 undecided:</b> return 2,0")
    assert expert.paper == "2,249" and "no value yet" not in expert.here
    waiting = [row.here.partition("no value yet:</b> ")[2].split(", ") for row in rows.values()]
    assert sum(map(len, waiting)) == len(judged) - 1 and all(map(all, waiting))
    counted = reviewers.counts(judged)
    assert counted["few"] == counted["undecided"] == counted["claims"] == len(judged)


def test_improvement_and_profiles_show_what_the_runs_say() -> None:
    returns = {"silem": (900, 800, 700), "tpil": (100, 200, 300), "peng20": (750,)}
    for plan in study_configs("humanoids", "book"):
        known = returns.get(plan.method, ()) if plan.body == "Atlas" else ()
        if plan.seed < len(known):
            synthetic.write_record(plan, float(known[plan.seed]))
    frame = results.load_records("humanoids", "book")
    (axes,) = reviewers.improvement(frame).axes
    rows = [label.get_text() for label in axes.get_yticklabels()]
    said = [text.get_text() for text in axes.texts]
    assert len(rows) == 9 and said.count("no run") == 7
    points = {round(y): (x, line.get_mfc()) for line in axes.lines if line.get_marker() != "None"
              for x, y in [line.get_xydata()[0]]}  # fmt: skip
    assert said[rows.index("TPIL, Atlas")] == "3 and 3 trials"
    share, face = points[rows.index("TPIL, Atlas")]
    assert share == 1 and face != "white"  # decided
    share, face = points[rows.index("Peng20, Atlas")]
    assert share == pytest.approx(2 / 3) and face == "white"

    (axes,) = reviewers.profiles(frame).axes
    lines = {line.get_color(): line.get_xydata() for line in axes.lines}
    taus, shares = lines[style.method("silem").color].T
    assert shares[taus < 0.69].tolist() == [1.0] * (taus < 0.69).sum()
    assert shares[(taus > 0.71) & (taus < 0.79)] == pytest.approx(2 / 3)
    assert not axes.collections  # three runs have no band


def test_every_demonstration_has_a_card_with_a_licence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SILEM_DATA_DIR")
    cards = {
        row["file"].partition("<")[0]: row for row in reviewers.cards().data.to_dict("records")
    }
    assert "cmu_08_01_on_Atlas.npz" in cards
    for row in cards.values():
        assert "licence: " in row["origin"] and "SHA-256" in row["file"]
    assert "MIT" in cards["HC0.npz"]["origin"] and "2.61 m/s" in cards["HC0.npz"]["holds"]
    assert "free for all uses" in cards["cmu_08_05.npz"]["origin"]
