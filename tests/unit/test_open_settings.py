"""The search for the open settings, as it is read, tabled and drawn."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import synthetic_records as synthetic
from drawn import assert_readable, footer

from silem.report import curves, results, tables
from silem.report.pages import open_settings as search
from silem.study import runs
from silem.study.config import RunConfig
from silem.study.studies import cells, study_configs
from silem.util import files, paths
from silem.util.errors import SilemError

BODIES = ("HC1", "HC2")
QUANTITIES = ("return_mean", "episode_length", "speed_m_s")


@pytest.mark.parametrize("family", ["halfcheetah", "humanoids"])
def test_every_run_is_loaded_with_its_curve(family: str) -> None:
    frame = search.load(family)
    entries = files.read_json(paths.REPO / "data" / "search" / f"{family}.json")
    assert list(frame["name"]) == [entry["name"] for entry in entries]
    for run, entry in zip(frame.to_dict("records"), entries, strict=True):
        assert list(run["curve"].columns) == entry["columns"]
        assert run["curve"]["iteration"].iloc[-1] == entry["rows"][-1][0]
        assert run["curve"].iloc[-1, 1] == entry["rows"][-1][1]


def test_a_method_is_loaded_alone() -> None:
    methods = search.load("humanoids", "ppo")["method"]
    assert set(methods) == {"ppo"}
    assert 0 < len(methods) < len(search.load("humanoids"))


def test_an_entry_that_lacks_something_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    entries = files.read_json(paths.REPO / "data" / "search" / "humanoids.json")
    del entries[3]["schedule"]
    files.write_json(tmp_path / "data" / "search" / "humanoids.json", entries)
    monkeypatch.setattr(paths, "REPO", tmp_path)
    with pytest.raises(SilemError, match=r"humanoids.json: an entry lacks schedule"):
        search.load("humanoids")


def test_one_number_is_read_from_one_curve() -> None:
    frame = search.load("humanoids")
    entries = files.read_json(paths.REPO / "data" / "search" / "humanoids.json")
    (entry,) = [entry for entry in entries if entry["name"] == "silem_gp_01"]
    row = dict(zip(entry["columns"], entry["rows"][-1], strict=True))
    assert search.at(frame, "silem_gp_01", row["iteration"], "speed_m_s") == row["speed_m_s"]
    with pytest.raises(SilemError, match="no row at iteration 7"):
        search.at(frame, "silem_gp_01", 7, "speed_m_s")
    with pytest.raises(SilemError, match="'silem_gp_2'"):
        search.at(frame, "silem_gp_2", 10, "speed_m_s")


def test_a_table_shows_what_was_varied_best_first() -> None:
    table = search.table(search.load("humanoids", "silem"))
    assert not {"clip range", "body", "method"} & set(table)  # the same in all of them
    assert {"gradient penalty", "starts", "discriminator reward", "steps before a fall"} <= set(
        table
    )
    returns = table["return"].astype(int)
    assert list(returns) == sorted(returns, reverse=True)
    assert "320 of 2,000" in set(table["iterations"])
    assert "discriminator reward" not in search.table(search.load("humanoids", "ppo"))
    runners = search.table(search.load())
    assert "rate of D" in runners
    assert "steps before a fall" not in runners
    assert {"SILEM", "SILEM⁻"} == set(runners["method"])


def test_curves_draw_every_run_in_every_panel_by_the_name_that_the_table_has() -> None:
    frame = search.load("humanoids", "silem")
    figure = curves.exploratory(frame, QUANTITIES)
    assert len(figure.axes) == len(QUANTITIES)
    for axes in figure.axes:
        assert [line.get_label() for line in axes.lines] == list(frame["name"])
    assert set(search.table(frame)["run"].str.replace("<wbr>", "")) == set(frame["name"])
    assert "not evidence" in footer(figure)
    assert_readable(figure)


def test_unknown_names_are_refused() -> None:
    with pytest.raises(SilemError, match="quantity"):
        curves.exploratory(search.load(), ["disc_loss"])
    with pytest.raises(SilemError, match="family"):
        search.load("ants")


# ---------------------------------------------------------------- the study


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., pd.DataFrame]:
    """Write the search's runs with given scores and load them; experts return what they do."""
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    for body in BODIES:
        synthetic.write_record(RunConfig.create(body, "ppo", budget="book"))

    def run(score: Callable[[RunConfig], float | None]) -> pd.DataFrame:
        for config in study_configs("open-settings", "book"):
            value = score(config)
            if value is not None:
                level = runs.find(RunConfig.create(config.body, "ppo", budget="book").run_id)
                assert level is not None
                goal = value * level.evaluation["return_mean"]
                synthetic.write_record(config, return_mean=goal)
        return results.load_records("open-settings", "book")

    return run


def rate(config: RunConfig) -> float:
    return config.hyper.transform_learning_rate


def row(table: pd.DataFrame, setting: str) -> pd.Series:
    return table[table["setting"] == setting].iloc[0]


