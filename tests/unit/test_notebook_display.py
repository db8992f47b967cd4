"""How the notebooks show tables and say numbers."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import synthetic_records as synthetic

from silem.report import film, notebook, results
from silem.study.runs import RunRecord
from silem.study.studies import study_configs


def cells(frame: pd.DataFrame, digits: int | None = None) -> list[list[str]]:
    return notebook.table(frame, digits).data.to_numpy().tolist()


def test_table_writes_numbers_for_readers() -> None:
    frame = pd.DataFrame({"n": [1001, -2], "x": [-0.001, 12345.678], "text": ["a<b", "c"]})
    assert cells(frame, digits=2) == [["1,001", "0.00", "a&lt;b"], ["−2", "12,345.68", "c"]]


def test_table_without_digits_keeps_numbers_as_they_are() -> None:
    frame = pd.DataFrame({"value": [2e-4, 0.99, 64, [64, 64], True, None]}, dtype=object)
    assert [row[0] for row in cells(frame)] == ["0.0002", "0.99", "64", "[64, 64]", "True", "None"]


def test_a_banner_says_that_a_study_has_no_run(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[str] = []
    monkeypatch.setattr(notebook, "display", lambda page: shown.append(page.data))
    frame = pd.DataFrame({"run_id": ["shared"]})
    frame.attrs = {"missing": [{}] * 7}
    notebook.need_runs(frame, "the ladder")
    assert not shown
    frame.attrs["n_own"] = 0  # what another study made does not count
    notebook.need_runs(frame, "the ladder")
    assert "No run of the ladder is finished; 7 are planned." in shown[0]
    assert notebook.NO_RUNS in shown[0]


def test_named_index_becomes_the_first_column_and_an_unnamed_one_is_left_out() -> None:
    frame = pd.DataFrame({"x": [1]}, index=["row"])
    assert cells(frame.rename_axis("name")) == [["row", "1"]]
    assert cells(frame) == [["1"]]


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (2249.4, "2,249"),
        (-1555.0, "−1,555"),
        (0.914, "0.91"),
        (-0.04, "−0.04"),
        (28, "28"),
        (99.999, "100.00"),
        (float("nan"), "–"),
        (None, "–"),
        (np.array([]), "–"),
        (np.array([0.25, 0.5]), "0.38"),
        ("as it is", "as it is"),
    ],
)
def test_sentences_get_numbers_in_words(
    value: object, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = {}
    monkeypatch.setattr(
        notebook, "glue", lambda name, text, display: said.update({name: (text, display)})
    )
    notebook.say(number=value)
    assert said == {"number": (words, False)}


def test_the_first_trial_of_each_method_is_filmed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    plans = {c.method: c for c in study_configs("humanoids", "book", 1) if c.body == "Humanoid"}
    plan, ppo = plans["silem"], plans["ppo"]
    for seed, level in enumerate((840.0, 870.0)):
        first = synthetic.write_record(dataclasses.replace(plan, seed=seed), level)
    synthetic.write_record(ppo, 300.0)
    frame = results.load_records("humanoids", "book")
    methods = ("silem", "silem-minus", "ppo")
    filmed: dict[str, RunRecord | None] = {}
    shown: list[tuple[film.Clip | None, str]] = []
    clips = {"a clip": film.Clip(np.zeros((2, 30, 40, 3), np.uint8), 20.0)}
    monkeypatch.setattr(film, "of_runs", lambda runs, *_: filmed.update(runs) or clips)
    monkeypatch.setattr(notebook, "play", lambda *call: shown.append(call))
    monkeypatch.setattr(film, "why_no_pictures", lambda body: "")
    notebook.play_trials(frame, methods, "Humanoid", 0.1)
    assert list(filmed) == ["SILEM", "SILEM⁻", "PPO"] and filmed["SILEM⁻"] is None
    assert filmed["SILEM"].run_id == plan.run_id != first.run_id  # not the best
    ((clip, caption),) = shown
    assert clip is not None and caption.endswith("time: SILEM | SILEM⁻: no run yet | PPO")
    notebook.play_trials(frame, methods, "Atlas", 0.1)
    assert shown[-1][0] is None  # there is no run
