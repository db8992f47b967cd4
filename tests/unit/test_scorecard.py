"""Verdicts: the rules as data, on made-up records and on findings worked out by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import synthetic_records as synthetic

from silem import paper
from silem.report import claims, results
from silem.report.claims import FAILS, HOLDS, UNDECIDED, Finding, Measure

CASES = ("whole", "single", "bad expert", "empty", "tiny")
SPEED = Measure(("silem", "HC1"), "speed_m_s", lower=1.0)
REACHES = "SILEM reaches expert level on "


def make(case: str, folder: Path) -> pd.DataFrame:
    """Write one made-up study, with two bodies' runs of the paper's loss, and load it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SILEM_DATA_DIR", str(folder))
        if case == "bad expert":
            patch.setitem(synthetic.EXPERT_RETURNS, "HC2", -1300.0)
        if case == "whole":
            some = {("silem", "HC2"): 1, ("silem-minus", "HC2"): 0}
            synthetic.write_study(study="no-gradient-penalty", without=some)
        if case != "empty":
            budget = "tiny" if case == "tiny" else "book"
            synthetic.write_study(budget, n_trials=1 if case in ("single", "tiny") else 3)
        return results.load_records("halfcheetah", "tiny" if case == "tiny" else "book")


def judged(frame: pd.DataFrame, text: str) -> pd.Series:
    return claims.evaluate(frame).set_index("text").loc[text]


def changed(frame: pd.DataFrame, method: str, body: str, **columns: float) -> pd.DataFrame:
    """A table in which one cell's values are moved to a mean; their spread stays."""
    other = frame.copy()
    other.attrs = frame.attrs
    rows = other["method"].eq(method) & other["body"].eq(body)
    for name, mean in columns.items():
        other.loc[rows, name] += mean - other.loc[rows, name].mean()
    return other


# ---------------------------------------------------------------- rules


@pytest.mark.parametrize(
    ("interval", "lower", "upper", "verdict"),
    [
        ((1.0, 2.0), 0.5, np.inf, HOLDS),
        ((1.0, 2.0), 1.5, np.inf, UNDECIDED),
        ((1.0, 2.0), 2.5, np.inf, FAILS),
        ((1.0, 2.0), -np.inf, 2.5, HOLDS),
        ((1.0, 2.0), -np.inf, 0.5, FAILS),
        ((1.0, 2.0), 0.9, 2.1, HOLDS),
        ((1.0, 2.0), 1.1, 1.9, UNDECIDED),
        ((1.0, 2.0), 3.0, 4.0, FAILS),
    ],
)
def test_verdict_rule(
    interval: tuple[float, float], lower: float, upper: float, verdict: str
) -> None:
    measure = Measure(("silem", "HC0"), "return_mean", lower=lower, upper=upper)
    assert Finding(measure, 1.5, interval, {"SILEM": 5}).verdict[0] == verdict
    few = Finding(measure, 1.5, interval, {"SILEM": 5, "PPO": 2})
    assert few.verdict == (UNDECIDED, "too few trials: PPO 2; 3 needed")


def test_undecided_gives_its_true_reason() -> None:
    spans = Finding(SPEED, 1.1, (0.5, 1.7), {"SILEM": 3})
    assert spans.verdict == (UNDECIDED, "the interval of the speed (m/s) spans the bound")
    score = Measure(("silem", "HC1"), "return_mean", per=("ppo", "HC1"), lower=0.9)
    nan = (float("nan"), float("nan"))
    assert "not above zero" in Finding(score, float("nan"), nan, {"SILEM": 3}).verdict[1]
    # No value because there is no run is no fault of the expert's.
    assert Finding(score, float("nan"), nan, {"SILEM": 0, "PPO": 5}).verdict[1] == (
        "too few trials: SILEM 0; 3 needed"
    )


def test_every_rule_is_data_that_says_itself() -> None:
    for study in claims.CLAIMS:
        texts = [claim.text for claim in claims.of(study)]
        assert len(set(texts)) == len(texts)
        for claim in claims.of(study):
            for measure in claim.measures:
                assert np.isfinite([measure.lower, measure.upper]).any()
                assert measure.rule in claim.rule
    assert SPEED.rule == "speed (m/s) above 1.00"
    assert Measure(("a", "b"), "disc_reward", less=("c", "b"), lower=-100.0).rule == (
        "difference in discriminator reward above −100"
    )