def test_settings_are_judged_by_their_mean_over_both_bodies(write) -> None:
    def score(config: RunConfig) -> float | None:
        if config.method == "silem-minus":
            return None
        if rate(config) == 3e-4 and config.body == "HC2":
            return None
        return {1e-5: 0.2, 3e-5: 0.9, 1e-4: 0.89, 3e-4: 3.0, 1e-3: 0.5}[rate(config)] + (
            0.1 if config.body == "HC1" else -0.1
        )

    table = search.settings(write(score))
    fast = row(table, "rate of T 0.001")
    assert fast["score"] == pytest.approx(0.5, abs=0.02)
    assert fast["HC1"] - fast["HC2"] == pytest.approx(0.2, abs=0.03)
    lone = row(table, "rate of T 0.0003")
    assert lone["HC1"] > 2  # not judged by one body, however high
    assert np.isnan(lone["score"])
    silem = table[table["method"] == "silem"]
    begun = "as it began: rate of T 0.0001, gradient penalty 1"
    near = {"rate of T 3e−5", begun}
    assert set(silem.loc[silem["near"], "setting"]) == near
    assert not table.loc[table["method"] == "silem-minus", "near"].any()
    assert list(table.loc[table["in_use"], "method"]) == ["silem", "silem-minus"]
    assert row(table, "rate of T 1e−5, gradient penalty 0.1")["in_use"]
    assert list(table.loc[table["first"], "method"]) == ["silem", "silem-minus"]
    assert row(table, begun)["first"]


def planned(method: str) -> set[Any]:
    return {cell.overrides for cell in cells("open-settings") if cell.method == method}


def test_the_table_shows_every_setting_tried_or_not(write) -> None:
    shown = search.found(write(lambda c: 0.5 if c.method == "silem" else None)).data
    silem, minus = (shown[shown["method"] == name] for name in ("SILEM", "SILEM⁻"))
    assert len(silem) == len(planned("silem"))
    assert not silem["mean"].str.contains("–").any()
    assert silem["mean"].str.contains("<strong>0.5").any()
    assert set(minus["mean"]) == set(minus["HC1"]) == {"–"}
    assert silem["setting"].str.startswith("→ ").sum() == 1


def test_without_any_run_the_plan_is_shown(write) -> None:
    frame = write(lambda config: None)
    assert set(search.found(frame).data["mean"]) == {"–"}


def test_with_and_without_the_penalty_stand_below_each_other(write) -> None:
    write(lambda config: None)
    for study, value in (("halfcheetah", 900.0), ("no-gradient-penalty", 100.0)):
        (config,) = [
            c for c in study_configs(study, "book", 1) if (c.method, c.body) == ("silem", "HC2")
        ]
        synthetic.write_record(config, return_mean=value)
    both = [results.load_records(name, "book") for name in ("halfcheetah", "no-gradient-penalty")]
    frames = dict(zip(("yes", "no"), both, strict=True))
    table = tables.beside("penalty", frames, ["silem", "silem-minus"])
    table = table.set_index(["body", "method", "penalty"])
    returns = table["return"].to_dict()
    assert 880 < int(returns["HC2", "SILEM", "yes"]) < 920
    assert 80 < int(returns["HC2", "SILEM", "no"]) < 120
    assert returns["HC1", "SILEM⁻", "no"] == "–"
    gain = table.loc[("HC2", "SILEM", "no"), "difference in return"]
    penalised, free = (int(returns["HC2", "SILEM", name]) for name in ("yes", "no"))
    assert int(gain.replace("−", "-")) == pytest.approx(free - penalised, abs=1)
    assert table.loc[("HC1", "SILEM⁻", "no"), "trials"] == "0"


# ---------------------------------------------------------------- the transform's travel


def test_the_travel_allowed_is_rate_times_steps_with_decay() -> None:
    hyper = RunConfig.create("HC1", "silem", transform_lr_decay=0.5, n_transform_updates=3).hyper
    assert search.travel_allowed(hyper, 3) == pytest.approx(3 * 1e-5 * (1 + 0.5 + 0.25))
    steady = dataclasses.replace(hyper, transform_lr_decay=1.0)
    assert search.travel_allowed(steady, 100) == pytest.approx(300 * 1e-5)


def test_travel_is_the_largest_entry(write) -> None:
    frame = write(lambda config: 0.5)
    table = search.travel([frame])
    assert len(table) == (frame["method"] == "silem").sum()
    arrays = results.load_transform(table["run_id"][0])
    assert table["A"][0] == np.abs(arrays["A"] - 1).max()
    assert table["b"][0] == np.abs(arrays["b"]).max()


def test_travel_is_told_for_each_body_and_bound() -> None:
    table = pd.DataFrame(
        {"body": ["HC1", "HC1", "HC2"], "allowed": [0.3] * 3,
         "A": [0.29, 0.06, 0.2], "b": [0.1, 0.03, 0.02]}
    )  # fmt: skip
    one, two = search.travel_table(table).to_dict("records")
    assert (one["body"], one["runs"], one["rate of T × its steps"]) == ("HC1", "2", "0.3")
    assert one["largest |A − 1|"] == "0.17, at most 0.29"
    assert two["largest |b|"] == "0.02, at most 0.02"
    assert (one["at their bound"], two["at their bound"]) == ("1", "0")
    assert list(search.travel_table(table[:0])["runs"]) == ["no run"]
