"""The search for the open settings, as it is read, tabled and drawn."""

from __future__ import annotations

from pathlib import Path

import pytest
from drawn import assert_readable, footer, texts

from silem.report import search
from silem.util import files, paths
from silem.util.errors import SilemError

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
    del entries[3]["starts"]
    files.write_json(tmp_path / "data" / "search" / "humanoids.json", entries)
    monkeypatch.setattr(paths, "REPO", tmp_path)
    with pytest.raises(SilemError, match=r"humanoids.json: an entry lacks starts"):
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
    assert "clip range" not in table  # the same in all of them
    assert not {"body", "method"} & set(table)
    assert {"gradient penalty", "starts", "reward of D", "steps before a fall"} <= set(table)
    returns = table["return"].astype(int)
    assert list(returns) == sorted(returns, reverse=True)
    assert "320 of 2,000" in set(table["iterations"])
    assert "reward of D" not in search.table(search.load("humanoids", "ppo"))
    runners = search.table(search.load())
    assert {"body", "method", "rate of D"} <= set(runners)
    assert "steps before a fall" not in runners


def test_curves_name_what_differs_and_say_what_does_not() -> None:
    frame = search.load("humanoids", "silem")
    figure = search.curves(frame, QUANTITIES, colored="gradient_penalty")
    assert len(figure.axes) == len(QUANTITIES)
    for axes in figure.axes:
        assert len(axes.lines) == len(frame)
    legend = [text.get_text() for text in figure.axes[-1].get_legend().get_texts()]
    assert "gradient penalty 1, starts demonstration" in legend
    assert "gradient penalty 0.1, rate of PPO 0.0002, iterations planned 1000" in legend
    assert "unless named: rate of PPO 0.0003" in footer(figure)
    assert "not evidence" in footer(figure)
    assert_readable(figure)


def test_curves_of_several_bodies_stand_side_by_side() -> None:
    figure = search.curves(search.load())
    assert {"HC1", "HC2"} <= set(texts(figure))
    assert "SILEM⁻" in [text.get_text() for text in figure.axes[1].get_legend().get_texts()]
    assert_readable(figure)


def test_unknown_names_are_refused() -> None:
    with pytest.raises(SilemError, match="quantity"):
        search.curves(search.load(), ["disc_loss"])
    with pytest.raises(SilemError, match="column"):
        search.curves(search.load(), colored="starts")
    with pytest.raises(SilemError, match="family"):
        search.load("ants")
