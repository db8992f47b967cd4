"""The Ants' figures, tables and claims, on made-up records whose truth is known."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import synthetic_records as synthetic
from drawn import assert_readable, footer, lines_at, texts
from matplotlib.figure import Figure

from silem import bodies
from silem.report import claims, curves, results, scores, style, tables, transforms
from silem.report.claims import FAILS, HOLDS, UNDECIDED
from silem.report.pages import ants
from silem.study.studies import study_configs

CASES = ("whole", "partial", "empty")
FIGURES: dict[str, Callable[[pd.DataFrame], Figure]] = {
    "figure_2d": scores.normalised_scores,
    "learning_curves": curves.learning_curves,
    "by_feature": transforms.by_feature,
    "tracking": ants.tracking,
}
STABLE, UNSTABLE = "SILEM's gait is stable on Ant6", "SILEM⁻ finds no stable gait on Ant6"


def make(case: str, folder: Path) -> pd.DataFrame:
    """Write one made-up study of the Ants, and load it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SILEM_DATA_DIR", str(folder))
        few = {("silem", "Ant5"): 0, ("silem-minus", "Ant3"): 1, ("ppo", "Ant2"): 0}
        if case != "empty":
            synthetic.write_study(n_trials=3, study="ant", without=few if case == "partial" else {})
        return results.load_records("ant", "book")


def changed(frame: pd.DataFrame, method: str, body: str, **columns: float) -> pd.DataFrame:
    """A table in which one cell's trials have some values, which differ a little."""
    other = frame.copy()
    other.attrs = frame.attrs
    rows = other["method"].eq(method) & other["body"].eq(body)
    for name, value in columns.items():
        other.loc[rows, name] = value * (1 + 1e-4 * np.arange(rows.sum()))
    return other


def verdict(frame: pd.DataFrame, text: str) -> str:
    return claims.evaluate(frame).set_index("text").loc[text, "verdict"]


# ---------------------------------------------------------------- figures and tables


@pytest.mark.parametrize("name", FIGURES)
@pytest.mark.parametrize("frame", ["partial", "empty"], indirect=True)
def test_seven_bodies_fit_into_a_figure(name: str, frame: pd.DataFrame) -> None:
    figure = FIGURES[name](frame)
    assert_readable(figure)
    if name == "learning_curves":
        assert "steps before a fall" in texts(figure)


def test_figure_2d_shows_scores_speeds_and_steps(frame: pd.DataFrame) -> None:
    score, speed, steps = scores.normalised_scores(frame).axes
    for axes, column in ((score, "normalised"), (speed, "speed_m_s"), (steps, "steps")):
        drawn = [line.get_ydata() for line in lines_at(axes, style.METHODS["silem-minus"].color)]
        mean = results.scores(frame, "silem-minus", "Ant6", column).mean()
        assert any(len(y) == 1 and y[0] == mean for y in drawn)
    experts = [lines_at(axes, style.METHODS["ppo"].color) for axes in (score, speed)]
    assert not [line for line in experts[0] if line.get_marker() == "P"] and experts[1]
    assert len([line for line in score.lines if line.get_marker() == "X"]) == 7  # random policies
    assert "trials of a cell: 3;" in footer(score.figure)


@synthetic.study("empty")
def test_without_runs_figure_2d_is_empty_slots(frame: pd.DataFrame) -> None:
    assert texts(scores.normalised_scores(frame)).count("no run") == 7 * (4 + 5 + 5)
    assert "no run" in texts(ants.tracking(frame))


@synthetic.study("partial")
def test_steps_stand_beside_the_return(frame: pd.DataFrame) -> None:
    table = tables.cell_table(frame).data
    assert list(table)[3:5] == ["return", "steps of an episode"] and len(table) == 35
    rows = table.set_index(["body", "method"])["steps of an episode"]
    mean = results.scores(frame, "silem-minus", "Ant6", "steps").mean()
    assert rows["Ant6", "SILEM⁻ (Ant0 expert)"].startswith(f"{mean:,.0f}<br>")
    assert rows["Ant5", "SILEM"] == style.DASH


def test_who_can_fall() -> None:
    assert [bodies.get(name).can_fall for name in ("HC2", "Ant0", "Atlas")] == [False, True, True]


# ---------------------------------------------------------------- the page


def test_survival_is_taken_out_of_both_returns(frame: pd.DataFrame) -> None:
    level = changed(frame, "ppo", "Ant6", return_mean=2500.0, steps=1000.0)
    silem = changed(level, "silem", "Ant6", return_mean=1250.0, steps=500.0)
    found = ants.survival(silem).loc["Ant6"]
    assert found[ants.SHARE] == pytest.approx(0.4, rel=1e-3) == found[ants.STANDING]
    assert found["SILEM"] == pytest.approx(0.5, rel=1e-3)
    assert found["SILEM, moving"] == pytest.approx(0.5, rel=1e-3)  # 750 of 1500
    lasting = changed(level, "silem", "Ant6", return_mean=1250.0, steps=1000.0)
    assert ants.survival(lasting).loc["Ant6", "SILEM, moving"] == pytest.approx(1 / 6, rel=1e-3)
    assert found["SILEM⁻ (Ant0 expert), moving"] < found["SILEM⁻ (Ant0 expert)"]


