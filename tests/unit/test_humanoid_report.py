"""Figures, tables and verdicts of the humanoids, drawn from made-up records."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import synthetic_records as synthetic
from drawn import assert_readable, lines_at, texts

from silem.motion.features import FEATURES
from silem.report import claims, curves, results, scores, style, transforms
from silem.report.scores import humanoid_scores
from silem.report.transforms import feature_groups, feature_names
from silem.study import studies as plans
from silem.study.config import RunConfig
from silem.util.errors import SilemError

CASES = ("whole", "partial", "single", "empty")
FIGURES = {
    "humanoid_scores": humanoid_scores,
    "figure 4": lambda frame: transforms.by_feature(arms(frame)),
    "experts": scores.experts,
    "learning_curves": curves.learning_curves,
    "transforms": transforms.by_feature,
}


def arms(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the runs of Figure 4."""
    return results.select(frame, ["silem"], ["Humanoid", "HumanoidR"])


def planned(method: str, body: str, seed: int = 0) -> RunConfig:
    """Return a run that the study of the humanoids plans."""
    (cell,) = [c for c in plans.cells("humanoids") if (c.method, c.body) == (method, body)]
    return cell.config("book", seed)


def make(case: str, folder: Path) -> pd.DataFrame:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SILEM_DATA_DIR", str(folder))
        if case == "whole":
            synthetic.write_study(n_trials=3, study="humanoids")
        elif case == "single":
            synthetic.write_study(n_trials=1, study="humanoids")
        elif case == "partial":
            few = {("silem", "HumanoidR"): 0, ("tpil", "Atlas"): 0, ("peng20", "Humanoid"): 1}
            few |= {("ppo", "Atlas"): 0, ("silem-minus", "HumanoidR"): 0}
            synthetic.write_study(n_trials=3, study="humanoids", without=few)
        return results.load_records("humanoids", "book")


# ---------------------------------------------------------------- figures


@pytest.mark.parametrize(
    ("frame", "name"),
    [
        *itertools.product(("partial", "empty"), FIGURES),
        ("single", "figure 4"),
        ("whole", "figure 4"),
    ],
    indirect=["frame"],
)
def test_every_figure_takes_humanoids_and_stays_readable(name: str, frame: pd.DataFrame) -> None:
    assert_readable(FIGURES[name](frame))


def test_figure_3b_shows_true_returns_between_ppo_and_the_highest(frame: pd.DataFrame) -> None:
    score = humanoid_scores(frame).axes[0]
    marks = [line.get_ydata() for line in lines_at(score, style.METHODS["tpil"].color)]
    mean = results.scores(frame, "tpil", "Atlas", "return_mean").mean()
    assert any(len(y) == 1 and y[0] == mean for y in marks)
    assert lines_at(score, style.PAPER)[0].get_ydata()[0] == 1000
    dashes = [line for line in lines_at(score, style.MUTED) if len(line.get_xdata()) == 2]
    levels = [line.get_ydata()[0] for line in dashes]
    names = ("Humanoid", "HumanoidR", "Atlas")  # as in every table
    assert levels == [results.scores(frame, "ppo", name, "return_mean").mean() for name in names]
    assert [label.get_text().partition("\n")[0] for label in score.get_xticklabels()] == list(names)


def test_figure_3b_shows_what_the_score_hides(frame: pd.DataFrame) -> None:
    _, survived, speed = humanoid_scores(frame).axes
    for axes, column in ((survived, "upright"), (speed, "speed_m_s")):
        blue = [line.get_ydata() for line in lines_at(axes, style.METHODS["silem"].color)]
        mean = results.scores(frame, "silem", "HumanoidR", column).mean()
        assert any(len(y) == 1 and y[0] == mean for y in blue)
    assert lines_at(speed, style.INK)[0].get_ydata()[0] == 1.6


@synthetic.study("single")
def test_single_trials_are_hollow(frame: pd.DataFrame) -> None:
    score = humanoid_scores(frame).axes[0]
    marks = [line for line in score.lines if line.get_marker() == style.METHODS["silem"].marker]
    assert [mark.get_markerfacecolor() for mark in marks] == ["white"] * 3
    assert texts(score.figure).count("n=1") == 12


