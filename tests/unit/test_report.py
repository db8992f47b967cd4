"""Figures, tables, verdicts and tracing lines, drawn from made-up records."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
import synthetic_records as synthetic
from drawn import assert_readable, boxes, footer, lines_at, texts
from matplotlib.axes import Axes
from scipy import stats

from silem.report import curves, results, scores, statistics, style, tables, transforms
from silem.study.config import RunConfig
from silem.study.studies import study_configs
from silem.util.errors import SilemError

FIGURES = {
    "normalised_scores": scores.normalised_scores,
    "affine_or_mlp": scores.affine_or_mlp,
    "experts": scores.experts,
    "learning_curves": curves.learning_curves,
    "by_feature": transforms.by_feature,
}
CASES = ("whole", "five", "partial", "single", "bad expert", "empty", "tiny")


def make(case: str, folder: Path) -> pd.DataFrame:
    """Write one made-up study, and load it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SILEM_DATA_DIR", str(folder))
        if case in ("whole", "five"):
            synthetic.write_study(n_trials=5 if case == "five" else 3)
        elif case == "partial":
            few = {("silem", "HC2"): 1, ("silem-minus", "HC2"): 0, ("random", "HC1"): 0}
            few |= {("silem-minus-own", "HC1"): 2, ("silem-mlp", "HC0"): 0, ("ppo", "HC1"): 0}
            synthetic.write_study(n_trials=3, without=few)
        elif case == "single":
            synthetic.write_study(n_trials=1)
        elif case == "bad expert":
            patch.setitem(synthetic.EXPERT_RETURNS, "HC2", -1300.0)
            synthetic.write_study(n_trials=1)
        elif case == "tiny":
            synthetic.write_study("tiny")
        return results.load_records("halfcheetah", "tiny" if case == "tiny" else "book")


# ---------------------------------------------------------------- figures


@pytest.mark.parametrize(
    ("frame", "name"),
    [
        *itertools.product(("partial", "empty"), FIGURES),
        *itertools.product(("five", "single", "bad expert", "tiny"), ["normalised_scores"]),
    ],
    indirect=["frame"],
)
def test_texts_neither_overlap_nor_leave_the_figure(name: str, frame: pd.DataFrame) -> None:
    assert_readable(FIGURES[name](frame))


def test_the_overlap_check_sees_overlaps() -> None:
    with style.applied():
        figure, axes = style.new_figure(2)
        axes.text(0.5, 0.5, "one text")
        axes.text(0.52, 0.5, "another")
    both = [box for text, box in boxes(figure) if text in ("one text", "another")]
    assert len(both) == 2 and both[0].overlaps(both[1])


def test_the_same_records_give_the_same_bytes(frame: pd.DataFrame) -> None:
    one = style.svg(scores.affine_or_mlp(frame))
    assert one == style.svg(scores.affine_or_mlp(frame))
    assert one.startswith("<svg") and one.rstrip().endswith("</svg>")


def test_drawing_leaves_no_state_behind(frame: pd.DataFrame) -> None:
    before = dict(mpl.rcParams)
    style.svg(scores.experts(frame))
    assert dict(mpl.rcParams) == before
    assert plt.get_fignums() == []


@pytest.mark.parametrize("name", FIGURES)
def test_every_figure_names_budget_and_runs(name: str, frame: pd.DataFrame) -> None:
    shown = scores.runs_of(name, frame)
    text = footer(FIGURES[name](frame))
    assert text.startswith("budget book (") and "iterations" in text
    assert f"{len(shown)} runs" in text
    assert "not evidence" not in text


@synthetic.study("tiny")
@pytest.mark.parametrize("name", FIGURES)
def test_figures_of_toy_budgets_warn(name: str, frame: pd.DataFrame) -> None:
    assert footer(FIGURES[name](frame)).startswith("not evidence: budget tiny")