def test_a_stable_gait_is_survival_and_speed(tmp_path: Path) -> None:
    """Standing still is no walk: neither for SILEM nor against SILEM-minus."""
    by_text = {claim.text: claim for claim in claims.of("humanoids")}
    for method, text in (("silem", "SILEM's gait is stable"), ("silem-minus", "SILEM⁻ finds no")):
        (claim,) = [c for t, c in by_text.items() if t.startswith(text) and t.endswith("Atlas")]
        verdicts = {}
        for name, upright, speed in (("stands", 1.0, 0.1), ("walks", 1.0, 1.5), ("falls", 0.1, 1)):
            rows = [
                {"method": method, "body": "Atlas", "n_iterations": 2000,
                 "upright": upright - 1e-3 * i, "speed_m_s": speed + 1e-3 * i}
                for i in range(3)
            ]  # fmt: skip
            frame = pd.DataFrame(rows)
            frame.attrs = {"study": "humanoids", "budget": "book"}
            verdicts[name] = claim.judge(frame)[1]
        good, bad = (HOLDS, FAILS) if method == "silem" else (FAILS, HOLDS)
        assert verdicts == {"stands": bad, "walks": good, "falls": bad}


# ---------------------------------------------------------------- HalfCheetah


def test_scorecard_reads_the_records(frame: pd.DataFrame) -> None:
    random = judged(frame, "The random policy's return is the paper's on HC0")
    (finding,) = random["findings"]
    assert (random["claim"].printed, finding.trials, random["verdict"]) == (
        -1555, {"episodes": 100}, HOLDS,
    )  # fmt: skip
    assert finding.ours == pytest.approx(
        results.cell(frame, "random", "HC0")["return_mean"].item(), abs=1e-2
    )
    silem = judged(frame, REACHES + "HC2")["findings"][0]
    assert silem.ours == pytest.approx(results.scores(frame, "silem", "HC2").mean())
    assert silem.interval[0] < silem.ours < silem.interval[1]
    best = results.scores(frame, "ppo", "HC2", "return_mean").max()
    returns = results.scores(frame, "silem", "HC2", "return_mean")
    assert silem.of_best == pytest.approx(returns.mean() / best)
    assert silem.of_best < silem.ours
    for text in (
        "SILEM beats SILEM⁻ on HC1",
        "Without the transform imitation degrades, against the body's own expert on HC2",
        "The affine transform leads to the better policy than the MLP on HC0",
    ):
        assert judged(frame, text)["verdict"] == HOLDS


def test_scorecard_finds_claims_that_do_not_hold(frame: pd.DataFrame) -> None:
    swapped = frame.copy()
    swapped.attrs = frame.attrs
    names = {"silem": "silem-minus", "silem-minus": "silem"}
    swapped["method"] = [names.get(name, name) for name in frame["method"]]
    for text in ("SILEM beats SILEM⁻ on HC1", REACHES + "HC1", REACHES + "HC2"):
        assert judged(swapped, text)["verdict"] == FAILS
    shifted = changed(frame, "silem", "HC0", disc_reward=750.0)
    text = "SILEM's discriminator reward is the paper's on HC0"
    assert judged(shifted, text)["verdict"] == FAILS


def test_expert_level_needs_the_experts_speed(frame: pd.DataFrame) -> None:
    level = results.scores(frame, "ppo", "HC1", "return_mean").mean()
    fast = changed(frame, "silem", "HC1", return_mean=1.2 * level, speed_m_s=2.0)
    assert judged(fast, REACHES + "HC1")["verdict"] == HOLDS
    slow = changed(fast, "silem", "HC1", speed_m_s=0.3)
    assert judged(slow, REACHES + "HC1")["verdict"] == FAILS  # the same return


def test_a_standing_expert_is_no_level(frame: pd.DataFrame) -> None:
    standing = changed(frame, "ppo", "HC2", speed_m_s=0.02)
    row = judged(standing, REACHES + "HC2")
    ours = results.scores(frame, "silem", "HC2", "speed_m_s").mean()
    assert row["verdict"] == UNDECIDED
    assert row["reason"].startswith("no expert level: PPO's experts stand (0.02 m/s)")
    assert f"the imitators' speed: {ours:.2f} m/s" in row["reason"]
    # a return far below the experts' does not decide it either
    low = changed(standing, "silem", "HC2", return_mean=-500.0)
    assert judged(low, REACHES + "HC2")["verdict"] == UNDECIDED


@synthetic.study("bad expert")
def test_an_expert_below_zero_is_no_level(frame: pd.DataFrame) -> None:
    assert judged(frame, REACHES + "HC2")["reason"].startswith("no expert level")


def test_degradation_is_against_the_own_expert_on_the_same_body(frame: pd.DataFrame) -> None:
    text = "Without the transform imitation degrades, against the body's own expert on HC1"
    own = results.scores(frame, "silem-minus-own", "HC1", "return_mean").mean()
    minus = results.scores(frame, "silem-minus", "HC1", "return_mean").mean()
    (finding,) = judged(frame, text)["findings"]
    assert finding.ours == pytest.approx(own - minus)
    same = changed(frame, "silem-minus", "HC1", return_mean=own + 400)  # still below the expert
    assert judged(same, text)["verdict"] == FAILS