@synthetic.study("empty")
def test_without_runs_survival_and_tracking_say_so(frame: pd.DataFrame) -> None:
    assert ants.survival(frame).isna().all(axis=None)
    assert ants.correlations(frame).empty
    assert beside(frame)["trials"].eq("0").all() and len(beside(frame)) == 8


def beside(frame: pd.DataFrame) -> pd.DataFrame:
    frames = {"no": frame, "yes": results.load_records("ant-absorbing", "book")}
    return tables.beside("absorbing states", frames, scores.IMITATORS)


def test_absorbing_states_are_compared_on_the_seeds_of_both(frame: pd.DataFrame) -> None:
    configs = study_configs("ant-absorbing", "book", 2, body=["Ant6"], method=["silem"])
    for config in configs:
        synthetic.write_record(config, 1000.0 + 40 * config.seed)
    rows = beside(frame).set_index(["body", "method"]).loc[("Ant6", "SILEM")]
    assert list(rows["trials"]) == ["3", "2"]
    gain = 1020.0 - results.scores(frame, "silem", "Ant6", "return_mean").mean()
    told = rows["difference in return"].iloc[1].replace("−", "-").replace(",", "")
    assert float(told.partition(" ")[0]) == pytest.approx(gain, abs=10) and "[" in told


def test_what_tracks_the_length_is_found_and_little_else(frame: pd.DataFrame) -> None:
    found = ants.correlations(frame)
    assert len(found) == 2 * synthetic.N_FEATURES["ant"]
    (velocity,) = found[(found["entry"] == "A") & (found["feature"] == "forward velocity")].index
    assert found.loc[velocity, "rho"] > 0.9 and found.loc[velocity, "low"] > 0.8
    assert found["sure"].equals((found["low"] > 0) | (found["high"] < 0)) and found.sure[velocity]
    assert found["sure"].drop(velocity).mean() < 0.15
    blue = lines_at(ants.tracking(frame).axes[0], style.METHODS["silem"].color)
    assert any(line.get_marker() == "o" and line.get_xdata()[0] > 0.9 for line in blue)


def test_three_bodies_in_one_trial_each_are_too_few_to_track_anything(frame: pd.DataFrame) -> None:
    few = results.select(frame, ["silem"], ["Ant0", "Ant3", "Ant6"])
    assert ants.correlations(results.select(few[few["seed"] == 0], ["silem"])).empty
    assert len(
        ants.correlations(results.select(frame, ["silem"], ["Ant0", "Ant2", "Ant3", "Ant6"]))
    )


# ---------------------------------------------------------------- claims


def test_the_claims_of_figure_2d_are_those_of_the_halfcheetahs_and_gaits() -> None:
    titles = [claim.title for claim in claims.of("ant")]
    shared = {claim.title for claim in claims.of("halfcheetah") if claim.where == "Figure 2b"}
    assert shared < set(titles) and len(titles) == 7 + 6 + 6 + 7 + 7 + 1
    assert {claim.where for claim in claims.of("ant") if claim.title in shared} == {"Figure 2d"}


def test_a_stable_gait_lasts_and_moves(frame: pd.DataFrame) -> None:
    assert (verdict(frame, STABLE), verdict(frame, UNSTABLE)) == (HOLDS, HOLDS)
    fallen = changed(frame, "silem", "Ant6", steps=500.0)
    assert verdict(fallen, STABLE) == FAILS  # however fast
    standing = changed(frame, "silem", "Ant6", speed_m_s=0.1)
    assert verdict(standing, STABLE) == FAILS  # however long
    runs = changed(frame, "silem-minus", "Ant6", steps=990.0, speed_m_s=2.0)
    assert verdict(runs, UNSTABLE) == FAILS
    slow = changed(frame, "silem-minus", "Ant6", steps=990.0, speed_m_s=0.2)
    assert verdict(slow, UNSTABLE) == HOLDS


def test_where_silem_minus_keeps_up_the_claims_fail(frame: pd.DataFrame) -> None:
    swapped = frame.copy()
    swapped.attrs = frame.attrs
    names = {"silem": "silem-minus", "silem-minus": "silem"}
    swapped["method"] = [names.get(name, name) for name in frame["method"]]
    for text in ("SILEM beats SILEM⁻ on Ant6", STABLE, UNSTABLE):
        assert (verdict(frame, text), verdict(swapped, text)) == (HOLDS, FAILS), text
    assert verdict(swapped, "SILEM reaches expert level on Ant6") == FAILS
    text = "Without the transform imitation degrades, against the body's own expert on Ant6"
    same = changed(frame, "silem-minus", "Ant6", return_mean=2700.0)  # above its own expert's
    assert (verdict(frame, text), verdict(same, text)) == (HOLDS, FAILS)


@pytest.mark.parametrize("frame", ["partial", "empty"], indirect=True)
def test_what_is_undecided_has_too_few_trials(frame: pd.DataFrame) -> None:
    found = claims.evaluate(frame).set_index("text")
    if frame.empty:
        assert set(found["verdict"]) == {UNDECIDED}
        assert found["reason"].str.startswith("too few trials").all()
        return
    assert found.loc["SILEM beats SILEM⁻ on Ant3", "reason"] == "too few trials: SILEM⁻ 1; 3 needed"
    assert found.loc["SILEM beats SILEM⁻ on Ant6", "verdict"] == HOLDS
    level = found.loc["SILEM reaches expert level on Ant2", "reason"]
    assert level == "too few trials: PPO 0; 3 needed"