def test_figure_2b_draws_minimum_mean_maximum_and_every_trial(frame: pd.DataFrame) -> None:
    left = scores.normalised_scores(frame).axes[0]
    drawn = lines_at(left, style.METHODS["silem-minus"].color)
    values = results.scores(frame, "silem-minus", "HC1")
    ends = [tuple(line.get_ydata()) for line in drawn if len(set(line.get_ydata())) == 2]
    assert (values.min(), values.max()) in ends
    dots = [line.get_ydata() for line in drawn if line.get_marker() == "o"]
    assert any(sorted(y) == sorted(values) for y in dots)
    marks = [line.get_ydata()[0] for line in drawn if line.get_marker() == "s"]
    assert values.mean() in marks


def pale(axes: Axes, method: str) -> list[np.ndarray]:
    """The intervals that a panel draws for a method, lower and upper ends."""
    drawn = lines_at(axes, style.METHODS[method].color)
    return [line.get_ydata() for line in drawn if line.get_alpha() and len(line.get_ydata()) == 2]


@pytest.mark.parametrize("frame", ["five"], indirect=True)
def test_figure_2b_draws_students_interval_with_its_coverage(frame: pd.DataFrame) -> None:
    figure_frame, figure = frame, scores.normalised_scores(frame)
    for axes, column in zip(figure.axes, ("normalised", "speed_m_s"), strict=True):
        first = pale(axes, "silem")[0]
        values = results.scores(frame, "silem", "HC0", column)
        np.testing.assert_allclose(first, stats.ttest_1samp(values, 0).confidence_interval())
    words = footer(figure)
    for failures in (False, True):
        assert f"{100 * statistics.coverage(5, failures=failures):.0f} %" in words
    assert "do not hold the variance of the demonstrator" in words
    for method in ("silem", "silem-minus", "silem-minus-own"):  # the experts alone have five
        frame = frame[frame["method"] != method]
    frame.attrs = figure_frame.attrs
    assert "Student's 95 %" in footer(scores.normalised_scores(frame))


@pytest.mark.parametrize("frame", ["whole", "single", "empty"], indirect=True)
def test_figures_draw_no_interval_below_five_trials(frame: pd.DataFrame) -> None:
    figure = scores.normalised_scores(frame)
    assert not any(pale(axes, method) for axes in figure.axes for method in style.METHODS)
    assert "no interval below 5 trials" in footer(figure)


def test_figure_2b_shows_the_best_expert_and_the_speeds(frame: pd.DataFrame) -> None:
    left, right = scores.normalised_scores(frame).axes
    dots = [line.get_ydata()[0] for line in lines_at(left, style.INK)]
    assert dots == [results.scores(frame, "ppo", body).max() for body in ("HC0", "HC1", "HC2")]
    expert = [line.get_ydata() for line in right.lines if line.get_marker() == "P"]
    speeds = [results.scores(frame, "ppo", b, "speed_m_s").mean() for b in ("HC0", "HC1", "HC2")]
    assert [y[0] for y in expert] == speeds


@synthetic.study("single")
def test_one_trial_is_drawn_hollow_and_without_range(frame: pd.DataFrame) -> None:
    figure = scores.normalised_scores(frame)
    for axes in figure.axes:
        for method in ("silem", "silem-minus", "silem-minus-own"):
            drawn = lines_at(axes, style.METHODS[method].color)
            marks = [
                line for line in axes.lines if line.get_marker() == style.METHODS[method].marker
            ]
            assert [mark.get_markerfacecolor() for mark in marks] == ["white"] * 3
            assert not [line for line in drawn if len(line.get_ydata()) > 1]
    assert texts(figure).count("n=1") == 9 + 12
    assert "one trial" in footer(figure)


@synthetic.study("partial")
def test_cells_without_runs_are_empty_slots_that_say_why(frame: pd.DataFrame) -> None:
    words = texts(scores.normalised_scores(frame))
    assert words.count("no run") == 3  # SILEM-minus on HC2, in both panels; HC1's expert
    assert words.count("no expert") == 3  # HC1's runs cannot be normalised
    assert {"n=1", "n=3"} <= set(words)


