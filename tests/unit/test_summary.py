"""What the pages "What this book cost" and "For reviewers" count."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest
import synthetic_records as synthetic

from silem.report import results, style, summary
from silem.study.config import RunConfig
from silem.study.studies import STUDIES, study_configs


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    for cached in (summary.costs, summary.judged):
        cached.cache_clear()
    yield
    for cached in (summary.costs, summary.judged):
        cached.cache_clear()


def test_costs_are_those_of_the_records_and_missing_runs_are_counted() -> None:
    for seed in (0, 1):
        synthetic.write_record(RunConfig.create("HC0", "ppo", budget="book", seed=seed))
    found = summary.costs()
    assert len(found) == 2 and found["steps"].iloc[0] == pytest.approx(800 * 2048 / 1e6)
    rows = {row[0]: row for row in summary.cost().rows}
    n_planned = len(study_configs("halfcheetah", "book"))
    assert rows["`halfcheetah`"][1:4] == ("2", str(n_planned - 2), "2")
    assert rows["`humanoids`"][3] == "–"
    assert set(rows) == {f"`{study}`" for study in STUDIES} | {"**all**"}


def test_hours_left_are_the_missing_steps_at_the_speed_of_the_like() -> None:
    synthetic.write_record(RunConfig.create("HC0", "ppo", budget="book", seed=0))
    hours = summary.costs()["hours"].iloc[0]
    plans = summary.planned()
    ppo = plans[(plans["study"] == "halfcheetah") & (plans["method"] == "ppo")]
    assert summary.hours_left(ppo) == pytest.approx(hours * (len(ppo) - 1))
    assert summary.hours_left(ppo.assign(hours=1.0)) == 0
    walkers = plans[(plans["study"] == "humanoids") & (plans["method"] == "ppo")]
    # nothing of the kind was made: the steps at the speed of all runs
    per_step = hours / summary.costs()["steps"].iloc[0]
    assert summary.hours_left(walkers) == pytest.approx(per_step * walkers["steps"].sum())


def test_every_claim_is_in_the_reviewers_table() -> None:
    synthetic.write_record(RunConfig.create("HC0", "ppo", budget="book", seed=0), 2000.0)
    judged, rows = summary.judged(), dict(summary.verdicts().rows)
    expert, *others = rows.pop("The expert's return is the paper's").split("<br>")
    assert expert.startswith("**HC0 undecided:** return 2,0") and not others
    waiting = [text.partition("no value yet:** ")[2].split(", ") for text in rows.values()]
    assert sum(map(len, waiting)) == len(judged) - 1 and all(map(all, waiting))
    assert summary.counts()["few"] == summary.counts()["undecided"] == str(len(judged))


def test_improvement_and_profiles_show_what_the_runs_say() -> None:
    returns = {"silem": (900, 800, 700), "tpil": (100, 200, 300), "peng20": (750,)}
    for plan in study_configs("humanoids", "book"):
        known = returns.get(plan.method, ()) if plan.body == "Atlas" else ()
        if plan.seed < len(known):
            synthetic.write_record(plan, float(known[plan.seed]))
    frame = results.load_records("humanoids", "book")
    (axes,) = summary.improvement(frame).axes
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

    (axes,) = summary.profiles(frame).axes
    lines = {line.get_color(): line.get_xydata() for line in axes.lines}
    taus, shares = lines[style.method("silem").color].T
    assert shares[taus < 0.69].tolist() == [1.0] * (taus < 0.69).sum()
    assert shares[(taus > 0.71) & (taus < 0.79)] == pytest.approx(2 / 3)
    assert not axes.collections  # three runs have no band


def test_every_demonstration_has_a_card_with_a_licence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SILEM_DATA_DIR")
    cards = dict(summary.cards())
    assert "HC0.npz" in cards and "cmu_08_01_on_Atlas.npz" in cards
    for fields in cards.values():
        assert dict(fields)["Licence"] and len(dict(fields)["SHA-256"]) > 16
    assert "MIT" in dict(cards["HC0.npz"])["Licence"]
    assert "free for all uses" in dict(cards["cmu_08_05.npz"])["Licence"]
    assert isinstance(summary.costs(), pd.DataFrame)