@pytest.mark.parametrize("frame", ["single", "empty", "tiny"], indirect=True)
def test_scorecard_decides_nothing_on_too_little(frame: pd.DataFrame) -> None:
    rows = claims.evaluate(frame)
    decided = rows[rows["verdict"] != UNDECIDED]
    # The random policy is not trained: its episodes are enough, at a budget that is evidence.
    allowed = {"The random policy's return is the paper's on HC0"} if len(frame) == 16 else set()
    if results.context(frame)[1] == "tiny":
        allowed = set()
        assert set(rows["reason"]) == {"runs at budget tiny are no evidence"}
    else:
        assert rows.loc[rows["verdict"] == UNDECIDED, "reason"].str.startswith("too few").all()
    assert set(decided["text"]) <= allowed


def test_expert_level_counts_the_experts_own_spread(frame: pd.DataFrame) -> None:
    """Spread among the experts alone widens the interval; dividing by their mean would not."""
    rows = frame["method"].eq("ppo") & frame["body"].eq("HC0")
    wide = frame.copy()
    wide.attrs = frame.attrs
    level = frame.loc[rows, "return_mean"].mean()
    wide.loc[rows, "return_mean"] = level + np.array([-600.0, 0.0, 600.0])
    narrow, broad = (judged(t, REACHES + "HC0")["findings"][0] for t in (frame, wide))
    assert np.ptp(broad.interval) > 3 * np.ptp(narrow.interval)
    assert broad.ours == pytest.approx(narrow.ours)
    assert broad.detectable > 3 * narrow.detectable


def test_power_is_that_of_the_planned_trials(frame: pd.DataFrame) -> None:
    (finding,) = judged(frame, "SILEM beats SILEM⁻ on HC1")["findings"]
    spread = np.mean([results.scores(frame, m, "HC1", "return_mean").var(ddof=1)
                      for m in ("silem", "silem-minus")])  # fmt: skip
    # Five trials each, equal spread: 3.1 to 3.5 standard errors, depending on the freedom.
    assert 3.0 < finding.detectable / (2 * spread / 5) ** 0.5 < 4.1
    assert results.n_trials(frame) == 5


# ---------------------------------------------------------------- the page's tables


def test_scorecard_table_shows_every_claim_with_its_rule(frame: pd.DataFrame) -> None:
    page = claims.table(frame).to_html()
    judged = claims.of("halfcheetah")
    for claim in judged:
        assert claim.text in page and claim.rule in page
    assert sum(claims.counts(frame).values()) == len(judged)
    assert page.count("background-color") >= 2
    assert "5 trials find ±" in page and "against the best expert" in page
    rules = claims.rules().to_html()
    assert all(text.split(".")[0] in rules for text in claims.RULES.values())


def test_the_papers_loss_has_columns_of_its_own(frame: pd.DataFrame) -> None:
    rows = claims.table(frame).data.set_index(("", "claim"))["the paper's loss"]["verdict"]
    by_claim = {name.partition("<br>")[0]: cell for name, cell in rows.items()}
    assert by_claim["SILEM beats SILEM⁻ on HC1"] == f"<b>{HOLDS}</b>"
    assert "SILEM 1, SILEM⁻ 0; 3 needed" in by_claim["SILEM beats SILEM⁻ on HC2"]
    assert "spans the bound" in by_claim[REACHES + "HC0"]  # by the experts that both share
    assert "not planned: MLP on HC0" in by_claim["The MLP's return is the paper's on HC0"]
    ours = claims.table(frame).data.set_index(("", "claim"))["this book's loss"]["verdict"]
    assert "too few" not in "".join(ours)


def test_the_gap_appears_under_the_losses_where_silem_beats_its_ablation(
    frame: pd.DataFrame, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours, papers = "this book's loss", "the paper's loss"
    told = claims.gap(frame).set_index("body")["the gap appears under"]
    assert told["HC1"] == f"{ours} and {papers}" and told["HC2"] == "open: too few trials"
    other = results.paper_loss(frame)

    def without(runs: pd.DataFrame) -> pd.DataFrame:
        equal = runs.assign(return_mean=runs["return_mean"].where(runs["method"] != "silem", 0.0))
        equal.attrs = runs.attrs
        return equal

    for here, there, answer in (
        (frame, without(other), ours), (without(frame), other, papers),
        (without(frame), without(other), "neither"),
    ):  # fmt: skip
        monkeypatch.setattr(results, "paper_loss", lambda _, there=there: there)
        assert claims.gap(here).set_index("body")["the gap appears under"]["HC1"] == answer


def test_claims_are_compared_with_what_the_paper_prints() -> None:
    printed = {claim.text: claim.printed for claim in claims.of("halfcheetah") if claim.printed}
    rows = {row["f"]: row for row in paper.table("tab1").rows}
    assert len(printed) == 8 and -1979 in printed.values()
    gap = rows["MLP"]["discriminator_reward"] - rows["Affine Transform"]["discriminator_reward"]
    assert printed["The MLP fools D as well as the affine transform on HC0"] == gap