@synthetic.study("bad expert")
def test_an_expert_below_zero_is_no_scale(frame: pd.DataFrame) -> None:
    words = texts(scores.normalised_scores(frame))
    assert words.count("expert's return ≤ 0") == 3
    assert any(word.startswith("HC2\nexperts −1,") for word in words)


@synthetic.study("empty")
def test_figures_without_any_run_are_all_empty_slots(frame: pd.DataFrame) -> None:
    assert texts(scores.normalised_scores(frame)).count("no run") == 9 + 12
    assert texts(scores.experts(frame)).count("no run") == 18
    assert texts(curves.learning_curves(frame)).count("no run") == 9
    assert "HC1, no run" in texts(transforms.by_feature(frame))


def test_experts_are_drawn_beside_the_papers_numbers(frame: pd.DataFrame) -> None:
    panel = scores.experts(frame).axes[0]
    amber = [line.get_ydata()[0] for line in lines_at(panel, style.PAPER)]
    assert sorted(amber) == [-1555, 2249]


def test_affine_or_mlp_puts_reward_against_return(frame: pd.DataFrame) -> None:
    axes = scores.affine_or_mlp(frame).axes[0]
    pink = lines_at(axes, style.METHODS["silem-mlp"].color)
    ours, printed = (np.column_stack(line.get_data()) for line in pink)
    rows = results.cell(frame, "silem-mlp", "HC0")
    np.testing.assert_array_equal(ours, rows[["disc_reward", "return_mean"]])
    np.testing.assert_array_equal(printed, [[466, -1979]])


def test_learning_curves_show_the_mean_over_trials(frame: pd.DataFrame) -> None:
    figure = curves.learning_curves(frame)
    panel = figure.axes[0]  # return, HC0
    (line,) = lines_at(panel, style.METHODS["ppo"].color)
    final = results.scores(frame, "ppo", "HC0", "return_mean").mean()
    assert line.get_ydata()[-1] == pytest.approx(final, rel=0.05)
    assert line.get_ydata()[0] < 0 < line.get_ydata()[-1]
    assert not lines_at(figure.axes[3], style.METHODS["ppo"].color)  # no discriminator


def test_learning_curves_tell_no_run_from_nothing_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    synthetic.write_record(RunConfig.create("HC0", "ppo", budget="book"))
    alone = texts(curves.learning_curves(results.load_records("halfcheetah", "book")))
    assert (alone.count("no run"), alone.count("not recorded")) == (4, 0)
    assert "discriminator reward" not in alone
    synthetic.write_record(RunConfig.create("HC1", "silem", budget="book"))
    figure = curves.learning_curves(results.load_records("halfcheetah", "book"))
    words = texts(figure)
    # nothing ran on HC2; HC0's expert has no discriminator
    assert (words.count("no run"), words.count("not recorded")) == (3, 1)
    assert "discriminator reward" in words
    assert len(figure.axes[0].get_yticks()) > 2
    empty = curves.learning_curves(results.load_records("no-gradient-penalty", "book"))
    assert not any(len(axes.get_yticks()) for axes in empty.axes)  # no curve, no scale


def test_transforms_mark_each_feature_at_the_trials_mean(frame: pd.DataFrame) -> None:
    left, right = transforms.by_feature(frame).axes
    runs = results.cell(frame, "silem", "HC2")["run_id"]
    mean = np.mean([results.load_transform(run)["b"] for run in runs], axis=0)
    groups = [mean[list(group.columns)] for group in transforms.feature_groups("HC2")]
    for values in groups:
        drawn = [line.get_xdata() for line in right.lines if len(line.get_xdata()) == len(values)]
        assert any(np.allclose(x, values, rtol=1e-12) for x in drawn)
    assert [label.get_text() for label in left.get_yticklabels()] == transforms.feature_names("HC2")


LENGTHS = {"HC0": 1.0, "HC1": 2.0, "HC2": 3.0}