def test_figure_4_draws_means_joined_by_group_and_every_policy(frame: pd.DataFrame) -> None:
    axes = transforms.by_feature(arms(frame)).axes[0]
    runs = results.cell(frame, "silem", "HumanoidR")["run_id"]
    entries = np.stack([results.load_transform(run)["A"] for run in runs])
    drawn = [line.get_xdata() for line in lines_at(axes, style.body_color(1, 2))]
    hand = entries.mean(axis=0)[:3]  # the left one
    assert any(len(x) == 3 and np.allclose(x, hand, rtol=1e-12) for x in drawn)
    assert all(any(np.array_equal(x, row) for x in drawn) for row in entries)
    labels = [tick.get_text() for tick in axes.get_yticklabels()]
    assert labels == feature_names("HumanoidR")
    stripes = [patch for patch in axes.patches if patch.get_facecolor()[0] < 0.95]
    assert len(stripes) == 3  # hands and elbows


def test_figure_4_shows_the_best_policies(
    frame: pd.DataFrame, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("silem.paper.number", lambda name: 1)
    axes = transforms.by_feature(arms(frame)).axes[1]
    cell = results.cell(frame, "silem", "Humanoid")
    best = cell.loc[cell["return_mean"].idxmax(), "run_id"]
    drawn = lines_at(axes, style.body_color(0, 2))
    offsets = results.load_transform(best)["b"]
    assert len(drawn) == len(feature_groups("Humanoid"))
    assert np.array_equal(drawn[0].get_xdata(), offsets[:3])


def test_figures_of_other_bodies_are_refused(
    frame: pd.DataFrame, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(SilemError, match="affine_or_mlp shows HC0; the runs of study 'humanoids'"):
        scores.affine_or_mlp(frame)
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    with pytest.raises(SilemError, match="humanoid_scores shows Humanoid, HumanoidR, Atlas"):
        humanoid_scores(results.load_records("halfcheetah", "book"))


def test_transforms_of_another_length_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    monkeypatch.setitem(synthetic.N_FEATURES, "humanoid", 30)
    monkeypatch.setattr(synthetic, "FEATURES", (*FEATURES, *FEATURES[:7]))
    synthetic.write_record(planned("silem", "Humanoid"))
    loaded = results.load_records("humanoids", "book")
    with pytest.raises(SilemError, match="23 features"):
        transforms.by_feature(loaded)


def test_no_expert_is_named_where_a_human_demonstrates(frame: pd.DataFrame) -> None:
    words = texts(curves.learning_curves(frame))
    assert {"SILEM⁻", "TPIL", "Peng20", "PPO, true reward"} <= set(words)
    assert not [word for word in words if "expert" in word]


@pytest.mark.parametrize("body", ["HC0", "Ant0", "Humanoid", "Atlas"])
def test_groups_hold_every_feature_once(body: str) -> None:
    columns = [column for group in feature_groups(body) for column in group.columns]
    assert sorted(columns) == list(range(len(feature_names(body))))


def test_humanoid_features_are_named_with_their_units() -> None:
    for group in feature_groups("HumanoidR"):
        for column, label in zip(group.columns, group.labels, strict=True):
            assert FEATURES[column].unit == group.unit
            assert sorted(FEATURES[column].label.split()) == sorted(f"{group.name} {label}".split())


# ---------------------------------------------------------------- verdicts


def verdicts(frame: pd.DataFrame) -> pd.Series:
    return claims.evaluate(frame).set_index("text")["verdict"]


ARMS = (
    "The short left arm's hand position is scaled up on HumanoidR",
    "The long right arm's hand position is scaled down on HumanoidR",
    "The left arm keeps the more obtuse angle on HumanoidR",
)


def test_scorecard_judges_figures_3_and_4(frame: pd.DataFrame) -> None:
    found = verdicts(frame)
    assert [found[name] for name in ARMS] == [claims.HOLDS] * 3
    assert found["SILEM far outperforms TPIL on HumanoidR"] == claims.HOLDS
    assert found["SILEM⁻ finds no stable gait on Humanoid"] == claims.HOLDS
    assert found["SILEM matches the human's speed on Atlas"] == claims.FAILS
    rows = claims.evaluate(frame).set_index("text")
    row = rows.loc["TPIL does much better on Atlas than on Humanoid"]
    (finding,) = row["findings"]
    assert finding.trials == {"TPIL Atlas": 3, "TPIL Humanoid": 3}
    assert (finding.wins, row["verdict"]) == (1.0, claims.HOLDS)
    assert "100 % of pairs" in claims.table(frame).to_html()


def test_limbs_expect_of_a_what_their_lengths_say() -> None:
    """The walk that is retargeted puts a hand of HumanoidR half or one and a half times as far."""
    names = [feature.name for feature in FEATURES]
    of = {body: dict(zip(names, transforms.expected(body), strict=True)) for body in
          ("Humanoid", "HumanoidR")}  # fmt: skip
    uneven, even = of["HumanoidR"], of["Humanoid"]
    assert uneven["left_hand_x"] == uneven["left_hand_z"] > 1 > even["left_hand_x"]
    assert even["right_hand_y"] > uneven["right_hand_y"]
    assert uneven["left_foot_x"] == pytest.approx(even["left_foot_x"], abs=1e-3)
    others = [name for name in names if "hand" not in name and "foot" not in name]
    assert np.isnan([even[name] for name in others]).all() and len(others) == 11
    assert np.isnan(transforms.expected("HC0")).all()


def test_a_that_is_as_expected_is_in_full_agreement(
    frame: pd.DataFrame, monkeypatch: pytest.MonkeyPatch
) -> None:
    def learned(run_id: str) -> dict[str, np.ndarray]:
        hoped = np.nan_to_num(transforms.expected(run_id.split("_")[1]), nan=5.0)
        return {"A": 1 + sign * (hoped - 1), "b": hoped}

    monkeypatch.setattr(results, "load_transform", learned)
    for sign, rho in ((1, "1.00"), (-1, "−1.00")):
        table = transforms.agreement(frame).set_index("body")
        assert all(text.startswith(f"{rho} [") for text in table["rank correlation"])
        cells = table.loc["HumanoidR", ["left hand", "right hand"]]
        assert all(len(set(text.split(" → "))) == 1 + (sign < 0) for text in cells)
    empty = transforms.agreement(results.load_records("humanoids", "paper"))
    assert (empty["rank correlation"] == style.DASH).all() and set(empty["policies"]) == {"0"}


def test_arm_claims_fail_where_the_arms_are_the_other_way_round(
    frame: pd.DataFrame, monkeypatch: pytest.MonkeyPatch
) -> None:
    load = results.load_transform

    def mirrored(run_id: str) -> dict[str, np.ndarray]:
        return {"A": 2 - load(run_id)["A"], "b": -load(run_id)["b"]}

    monkeypatch.setattr(results, "load_transform", mirrored)
    assert [verdicts(frame)[name] for name in ARMS] == [claims.FAILS] * 3


def test_claims_fail_where_silem_falls_and_a_rival_walks(frame: pd.DataFrame) -> None:
    other = frame.copy()
    other.attrs = frame.attrs
    for method, level in (("silem", 0.1), ("tpil", 0.9)):
        of_method = other["method"] == method
        other.loc[of_method, "return_mean"] = 1000 * level + other.loc[of_method, "seed"]
        other.loc[of_method, "upright"] = level
    found = verdicts(other)
    assert found["SILEM far outperforms TPIL on Humanoid"] == claims.FAILS
    assert found["SILEM's gait is stable on Humanoid"] == claims.FAILS


@pytest.mark.parametrize("frame", ["single", "empty"], indirect=True)
def test_nothing_is_decided_on_one_trial(frame: pd.DataFrame) -> None:
    assert set(verdicts(frame)) == {claims.UNDECIDED}


def test_a_run_of_another_number_of_iterations_is_set_aside(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    plan = planned("ppo", "Atlas")
    budget = plan.budget.with_iterations(plan.budget.n_iterations // 2)
    short = synthetic.write_record(dataclasses.replace(plan, budget=budget), 600.0)
    loaded = results.load_records("humanoids", "book")
    assert loaded.empty and loaded.attrs["set_aside"] == [short.run_id]
    assert plan.run_id in {run["run_id"] for run in loaded.attrs["missing"]}
    assert short.run_id in results.trace(loaded).data


def test_studies_without_claims_are_refused() -> None:
    with pytest.raises(SilemError, match="allowed: halfcheetah, ant, humanoids, slope"):
        claims.of("no-gradient-penalty")


def test_curves_of_any_age_have_every_column(frame: pd.DataFrame) -> None:
    run_id = results.cell(frame, "ppo", "Atlas")["run_id"].iloc[0]
    curve = results.load_curve(run_id)
    assert curve["episode_length"].notna().any() and curve["domain_acc"].isna().all()
    folder = results.find(run_id).folder
    assert "domain_acc" not in (folder / "curve.csv").read_text()