def test_scores_and_transforms_stand_against_a_length(frame: pd.DataFrame) -> None:
    columns = {"normalised": "score", "speed_m_s": "speed (m/s)"}
    figure = scores.against(frame, LENGTHS, "torso (m)", columns, ["silem", "silem-minus"])
    assert_readable(figure)
    (line,) = [x for x in lines_at(figure.axes[0], style.METHODS["silem"].color)
               if len(x.get_xdata()) == 3 and x.get_marker() == "None"]  # fmt: skip
    assert list(line.get_xdata()) == list(LENGTHS.values())
    means = [results.scores(frame, "silem", body).mean() for body in LENGTHS]
    np.testing.assert_allclose(line.get_ydata(), means)
    few = results.select(frame, ["silem"], ["HC0"])  # the others have no run yet
    figure = scores.against(few, LENGTHS, "torso (m)", columns, ["silem", "silem-minus"])
    for axes in figure.axes:
        low, high = axes.get_xlim()
        assert low < 1.0 and 3.0 < high < 3.5
    figure = transforms.against(frame, LENGTHS, "torso (m)", ["pitch", "forward velocity"])
    assert_readable(figure)
    rows = results.cell(frame, "silem", "HC2")["run_id"]
    last = np.mean([results.load_transform(run)["A"][7] for run in rows])
    assert any(line.get_ydata()[-1] == last for line in lines_at(figure.axes[0], "C0"))
    with pytest.raises(SilemError, match="unknown feature 'yaw'"):
        transforms.against(frame, LENGTHS, "torso (m)", ["yaw"])


def test_features_are_named_after_joints_and_feet() -> None:
    names = transforms.feature_names("HC0")
    assert len(names) == len(set(names)) == 26
    assert names[3] == "forward velocity" and names[8:10] == [
        "back thigh angle",
        "back thigh velocity",
    ]
    assert len(transforms.feature_names("Ant3")) == 28


def test_unknown_figures_are_refused(frame: pd.DataFrame) -> None:
    with pytest.raises(SilemError, match="allowed: normalised_scores"):
        scores.runs_of("figure 9", frame)


# ---------------------------------------------------------------- tables and tracing


def test_table_1_puts_ours_beside_the_papers(frame: pd.DataFrame) -> None:
    page = tables.table_1(frame).to_html()
    for value in (466, 451, -1979, 2234):
        assert style.number(value) in page
    ours = results.scores(frame, "silem", "HC0", "return_mean")
    assert style.number(ours.mean()) in page
    assert f"{style.number(ours.min())} to {style.number(ours.max())}" in page


@synthetic.study("partial")
def test_cell_table_has_a_row_for_every_planned_cell(frame: pd.DataFrame) -> None:
    table = tables.cell_table(frame).data
    assert len(table) == 16
    row = table.query("body == 'HC2' and method == 'SILEM⁻ (HC0 expert)'").iloc[0]
    assert (row["trials"], row["return"], row["score"]) == ("0", "–", "–")


@synthetic.study("partial")
def test_trace_lists_every_run_with_the_command_that_reruns_it(frame: pd.DataFrame) -> None:
    shown = scores.runs_of("normalised_scores", frame)
    page = results.trace(shown).data
    for row in shown.itertuples():
        assert f"<code>{row.run_id}</code><br><code>{row.command}</code>" in page
    for run in shown.attrs["missing"]:
        assert run["command"] in page
    assert "random_HC0" not in page and "silem-mlp" not in page  # not in that figure
    assert page.count("<details>") == 2 and "<details open" not in page
    assert "commit 0123456" in page


def test_trace_names_every_commit_and_says_where_code_was_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    for seed, commit in enumerate(("a" * 40, "b" * 40)):
        config = RunConfig.create("HC0", "ppo", budget="book", seed=seed)
        synthetic.write_record(config, commit=commit)
    synthetic.write_record(RunConfig.create("HC0", "ppo", budget="book", seed=99))
    table = results.load_records("halfcheetah", "book")
    assert results.commits(table) == "commits aaaaaaa, bbbbbbb"
    assert "other settings or seeds, not shown (1)" in results.trace(table).data
    table["dirty"] = [False, True]
    assert results.commits(table) == "commits aaaaaaa, bbbbbbb with uncommitted changes"


@synthetic.study("empty")
def test_trace_of_no_runs_lists_what_to_make(frame: pd.DataFrame) -> None:
    page = results.trace(frame).data
    assert "0 runs" in page and "silem run --body HC0 --method ppo" in page


def test_tables_do_not_style_each_other_and_never_change_by_themselves() -> None:
    pages = [tables.styled(pd.DataFrame({"a": [text]})).to_html() for text in ("x", "y", "x")]
    ids = [re.findall(r'id="(T_\w+)"', page)[0] for page in pages]
    assert ids[0] != ids[1] and pages[0] == pages[2]


def test_what_a_search_or_a_control_tried_is_there_before_its_runs_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    configs = {c.hyper.anneal_clip: c for c in study_configs("fidelity", "book", body=["HC0"])}
    made = synthetic.write_record(configs[True], 2345.0)
    tried = tables.searched(results.load_records("fidelity", "book"), {"ppo": {}})
    of_hc0 = tried[tried["body"].eq("HC0")].groupby("setting", sort=False)
    rows = tables.means([({"with": name}, runs) for name, runs in of_hc0], ["return_mean"])
    told = style.number(made.evaluation["return_mean"])
    assert rows.to_numpy().tolist() == [
        ["clipping of actions off", "0", style.DASH], ["falling clip range on", "1", told],
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("transform_learning_rate", 1e-5, "rate of T 1e−5"),
        ("log_std_init", -1.6094, "first std 0.2"),
        ("gradient_reversal_coef", 1.6, "C_g 1.6"),
        ("starts", "demonstration", "starts demonstration"),
        ("gradient_penalty", None, f"gradient penalty {style.DASH}"),
    ],
)
def test_a_setting_is_written_one_way(name: str, value: object, words: str) -> None:
    assert " ".join(tables.setting(name, value)) == words


def test_a_span_names_its_ends_once() -> None:
    assert style.span([3, 2000, np.nan, 5]) == "3 to 2,000"
    assert style.span([-1.25, -1.251], 2) == "−1.25"
    assert style.span([np.nan]) == style.span([]) == style.DASH


def test_the_best_expert_is_a_scale_of_its_own(frame: pd.DataFrame) -> None:
    best = results.scores(frame, "ppo", "HC1", "return_mean").max()
    ours = results.scores(frame, "silem", "HC1", "return_mean") / best
    table = tables.cell_table(frame).data.set_index(["body", "method"])
    assert table.loc[("HC1", "SILEM"), "score, best expert"] == f"{ours.mean():.2f}"


@synthetic.study("bad expert")
def test_without_a_good_expert_there_is_no_scale(frame: pd.DataFrame) -> None:
    table = tables.cell_table(frame).data.set_index(["body", "method"])
    assert table.loc[("HC2", "SILEM"), ["score", "score, best expert"]].eq(style.DASH).all()


def test_readings_of_a_random_policy_stand_beside_the_papers_number() -> None:
    table = tables.random_policies().data.set_index("a random policy")["return"]
    assert table["the paper's"] == "−1,555"
    returns = {name: float(text.partition(" ")[0].replace("−", "-").replace(",", ""))
               for name, text in table.items()}  # fmt: skip
    untrained, clipped = [name for name in returns if "untrained" in name or "clipped" in name]
    assert abs(returns[untrained] + 1555) < 100 < abs(returns[clipped] + 1555)


def test_intervals_true_coverage_is_told() -> None:
    rows = tables.coverages().data.set_index("trials")
    assert rows.loc["2", "bootstrap, normal scores"] == "50 %"
    assert set(rows["Student's, normal scores"]) == {"95 %"}
